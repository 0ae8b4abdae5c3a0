"""Times as a clock shows them, 12:03:04.250, 12:03:04.250 PM, 03:04.250 or 2024-05-01T12:03:04.250, as seconds since
midnight, the hour or 1970; and the part of a recording that an option states."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from datetime import date

import numpy as np

from solver.errors import InputError
from solver.network.files import parse_quantity

from .table import Array

_DAY = 86400.0  # s
_ISO = r"[12]\d{3}-(?:0[1-9]|1[0-2])-[0-3]\d"
# of other dates the order of day and month differs between countries: times of day, which midnight adds a day to
_DATE = (
    rf"(?:{_ISO}|\d{{4}}/\d{{1,2}}/\d{{1,2}}|\d{{1,2}}[./-]\d{{1,2}}[./-]\d{{2}}(?:\d{{2}})?"
    r"|\d{1,2}[- ][A-Za-z]{3}[- ]\d{4})"
)
_ZONE = r"(?: ?(?:UTC|GMT)|Z|[+-]\d\d:?\d\d)?"  # left aside: it is the same throughout a record
_HALF = r"(?: ?([AaPp])\.?[Mm]\b\.?)?"  # of the day


def _clock(marks: str) -> str:
    """Hours, minutes and seconds, a date before them or none; or minutes and seconds with decimals, without which the
    two may be hours and minutes."""
    whole = rf"(?:{_DATE}[T ]+)?\d{{1,2}}:[0-5]\d:[0-5]\d(?:[{marks}]\d+|:\d{{3}})?{_HALF}{_ZONE}"
    return rf"(?:{whole}|\d{{1,2}}:[0-5]\d[{marks}]\d+)"


def is_clock(cell: str) -> bool:
    """Whether a field is hours:minutes:seconds, perhaps with a date before them, or minutes:seconds.decimals."""
    return re.fullmatch(_clock(".,"), cell.strip()) is not None


def is_date(cell: str) -> bool:
    """Whether a field is a date alone."""
    return re.fullmatch(_DATE, cell.strip()) is not None


def in_seconds(lines: Iterable[str], separator: str, mark: str) -> list[str]:
    """Lines with such fields as seconds, digit for digit, and without dates that stand alone; what separates fields
    does not separate their decimals."""
    field = re.compile(rf"(?<![\d:]){_clock('.' if separator == ',' else '.,')}(?![\d:])|(?<![\d.]){_DATE}(?![\d.:])")
    return [field.sub(lambda found: _seconds(found[0], mark), line) if ":" in line else line for line in lines]


def past_midnight(seconds: Array) -> Array:
    """(n,) [s] of a clock, with a day added each time it begins anew."""
    with np.errstate(invalid="ignore"):
        return seconds + _DAY * np.concatenate([[0], np.cumsum(np.diff(seconds) < -0.5 * _DAY)])


def part_of(text: str) -> tuple[str, tuple[float, float]]:
    """The file, "" of all, and begin and end [s] of "60..120 s", "base.txt=1 min..2 min", "60 s.." or "..2 min".

    Raises ValueError, one sentence, for a text that is none.
    """
    file, _, span = text.rpartition("=")
    ends = [end.strip() for end in span.split("..")]
    if len(ends) != 2 or not any(ends):
        raise InputError(
            f'--part "{text}": must be FROM..TO, such as --part "60..120 s", --part "60 s.." or "..2 min".'
        )
    begin, end = ends
    if re.fullmatch(r"[0-9.eE+-]+", begin):  # of two numbers with one unit it is that of both
        begin += re.sub(r"^[0-9.eE+-]+", "", end)
    low = parse_quantity(begin, "s", "--part") if begin else 0.0
    high = parse_quantity(end, "s", "--part") if end else math.inf
    if not 0.0 <= low < high:
        raise InputError(
            f'--part "{text}": must begin at 0 or later and end after that; times are counted from the first sample.'
        )
    return file.strip(), (low, high)


def parts_of(texts: Iterable[str]) -> dict[str, tuple[float, float]]:
    """The parts of several files. Raises ValueError, one sentence, for two of one file."""
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, span = part_of(text)
        if name in found:
            raise InputError(f'--part "{text}": a part of {name or "all files"} is given twice; keep one.')
        found[name] = span
    return found


def span_text(span: tuple[float, float]) -> str:
    """Such a part [s] for people."""
    return f"{span[0]:.10g}..{span[1]:.10g} s" if span[1] < math.inf else f"{span[0]:.10g} s.."


def _seconds(text: str, mark: str) -> str:
    if ":" not in text:
        return ""
    clock, half = _without_half(re.sub(rf"{_ZONE}$", "", text).replace("T", " "))
    day, _, clock = clock.rpartition(" ")
    *hours, minutes, rest = re.sub(r":(\d{3})$", r".\1", clock.replace(",", ".")).split(":")
    whole, point, decimals = rest.partition(".")
    hour = int(hours[0]) if hours else 0
    hour = hour % 12 + (12 if half == "p" else 0) if half else hour  # noon is 12 PM, and midnight 12 AM
    seconds = 3600 * hour + 60 * int(minutes) + int(whole)
    if re.fullmatch(_ISO, day.strip()):
        year, month, number = map(int, day.split("-"))
        seconds += 86400 * (date(year, month, 1).toordinal() + number - 1 - date(1970, 1, 1).toordinal())
    return f"{seconds}{mark if point else ''}{decimals}"


def _without_half(text: str) -> tuple[str, str]:
    """A time without AM or PM, and which: "a", "p" or ""."""
    match = re.search(rf"{_HALF}$", text)
    half = (match[1] or "") if match else ""
    return (text[: match.start()] if match and half else text).rstrip(), half.lower()
