"""Which column of a file is which variable of a network, in which unit."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from solver.errors import InputError
from solver.network.files import parse_quantity
from solver.quantities.units import INFLOW

from .clock import parts_of, span_text
from .sensors import KINDS, TIME, Kind
from .table import Column, Place, Table, refuse
from .titles import advice as advised
from .titles import (
    between_samples,
    counts,
    factor,
    is_time,
    is_velocity,
    is_voltage,
    name_and_unit,
    of_velocity,
    of_voltage,
    proposed,
    unit_of,
)

_EXAMPLES = ("time [s]", "inlet.Q [mL/s]", "AA.P [mmHg]", "FA.P [mmHg]")
_START = "start"
ROW = "row"  # the number of a sample as its time, in a file without times
NO_TIME = (
    'no column is a time, and every sample needs one; add a column "time [s]", say which it is, '
    f'--map "TITLE=time [s]", or give the time between samples or their rate: --map "{ROW}=time [1 ms]", '
    f'--map "{ROW}=time [250 Hz]".'
)
CHANNELS = "<site>.P, <site>.Q, <site>.R or <site>.D (a diameter)"


@dataclass(frozen=True)
class Reading:
    """How a file is to be read. decimal : comma or point, by default found.

    names : title of a column, or its number from 1 -> variable, "AA.P" or with its unit "AA.P [mmHg]", or "time [s]";
    "" leaves the column out, "-AA.Q" turns its sign. "row" -> "time [2 ms]": there is no time, and a sample every 2 ms.
    If any is given, all columns that neither it nor the variables' names mention are left out. "Q.csv:2" is of the file
    of that name alone.
    beside : further files of the same recording. shifts : file -> seconds that are added to its times; None: it starts
    with the first file. parts : name of a file, "" of all -> begin and end [s] of the samples that are read, from the
    first one of the recording on.
    """

    decimal: str | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    beside: tuple[str, ...] = ()
    shifts: Mapping[str, float | None] = field(default_factory=dict)
    parts: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @staticmethod
    def from_options(
        pairs: Iterable[str] | None, decimal: str | None, beside: Iterable[str | os.PathLike[str]] | None = None,
        parts: Iterable[str] | None = None,
    ) -> Reading:  # fmt: skip
        """Of the options ``--map TITLE=VARIABLE``, ``--decimal``, ``--with FILE`` or ``FILE=SHIFT``, and ``--part``.
        Raises ValueError for one that is none."""
        names: dict[str, str] = {}
        for pair in pairs or ():
            title, equals, variable = (part.strip() for part in pair.rpartition("="))
            if not equals or not title:
                raise InputError(f'--map "{pair}": must be TITLE=VARIABLE, such as --map "Pressure (mmHg)=AA.P".')
            if title in names:
                raise InputError(f'--map "{pair}": the column {title!r} is given twice; keep one.')
            names[title] = variable
        files = [_shifted(os.fspath(file)) for file in beside or ()]
        shifts = {file: shift for file, shift in files if shift != 0.0}
        return Reading(decimal, names, tuple(file for file, _ in files), shifts, parts_of(parts or ()))

    def part(self, file: str | os.PathLike[str]) -> tuple[float, float] | None:
        """Begin and end [s] of the samples of a file that are read, None for all."""
        return self.parts.get(Path(file).name, self.parts.get(""))

    def each(self, tables: Sequence[Table]) -> list[Reading]:
        """The reading of each file of a recording, whose names are of its columns alone.

        Raises ValueError for a name that no file has.
        """
        files = [Path(table.place.source).name for table in tables]
        if len(set(files)) < len(files):
            raise InputError(
                f"{tables[0].place}: files of one recording need names that differ, not {', '.join(files)}."
            )
        found: list[dict[str, str]] = [{} for _ in tables]
        for title, variable in self.names.items():
            of = [title.removeprefix(f"{file}:") for file in files]
            there = [i for i, own in enumerate(of) if own != title] or range(len(tables))
            there = [i for i in there if _columns(tables[i].columns, of[i])] or [there[0]]  # which rejects it
            for i in there:
                found[i][of[i]] = variable
        return [replace(self, names=names) for names in found]

    @property
    def told(self) -> dict[str, Any]:
        """The options of the reading as plain data, for the provenance of a result; empty without options."""
        decimal = {} if self.decimal is None else {"decimal": self.decimal}
        shifts = {file: _START if shift is None else shift for file, shift in self.shifts.items()}
        parts = {file: span_text(span) for file, span in self.parts.items()}
        given = {"map": dict(self.names), "shift": shifts, "part": parts}
        return decimal | {name: value for name, value in given.items() if value}


@dataclass(frozen=True)
class Chosen:
    """A column that is read: its name in the record (D as R), kind, scale of its unit in SI, the variable that it was
    called, and -1 of one that is turned. Time is "time"."""

    column: Column
    name: str
    kind: Kind
    scale: float
    variable: str
    sign: float = 1.0

    @property
    def factor(self) -> float:
        """By which the values are multiplied: a diameter becomes a radius."""
        return self.sign * (self.scale / 2.0 if self.kind is KINDS["D"] else self.scale)


def choose(table: Table, reading: Reading) -> tuple[Chosen, list[Chosen]]:
    """The time and the channels of a table.

    Raises ValueError, one sentence with the column and the option that helps.
    """
    place, columns = table.place, list(table.columns)
    if ROW in reading.names and not _columns(columns, ROW):
        columns.append(Column(ROW, np.arange(float(len(columns[0].values)))))
    if not (table.titled or reading.names):
        row = ", ".join(f"{column.values[0]:g}" for column in columns)
        asked = which_is_which(len(columns), may_be_time(columns[0]))
        raise InputError(f"{place}: it has no header, and its first row is {row}; {asked}")
    targets = _targets(columns, reading, place)
    wanted = [(column, target) for column, target in zip(columns, targets, strict=True) if target is not None]
    times = [(column, target) for column, target in wanted if target[0] == "time"]
    if not times:
        _ask_time(columns, place)
    if len(times) > 1:
        titles = " and ".join(repr(column.title) for column, _ in times)
        refuse(place, None, times[1][0].title, f'{titles} are both a time; leave one out: --map "{times[1][0].title}="')
    titles_ = [column.title for column in columns]
    _check_cells(times[0][0], place)
    _check_names([column for column, target in wanted if _unknown(column, target)], columns, place)
    found = [_chosen(column, target, titles_, place) for column, target in wanted if target[0] != "time"]
    if not found:
        _check_names([column for column in columns if column is not times[0][0]], columns, place)
        raise InputError(
            f'{place}: there is no channel beside the time; name one "AA.P [mmHg]", or say which column it is: '
            '--map "Pressure (mmHg)=AA.P".'
        )
    for i, each in enumerate(found):
        for other in found[:i]:
            if other.name == each.name:
                both = "a name twice" if other.kind is each.kind else "R and D of one site"
                this = _option_name(each.column, columns)
                why = f'{both}; keep one of the two columns, --map "{this}=" leaves this one out'
                refuse(place, None, each.column.title, why)
    _check_clocks(times[0][0], found, columns, place)
    return _chosen(*times[0], titles_, place), found


def _check_clocks(clock: Column, chosen: Sequence[Chosen], columns: Sequence[Column], place: Place) -> None:
    """Raise InputError for a channel that ends where another column of times does, before the time that was chosen."""
    ends = {id(column): int(np.flatnonzero(~np.isnan(column.values)).max(initial=-1)) for column in columns}
    for other in columns:
        if other is clock or not 0 <= ends[id(other)] < ends[id(clock)]:
            continue
        timed = replace(other, values=other.values[: ends[id(other)] + 1])
        for each in chosen:
            if may_be_time(timed) and each.column is not other and ends[id(each.column)] == ends[id(other)]:
                why = (
                    f"it ends where the times of {other.title!r} do, and is of these; write both to a file of their "
                    "own, and give that beside this one with --with"
                )
                refuse(place, None, each.column.title, why)


def which_is_which(n: int, timed: bool = True) -> str:
    """What to say of n columns without titles: options to copy, an example. timed : whether the first may be a time."""
    maps = [f'--map "{i}={each}"' for i, each in enumerate(_EXAMPLES[not timed :][:n], start=1)]
    maps += [] if timed else [f'--map "{ROW}=time [1 ms]"']
    return f"say which column is which, such as {' '.join(maps)}."


def explained(table: Table, reading: Reading) -> list[tuple[bool, str]]:
    """For each column whether it is understood, and its meaning, or the option that must be given before it can be
    read; for people."""
    found = []
    titles = [column.title for column in table.columns]
    targets = _targets(table.columns, reading, table.place, False)
    wanted = [(column, target) for column, target in zip(table.columns, targets, strict=True) if target is not None]
    unknown = [column for column, target in wanted if _unknown(column, target)]
    asked = dict(zip(map(id, unknown), proposed(unknown), strict=True)) if len(unknown) > 1 else {}
    for column, target in zip(table.columns, targets, strict=True):
        try:
            if target is None:
                found.append((True, "left out"))
            elif not table.titled and not reading.names:
                found.append((False, "a column without a title"))
            elif asked.get(id(column)):
                option = f'--map "{_option_name(column, table.columns)}={asked[id(column)]}"'
                found.append((False, f"say what it is, such as {option}"))
            else:
                each = _chosen(column, target, titles, table.place)
                found.append((True, "time" if each.name == "time" else f"{each.name}, a {each.kind.noun}"))
        except InputError as error:
            found.append((False, str(error).rpartition(f"{column.title!r}: ")[2]))
    return found


def _shifted(text: str) -> tuple[str, float | None]:
    """The file and the seconds of FILE, FILE=SHIFT or FILE=start."""
    file, equals, shift = text.rpartition("=")
    if not equals or Path(text).exists():
        return text, 0.0
    return file, None if shift.strip() == _START else parse_quantity(shift, "s", f"--with {file}")


# --- one column ---------------------------------------------------------------------------------------------------


def _targets(
    columns: Sequence[Column], reading: Reading, place: Place, strict: bool = True
) -> list[tuple[str, str] | None]:
    """Variable and unit of each column, None where it is left out; strict: every name of the reading must be there."""
    given: dict[int, str] = {}
    for title, variable in reading.names.items():
        there = _columns(columns, title)
        if len(there) != 1 and strict:
            problem = "no column has this title or number"
            if there:
                numbers = " or ".join(f'--map "{i + 1}={variable}"' for i in there)
                problem = f"{len(there)} columns have this title; say which by its number, {numbers}"
            raise InputError(
                f'{place}: --map "{title}={variable}": {problem}; the columns are '
                f"{', '.join(repr(column.title) for column in columns)}."
            )
        for i in there:
            given[i] = variable
    stated = {name_and_unit(variable)[0].removeprefix("-") for variable in given.values()}
    return [_target(column, given.get(i), stated, bool(reading.names)) for i, column in enumerate(columns)]


def _columns(columns: Sequence[Column], title: str) -> list[int]:
    """Columns of this title, with its unit or without, or else of this number, from 1."""
    there = [i for i, column in enumerate(columns) if column.title == title]
    there = there or [i for i, column in enumerate(columns) if name_and_unit(column.title)[0] == title]
    by_number = not there and title.isdecimal() and 0 < int(title) <= len(columns)
    return [int(title) - 1] if by_number else there


def _target(column: Column, given: str | None, stated: set[str], named: bool) -> tuple[str, str] | None:
    name, unit = name_and_unit(column.title)[0], "s" if column.clock else unit_of(column)
    if given is not None:
        variable, own = name_and_unit(given)
        return (("time" if is_time(variable) else variable), own or unit) if given else None
    if is_time(name) or column.clock:
        return None if any(is_time(each) for each in stated) else ("time", unit)
    if _kind(name) is None and (named or _is_empty(column)):
        return None
    return None if named and name in stated else (name, unit)


def _is_empty(column: Column) -> bool:
    """Whether a column holds nothing, or only words: no channel, whatever its title."""
    only_words = column.fault is None or column.fault.words
    return only_words and len(column.values) > 0 and bool(np.isnan(column.values).all())


def _kind(name: str) -> Kind | None:
    site, _, letter = name.rpartition(".")
    return KINDS.get(letter) if site and site == site.strip() else None


def _chosen(column: Column, target: tuple[str, str], titles: Sequence[str], place: Place) -> Chosen:
    (given, unit), title = target, column.title
    name = given.removeprefix("-")
    kind = TIME if name == "time" else _kind(name)
    if kind is None:
        short = title if title else "column"
        if name != name_and_unit(title)[0]:
            refuse(place, None, title, f"{name!r} is no variable of a network; allowed are {CHANNELS}, such as AA.P")
        refuse(place, None, title, f"no such channel; allowed are {CHANNELS}: {advised(name, unit, short)}")
    _check_cells(column, place)
    if column.problem:
        refuse(place, None, title, f'{column.problem}; leave it out: --map "{title}=", or export it alike')
    scale = _factor(kind, name, unit, title, titles, place)
    site, _, letter = name.rpartition(".")
    return Chosen(column, f"{site}.R" if letter == "D" else name, kind, scale, given, 1.0 if given == name else -1.0)


def _unknown(column: Column, target: tuple[str, str]) -> bool:
    """Whether a column is read by its title, which is no variable."""
    return target[0] != "time" and _kind(target[0]) is None and target[0] == name_and_unit(column.title)[0]


def _option_name(column: Column, columns: Sequence[Column]) -> str:
    """What an option calls a column: its title, or its number if others have that title, too."""
    if sum(each.title == column.title for each in columns) == 1:
        return column.title
    return str(next(i for i, each in enumerate(columns, start=1) if each is column))


def _check_names(unknown: Sequence[Column], columns: Sequence[Column], place: Place) -> None:
    """Raise InputError with the options for all of them, if several columns have titles that are no variables."""
    if len(unknown) < 2:
        return
    maps = [
        f'--map "{_option_name(c, columns)}={target}"' for c, target in zip(unknown, proposed(unknown), strict=True)
    ]
    titles = ", ".join(repr(column.title) for column in unknown)
    speeds = [(c.title, unit) for c in unknown if is_velocity(unit := unit_of(c))]
    hints = f"; {of_velocity(speeds[0][0], INFLOW, speeds[0][1])}" if speeds else ""
    volts = [u for c, m in zip(unknown, maps, strict=True) if is_voltage(u := unit_of(c)) and not m.endswith('="')]
    hints += f"; where the unit is {volts[0]}, {of_voltage(volts[0], KINDS['P'])}" if volts else ""
    raise InputError(
        f"{place}: {titles} are no channels; allowed are {CHANNELS}, with any name of a site, and inlet.Q, the flow "
        f"into the arteries; say which is which, such as {' '.join(maps)} (an empty name leaves a column out: "
        f'--map "ECG="){hints}.'
    )


def _check_cells(column: Column, place: Place) -> None:
    """Raise InputError for a cell that is no number."""
    if column.fault is not None:
        refuse(place, column.fault.sample, column.title, column.fault.why)


def _factor(kind: Kind, name: str, unit: str, title: str, titles: Sequence[str], place: Place) -> float:
    """The factor from ``unit``, of a time also "2 ms", to the kind's SI unit."""
    if unit[:1].isdigit():
        try:
            return between_samples(unit, title) if kind is TIME else parse_quantity(unit, kind.unit, title)
        except InputError as error:
            raise InputError(f"{place}: {error}") from None
    found = factor(unit, kind)
    if found is not None:
        return found
    if not unit:
        bare = re.sub(r"\s*\[\s*\]$", "", name)
        example = f'--map "{title}={bare} [{kind.example}]", or write it behind the name in the file'
        refuse(place, None, title, f"it has no unit; say which: {example}")
    fits = next((each for each in (*KINDS.values(), TIME) if factor(unit, each) is not None), None)
    problem = (
        f"the unit {unit} is that of a {fits.noun}" if fits else f"the unit {unit} is not known or of another kind"
    )
    advice = f"write a unit of {kind.noun}, such as [{kind.example}]"
    if is_voltage(unit):
        problem, advice = f"the unit {unit} is that of a voltage", of_voltage(unit, kind)
    if kind is KINDS["Q"] and is_velocity(unit):
        problem, advice = f"the unit {unit} is that of a velocity", of_velocity(title, name, unit)
    if fits and _swapped(name, titles, kind):
        advice = "P and R of the site seem swapped, so exchange the two names or their units"
    refuse(place, None, title, f"{problem} and does not fit a {kind.noun}; {advice}")


