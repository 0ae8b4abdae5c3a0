"""Numbers as people read them: how every page, table and terminal writes a number, and one with its interval.

A number that has an interval is written to the second digit of half of it, any other to three or four digits. Minus is
the true one; a power of ten stands only where a number would else have many zeros.
"""

from __future__ import annotations

import math

from .quantity import Quantity
from .units import raised, readable

DASH = "–"
NOT_DETERMINED = "not determined"
_PLAIN = (1e-4, 1e7)  # between them no power of ten
_FINEST = 8  # decimals
_ENDLESS = 10.0  # times a number: an interval of half that width, 0.05 to 20 times a number that is positive


def number(value: float, digits: int = 3) -> str:
    """To ``digits`` significant digits, zeros at the end left out; a dash for what is not a number."""
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
    """As :func:`number`, zeros at the end kept: for columns of numbers without intervals."""
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
    """Decimals that show a number to the second digit of half its interval, half > 0; negative for large numbers."""
    return 1 - math.floor(math.log10(half))


def rounded(value: float, half: float) -> str:
    """To the second digit of half its interval; as :func:`number` where it has none or that is far from its size."""
    if not (math.isfinite(value) and math.isfinite(half) and half > 0.0):
        return number(value, 4)
    places = decimals(half)
    if not -_FINEST < places <= _FINEST:
        return number(value, max(3, 1 + math.floor(math.log10(abs(value))) + places) if value else 3)
    return f"{round(value, places) + 0.0:.{max(places, 0)}f}".replace("-", "−")  # no −0


def plus_minus(value: float, half: float) -> str:
    """A number and half its interval."""
    return f"{rounded(value, half)} ± {rounded(half, half)}"


def endless(value: float, ends: tuple[float, float] | None) -> bool:
    """Whether an interval of a positive number is so wide that it says nothing of it."""
    return ends is not None and ends[0] >= 0.0 and 0.5 * (ends[1] - ends[0]) > _ENDLESS * abs(value)


def interval(low: float, high: float) -> str:
    """Both ends; a dash where they are none."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return DASH
    half = 0.5 * (high - low)
    return f"{rounded(low, half)} … {rounded(high, half)}"


def shown_in(quantity: Quantity) -> tuple[str, float]:
    """The unit that people read a quantity in, and its factor from SI."""
    return readable(quantity.unit, quantity.display)
