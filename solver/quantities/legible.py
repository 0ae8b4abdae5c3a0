"""Number formatting on every page, table and terminal, with and without intervals.

A number with an interval is rounded to the second digit of the half-width, any other to three or four digits. The minus
sign is U+2212; a power of ten replaces many zeros.
"""

from __future__ import annotations

import math

from .quantity import Quantity
from .units import raised, readable

DASH = "–"
NOT_DETERMINED = "not determined"
_PLAIN = (1e-4, 1e7)  # range without a power of ten
_FINEST = 8  # decimals
_ENDLESS = 10.0  # half-width over the number: an interval of 0.05 to 20 times a positive number


def number(value: float, digits: int = 3) -> str:
    """To ``digits`` significant digits, without trailing zeros; a dash for NaN."""
    if not math.isfinite(value):
        return DASH
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    if value and not _PLAIN[0] <= abs(value) < _PLAIN[1]:
        short = f"{float(mantissa):g}·10{raised(str(int(exponent)))}"
    else:
        places = digits - 1 - int(exponent)
        short = f"{round(value, places) + 0.0:.{max(places, 0)}f}"
        short = short.rstrip("0").rstrip(".") if "." in short else short
    return short.replace("-", "−")


def significant(value: float, digits: int = 4) -> str:
    """As :func:`number`, with trailing zeros: for columns of numbers without intervals."""
    short = number(value, digits)
    plain = short.lstrip("−").replace(".", "").lstrip("0")
    missing = digits - len(plain)
    if missing <= 0 or not plain or not short[-1].isdigit() or "·" in short:
        return short
    return short + ("" if "." in short else ".") + "0" * missing


def signed(value: float, digits: int = 2) -> str:
    """As :func:`number`, with its sign: a difference."""
    short = number(value, digits)
    return short if short[0] in "−–" or not value else f"+{short}"


def decimals(half: float) -> int:
    """Decimals that round a number to the second digit of its half-width, half > 0; negative for large numbers."""
    return 1 - math.floor(math.log10(half))


def rounded(value: float, half: float) -> str:
    """To the second digit of its half-width; as :func:`number` if it has none or one of very different magnitude."""
    if not (math.isfinite(value) and math.isfinite(half) and half > 0.0):
        return number(value, 4)
    places = decimals(half)
    if not -_FINEST < places <= _FINEST:
        return number(value, max(3, 1 + math.floor(math.log10(abs(value))) + places) if value else 3)
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}".replace("-", "−")  # no −0


def plus_minus(value: float, half: float) -> str:
    """A number and the half-width of its interval."""
    return f"{rounded(value, half)} ± {rounded(half, half)}"


def endless(value: float, ends: tuple[float, float] | None) -> bool:
    """Whether an interval of a positive number is too wide to be informative."""
    return ends is not None and ends[0] >= 0.0 and 0.5 * (ends[1] - ends[0]) > _ENDLESS * abs(value)


def interval(low: float, high: float) -> str:
    """Both ends; a dash if there are none."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return DASH
    half = 0.5 * (high - low)
    return f"{rounded(low, half)} … {rounded(high, half)}"


def with_interval(
    value: float, ends: tuple[float, float] | None, factor: float, bounded: bool = True
) -> tuple[str, str]:
    """A number and its interval in a unit, by the factor from SI; ends : None if it has none; bounded : False if the
    record does not determine it."""
    if not bounded:
        return number(factor * value), NOT_DETERMINED
    if ends is None:
        return number(factor * value, 4), DASH
    low, high = (factor * end for end in ends)
    return rounded(factor * value, 0.5 * (high - low)), interval(low, high)


def shown_in(quantity: Quantity) -> tuple[str, float]:
    """The display unit of a quantity, and its factor from SI."""
    return readable(quantity.unit, quantity.display)
