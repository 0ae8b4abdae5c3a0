"""The input error. Any other exception is a bug of the program, which no code may catch."""

from __future__ import annotations


class InputError(ValueError):
    """An unusable input; the message is the sentence for the user: quantity, value, remedy."""
