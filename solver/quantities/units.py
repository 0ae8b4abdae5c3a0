"""Units: the meaning of a unit's text, and the display unit of a number. One table for the whole project.

Units are spelled as in pint and FMI, powers with ^, products with a dot: "Pa", "Pa.s/m^3", "m^2/(Pa.s)", "1". The text
determines the SI unit: an effect may use any unit made of the symbols below.
"""

from __future__ import annotations

import re
from fractions import Fraction

from ..errors import InputError

INFLOW = "inlet.Q"  # the channel of a record, and the input of an FMU, that drives a network
MMHG = 133.322387415  # conventional millimetre of mercury [Pa]

SIGNAL_UNITS = {"P": "Pa", "Q": "m^3/s", "R": "m"}  # by the last letter of a channel's name

# SI unit -> its display units, the usual one first
_READ = {
    "m": ("mm", "cm"),
    "s": ("ms",),
    "s^2": ("ms^2",),
    "Pa": ("mmHg", "MPa"),
    "1/Pa": ("10^-3/mmHg",),
    "Pa.s": ("kPa.s",),
    "Pa.s^2": ("kPa.s^2",),
    "m^3/s": ("mL/s",),
    "Pa.s/m^3": ("mmHg.s/mL",),
    "m^3/Pa": ("mL/mmHg",),
    "m^2/Pa": ("mm^2/mmHg",),
    "m^2/(Pa.s)": ("mm^2/(mmHg.s)",),
    "J/m": ("mJ/m",),
}

# symbol -> powers of kg, m, s, 10, MMHG and 60
_SYMBOLS = {
    "1": (0, 0, 0, 0, 0, 0),
    "10": (0, 0, 0, 1, 0, 0),
    "m": (0, 1, 0, 0, 0, 0),
    "s": (0, 0, 1, 0, 0, 0),
    "min": (0, 0, 1, 0, 0, 1),
    "g": (1, 0, 0, -3, 0, 0),
    "L": (0, 3, 0, -3, 0, 0),
    "Hz": (0, 0, -1, 0, 0, 0),
    "N": (1, 1, -2, 0, 0, 0),
    "J": (1, 2, -2, 0, 0, 0),
    "W": (1, 2, -3, 0, 0, 0),
    "Pa": (1, -1, -2, 0, 0, 0),
    "mmHg": (1, -1, -2, 0, 1, 0),
}
_PREFIXES = dict(zip("Mkcmu", (6, 3, -2, -3, -6), strict=True))
_FACTOR = re.compile(r"([./]?)(\(?)([A-Za-z]+|10?)(?:\^(-?\d+))?(\)?)")
_ONE = r"[A-Za-z]+(?:\^\d)?"
_PLAIN = re.compile(rf"{_ONE}(?:[./]{_ONE}|/\({_ONE}(?:\.{_ONE})*\))*")  # pint reads it alike


def base_units(unit: str) -> dict[str, int]:
    """Non-zero powers of the SI base units: "Pa.s" -> {"kg": 1, "m": -1, "s": -1}.

    Raises ValueError for a text that is no unit.
    """
    return {base: power for base, power in zip(("kg", "m", "s"), _powers(unit), strict=False) if power}


def display_factor(display: str) -> float:
    """The factor from SI to a display unit: "cm" -> 100. Raises ValueError as above."""
    *_, ten, mmHg, sixty = _powers(display)
    return float(float(f"1e{-ten}") / MMHG**mmHg if mmHg >= 0 else float(f"1e{-ten}") * MMHG**-mmHg) / 60.0**sixty


def exact_factor(given: str, wanted: str) -> Fraction | None:
    """The exact factor from one unit to another; None if they differ in kind, or are not made of the symbols above."""
    if not (_PLAIN.fullmatch(given) and _PLAIN.fullmatch(wanted)):
        return None
    try:
        a, b = _powers(given), _powers(wanted)
    except InputError:
        return None
    ten, mmHg, sixty = (x - y for x, y in zip(a[3:], b[3:], strict=True))
    factor = Fraction(10) ** ten * Fraction(str(MMHG)) ** mmHg * Fraction(60) ** sixty
    return factor if a[:3] == b[:3] else None


def display_units(unit: str) -> tuple[str, ...]:
    """The display units of an SI unit, the usual one first; none if it is displayed unchanged."""
    return _READ.get(unit, ())


def readable(unit: str, display: str | None = None) -> tuple[str, float]:
    """The display unit of an SI unit: the printed text and the factor from SI. display : overrides the usual one."""
    display = display or next(iter(display_units(unit)), None)
    return (printed(unit), 1.0) if display is None else (printed(display), display_factor(display))


def of_signal(channel: str) -> tuple[str, float]:
    """:func:`readable` of a channel by its name: "CA.P" -> mmHg."""
    return readable(SIGNAL_UNITS[channel[-1]])


def printed(unit: str) -> str:
    """The printed form of a unit: "Pa.s^2" as Pa·s², "1" as an empty text."""
    powers = re.sub(r"\^(-?\d+)", lambda power: raised(power[1]), unit)
    return "" if unit == "1" else powers.replace(".", "·")


def raised(power: str) -> str:
    """The digits of a power, raised: "-3" as ⁻³."""
    return power.translate(_RAISED)


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def _powers(unit: str) -> list[int]:
    """Powers of kg, m, s, 10, MMHG and 60. After a slash comes one factor, or several in brackets."""
    total, at, group = [0] * 6, 0, 1
    while at < len(unit):
        factor = _FACTOR.match(unit, at)
        known = _symbol(factor[3]) if factor else None
        if factor is None or known is None:
            raise InputError(f"unit {unit!r}: not understood at {unit[at:]!r}; write it like Pa.s, m^3/s, m^2/(Pa.s).")
        sign = -1 if factor[1] == "/" else 1
        if factor[2]:
            group, sign = sign, 1
        power = group * sign * int(factor[4] or 1)
        total = [t + power * k for t, k in zip(total, known, strict=True)]
        if factor[5]:
            group = 1
        at = factor.end()
    return total


def _symbol(text: str) -> tuple[int, ...] | None:
    if text in _SYMBOLS:
        return _SYMBOLS[text]
    known = _SYMBOLS.get(text[1:]) if text[0] in _PREFIXES and text[1:] != "mmHg" else None
    return known and (*known[:3], known[3] + _PREFIXES[text[0]], *known[4:])
