"""What is refused is refused in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest


def refused(call: Callable[[], Any], start: object, words: Sequence[str]) -> None:
    """The call raises ValueError in one line that begins with ``start``, holds all the words and ends as a sentence."""
    with pytest.raises(ValueError) as error:
        call()
    sentence = str(error.value)
    assert sentence.startswith(str(start)), sentence
    assert [word for word in words if word not in sentence] == [], sentence
    assert "\n" not in sentence
    assert sentence[-1] in ".?)", sentence