def _ask_time(columns: Sequence[Column], place: Place) -> NoReturn:
    """Which column is the time: one that may be it, or none."""
    likely = next((column for column in columns if may_be_time(column)), None)
    if likely is None:
        raise InputError(f"{place}: {NO_TIME}")
    title, unit = likely.title, unit_of(likely)
    if not unit and counts(likely):
        why = "no column is named time; if this one counts the samples, give the time between them"
        refuse(place, None, title, f'{why}: --map "{title}=time [1 ms]"')
    asked = "time" if unit else "time [s]"
    refuse(place, None, title, f'no column is named time; if it is this one, say so: --map "{title}={asked}"')


def may_be_time(column: Column) -> bool:
    """Whether a column rises throughout, and neither its name nor its unit is that of something else."""
    name, unit = name_and_unit(column.title)[0], unit_of(column)
    other = _kind(name) is not None or (bool(unit) and factor(unit, TIME) is None)
    return not other and len(column.values) > 1 and bool((np.diff(column.values) > 0.0).all())


def _swapped(name: str, titles: Sequence[str], kind: Kind) -> bool:
    """Whether the site's other column of pressure and radius has the unit that this one should have."""
    site, _, own = name.rpartition(".")
    others = [f"{site}.{other}" for other in {"P": "RD", "R": "P", "D": "P"}.get(own, "")]
    return any(n in others and u and factor(u, kind) is not None for n, u in map(name_and_unit, titles))
