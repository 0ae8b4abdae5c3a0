"""Times as a clock shows them, 12:03:04.250, as seconds since midnight."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from .table import Array

_DAY = 86400.0  # s
_PLAIN = r"\d{{1,2}}:[0-5]\d:[0-5]\d(?:[{}]\d+)?"  # hours, minutes and seconds; two of them may be either
_CELL = re.compile(_PLAIN.format(".,"))


def is_clock(cell: str) -> bool:
    """Whether a field is hours:minutes:seconds."""
    return _CELL.fullmatch(cell.strip()) is not None


def in_seconds(lines: Iterable[str], separator: str, mark: str) -> list[str]:
    """Lines with such fields as seconds, digit for digit; what separates fields does not separate their decimals."""
    field = re.compile(rf"(?<![\d:]){_PLAIN.format('.' if separator == ',' else '.,')}(?![\d:])")
    return [field.sub(lambda found: _seconds(found[0], mark), line) if ":" in line else line for line in lines]


def past_midnight(seconds: Array) -> Array:
    """(n,) [s] of a clock, with a day added each time it begins anew."""
    with np.errstate(invalid="ignore"):
        return seconds + _DAY * np.concatenate([[0], np.cumsum(np.diff(seconds) < -0.5 * _DAY)])


def _seconds(text: str, mark: str) -> str:
    hours, minutes, rest = text.replace(",", ".").split(":")
    whole, point, decimals = rest.partition(".")
    return f"{3600 * int(hours) + 60 * int(minutes) + int(whole)}{mark if point else ''}{decimals}"
