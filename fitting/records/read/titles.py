"""The titles of columns: name and unit in the spellings of laboratories, and proposals for titles that are no
variables."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import count

import numpy as np

from solver.errors import InputError
from solver.network.files import parse_quantity
from solver.quantities.units import INFLOW, base_units

from .sensors import KINDS, TIME, Kind
from .table import Column

_TIMES = {"t", "time", "zeit", "temps", "tiempo", "tempo", "tijd", "tid", "elapsed time", "relative time"}
_TIMES |= {"timestamp", "timestamps", "time stamp", "time and date"}
_PLAIN = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("minute", "minutes", "minuten", "mins"), "min"),
    **dict.fromkeys(("mmhg", "mm hg", "torr"), "mmHg"),
    **dict.fromkeys(("cmh2o", "cm h2o"), "cmH2O"),
    **dict.fromkeys(("dyn/cm2", "dyne/cm2", "dynes/cm2"), "dyn/cm^2"),
    **{"n/m2": "N/m^2", "kpa": "kPa", "psi": "psi", "cmh20": "cmH2O", "lpm": "L/min"},  # cmH2O, with a zero
    **{f"{a}l{x}{b}-1": f"{a}L/{b}" for a in ("m", "") for b in ("s", "min") for x in (".", "·", "*", " ")},
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

    In round brackets only units of time, pressure, flow, length, velocity or volts count as units, and without
    brackets only the first four.
    """
    title = title.strip()
    if match := re.fullmatch(r"(.*?)\s*\[([^\[\]]*)\]", title, re.DOTALL):
        return match[1], match[2].strip()
    if match := re.fullmatch(r"(.*?)\s*\(([^()]*)\)", title, re.DOTALL):
        if is_unit(match[2]) or is_voltage(match[2]) or is_velocity(match[2]):
            return match[1], match[2].strip()
    if match := _BARE.fullmatch(title):
        time = factor(match[2], TIME) is not None
        if time == (match[1].strip().lower() in _TIMES):
            return match[1].strip(), match[2]
    if title.lower() in ("s", "ms", "min", "sec", "msec", "seconds"):  # a unit alone, as Biopac writes it
        return "time", title
    return title, ""


def unit_of(column: Column) -> str:
    """The unit of a column, by its title or where the file says it elsewhere."""
    return name_and_unit(column.title)[1] or column.unit


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


# --- what a column may be whose title is no variable --------------------------------------------------------------


def proposed(unknown: Sequence[Column]) -> list[str]:
    """A variable for each column, by unit and title; "" if it is none. Each of a kind has a site of its own."""
    targets, taken, pressures = list[str](), set[str](), 0
    for column in unknown:
        name, unit = name_and_unit(column.title)[0], unit_of(column)
        letter = "" if counts(column) else _letter(name, unit)
        pressures += letter == "P"
        sites = ("Ao" if i < 2 else f"site{i}" for i in count(max(pressures, 1)))
        free = next(site for site in sites if f"{site}.{letter.replace('D', 'R')}" not in taken)
        target = f"{free}.{letter}" if letter else ""
        target = INFLOW if letter == "Q" and INFLOW not in taken else target
        taken.add(target.replace(".D", ".R"))
        targets.append(target if is_unit(unit) or not letter else f"{target} [{KINDS[letter].example}]")
    return targets


def _letter(name: str, unit: str) -> str:
    """The kind that unit and title of a column suggest; "" of none."""
    units = [letter for letter, kind in KINDS.items() if unit and factor(unit, kind) is not None]
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)  # AoDiam
    words = [letter for letter, spelled in _WORDS.items() if spelled.search(name) or spelled.search(apart)]
    volts = is_voltage(unit)
    if (unit and not units and not volts) or _OTHER.search(name):
        return ""
    return next((each for each in words if not units or each in units), units[0] if units else "" if volts else "P")


def advice(name: str, unit: str, title: str) -> str:
    """What to say of a column whose name is no variable: an option that fits its unit, or else the words of its title.

    A unit that none of them has, and a title such as ECG, is that of something else.
    """
    letter, drop = _letter(name, unit), f'leave it out with --map "{title}="'
    if is_velocity(unit):
        return f"{of_velocity(title, INFLOW, unit)}, or {drop}"
    if not letter:
        foreign = unit and not is_unit(unit)
        return f"{unit} is a unit of none of them; {drop}" if foreign else f"if it is none of them, {drop}"
    words = any(spelled.search(name) for spelled in _WORDS.values())
    target = INFLOW if letter == "Q" else f"AA.{letter}"
    target = target if is_unit(unit) else f"{target} [{KINDS[letter].example}]"
    noun = KINDS[letter].noun
    which = "say which it is with" if words else f"if it is a {noun}, say so with"
    return f'rename it, {which} --map "{title}={target}", or {drop}'


def is_velocity(unit: str) -> bool:
    """Whether a unit is that of a velocity, as of an ultrasound probe."""
    try:
        return "/" in unit and base_units(unit) == base_units("m/s")
    except InputError:
        return False


def is_voltage(unit: str) -> bool:
    """Whether a unit is that of a signal that is not calibrated, or of a converter's range, as LabChart prints it."""
    return unit.strip() in ("V", "mV")


def of_voltage(unit: str, kind: Kind) -> str:
    """What to say of a column of volts that are a pressure, a flow or a length."""
    given = f"[50 {kind.example}] if that is 50 {kind.example}"
    return f"give what one {unit} is as its unit, {given}, or [{kind.example}] if it was calibrated"


def of_velocity(title: str, name: str, unit: str) -> str:
    """What to say of a column of velocities."""
    return f'a velocity becomes a flow by the area of its vessel, here 4 cm^2: --map "{title}={name} [4 cm^2*{unit}]"'


def counts(column: Column) -> bool:
    """Whether a column counts the rows."""
    return len(column.values) > 1 and bool((np.diff(column.values) == 1.0).all())


_WORDS = {
    letter: re.compile(rf"(?<![a-z])({spelled})", re.IGNORECASE)
    for letter, spelled in (
        ("D", "diam|durchmesser|d(?![a-z])"),
        ("R", "radi|r(?![a-z])"),
        ("Q", "flow|fluss|débit|debit|q(?![a-z])|(?-i:[A-Z][a-z]+F(?![a-zA-Z]))"),
        ("P", "press|druck|abp|cath|p(?![a-z])|(?-i:[A-Z][a-z]+P(?![a-zA-Z]))"),
    )
}
# no signal of a systemic artery: other signals, numbers that are derived of one, other places, and foreign units
_OTHER = re.compile(
    r"(?<![a-z])(ecg|ekg|eeg|emg|resp|temp|trigger|marker|spo2|etco2|index|sample|d[pqv]/?dt|output|stroke|mean|"
    r"lvp|lvedp|rvp|cvp|pap|pcwp|icp|iap|paw|ventric|venous|vein|vena|cava|airway|wedge|pulmon|"
    r"(lv|rv|hr|sv|co|map|sbp|dbp)(?![a-z]))|[\[(]([mµu]?v|bpm|%|°c|hz|[^()]*/s)[\])]$",
    re.IGNORECASE,
)
