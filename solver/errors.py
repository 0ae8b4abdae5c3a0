"""The error of what somebody gave, and that alone: any other is a fault of the program, which nobody may catch."""

from __future__ import annotations


class InputError(ValueError):
    """What was given cannot be used; the message is the sentence for whoever gave it: thing, value, what to do."""
