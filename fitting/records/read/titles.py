"""The titles of columns: name and unit in the spellings that laboratories use."""

from __future__ import annotations

import re
from contextlib import suppress
from functools import lru_cache

from solver.errors import InputError
from solver.network.files import parse_quantity
from solver.quantities.units import base_units

from .sensors import KINDS, TIME, Kind

_TIMES = {"t", "time", "zeit", "temps", "tiempo", "tempo", "tijd", "tid", "elapsed time", "relative time"}
_TIMES |= {"timestamp", "timestamps", "time stamp", "time and date"}
_PLAIN = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("minute", "minutes", "minuten", "mins"), "min"),
    **dict.fromkeys(("mmhg", "mm hg", "torr"), "mmHg"),
    **dict.fromkeys(("cmh2o", "cm h2o"), "cmH2O"),
    **{f"{a}3/{b}": f"{a}^3/{b}" for a in ("m", "cm", "mm") for b in ("s", "min")},
    **{f"{a}l/{b}": f"{a}L/{c}" for a in ("m", "") for b, c in (("sec", "s"), ("min", "min"), ("s", "s"))},
}
# units that may follow a name without brackets; a bare m or L is as often "mean" or "left"
_BARE = re.compile(
    r"(.+?)(?:_|\s*/\s*|\s*,\s*|\s+in\s+|\s+)"
    r"(mm ?Hg|k?Pa|hPa|mbar|cm ?H2O|mm|cm|[uµμ]m|(?:m?l)/(?:s|sec|min)|m?s|m?secs?|min|[uµμ]s)",
    re.IGNORECASE,
)


def name_and_unit(title: str) -> tuple[str, str]:
    """Name and unit of "name [unit]", "name (unit)", "name_unit", "name / unit" or "name in unit"; "" if there is none.

    In round brackets, and without brackets, only what is a unit of a time, pressure, flow or length is one.
    """
    title = title.strip()
    if match := re.fullmatch(r"(.*?)\s*\[([^\[\]]*)\]", title, re.DOTALL):
        return match[1], match[2].strip()
    if (match := re.fullmatch(r"(.*?)\s*\(([^()]*)\)", title, re.DOTALL)) and is_unit(match[2]):
        return match[1], match[2].strip()
    if match := _BARE.fullmatch(title):
        time = factor(match[2], TIME) is not None
        if time == (match[1].strip().lower() in _TIMES):
            return match[1].strip(), match[2]
    if title.lower() in ("s", "ms", "min", "sec", "msec", "seconds"):  # a unit alone, as Biopac writes it
        return "time", title
    return title, ""


def is_time(name: str) -> bool:
    """Whether this is the name of a time."""
    return name.strip().lower() in _TIMES


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that a record holds."""
    return any(factor(text, kind) is not None for kind in (TIME, *KINDS.values()))


def between_samples(text: str, name: str) -> float:
    """The time between samples [s] of "2 ms", or of their rate, "250 Hz". Raises InputError for a rate of 0."""
    rate = re.fullmatch(r"(.*?)\s*(k?)hz", text, re.IGNORECASE)
    if rate is None:
        return parse_quantity(text, TIME.unit, name)
    found = parse_quantity(f"{rate[1]} {rate[2].lower()}Hz", "Hz", name)
    if not found > 0.0:
        raise InputError(f'{name} = "{text}": must be a positive rate, such as "250 Hz".')
    return 1.0 / found


@lru_cache(maxsize=256)
def factor(unit: str, kind: Kind) -> float | None:
    """The factor from a unit to the kind's SI unit, None if it is none of the kind."""
    text = _PLAIN.get(unit.strip().lower(), unit.strip())
    # pint, which takes half a second to start, is not asked about titles, nor about units of another kind
    if not text or is_time(text) or "[" in text or text.count("(") != text.count(")"):
        return None
    with suppress(InputError):
        if base_units(text) != base_units(kind.unit):
            return None
    try:
        found = parse_quantity(f"1 {text}", kind.unit, unit)
    except InputError:
        return None
    return found if found > 0.0 else None
