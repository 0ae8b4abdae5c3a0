"""Record files: measured channels, sampled uniformly. Units are read here, once; inside everything is SI.

``tables`` reads the file, ``columns`` says which column is which variable: a time, and ``<site>.<P|Q|R|D> [unit]`` in
the FMU's names; an empty cell or NaN is a gap. A diameter D is halved and becomes R. Channels that no fit can use
(dead, clipped, out of range) are refused here.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import polars as pl

from solver.errors import InputError
from solver.files import write_whole

from .columns import Reading, choose
from .sensors import KINDS, TIME, check_numbers, check_plateaus, check_ranges, constant_value, may_rest, refuse_constant
from .tables.kinds import read_table
from .tables.table import Column, Place, Table
from .time_axis import Part, time_axis, together

Array = np.ndarray


@dataclass(frozen=True)
class Record:
    """One recording: ``time`` : (n,) [s], uniform; ``channels`` : name -> (n,) in SI, NaN in gaps.

    path as given; sha256 of the file's bytes. Names end in .P [Pa], .Q [m³/s] or .R [m]. resting : flows that do not
    pulsate, such as that of a closed outlet, and their value; nothing can be fitted to them, so they are no channels.
    told : what was said of the columns, as ``Reading.told``, and what was done to the samples; said : that for people.
    scales : of each channel, SI over the unit that was read.
    """

    path: str
    sha256: str
    time: Array
    channels: Mapping[str, Array]
    resting: Mapping[str, float] = field(default_factory=dict)
    told: Mapping[str, Any] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)
    said: tuple[str, ...] = ()

    @property
    def dt(self) -> float:
        """Time between samples [s]."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    def require(self, names: Iterable[str]) -> None:
        """Raises ValueError that lists the channels unless all of ``names`` are there."""
        names = list(names)
        for name in names:
            if name in self.resting:
                value = f"{self.resting[name]:g} {KINDS['Q'].unit}"
                raise InputError(f"{self.path}: {name} is constant ({value}), it does not pulsate; leave it out.")
        require(self.channels, names, self.path)

    def site(self, name: str) -> tuple[Array, Array]:
        """P [Pa] and R [m] of a site, (n,) each. Raises ValueError if one is missing."""
        self.require((f"{name}.P", f"{name}.R"))
        return self.channels[f"{name}.P"], self.channels[f"{name}.R"]


def require(available: Iterable[str], names: Iterable[str], source: str) -> None:
    """Raises ValueError that lists what is ``available`` unless all of ``names`` are."""
    there = list(available)
    missing = [name for name in names if name not in there]
    if missing:
        raise InputError(
            f"{source}: the channel {' and '.join(missing)} is missing; it holds {', '.join(there)}: "
            "record it or ask for what is there."
        )


def read_record(path: str | os.PathLike[str], reading: Reading | None = None) -> Record:
    """The record in a file, and in those beside it; reading : which column is what, where their titles do not say it.

    Raises ValueError, one sentence with file, line and column, if a file cannot be read, and UnusableRecord, which is
    one, if it can be and no fit can use what it holds.
    """
    reading = reading or Reading()
    files = (path, *reading.beside)
    with ThreadPoolExecutor(1) as pool:
        digests = [
            pool.submit(_digest, file) for file in files
        ]  # of half a gigabyte as long as the numbers: beside them
        tables = [read_table(file, reading.decimal) for file in files]
        each = reading.each(tables) if reading.beside else [reading]
        records = [_one(tables.pop(0), own, digest.result()) for own, digest in zip(each, digests, strict=True)]
    first, *others = records
    if not others:
        return first
    time, channels, said = together([Part(r.path, r.time, r.channels) for r in records])
    told = {**reading.told, "with": {r.path: r.sha256 for r in others}}
    sampling = {r.path: r.told["sampling"] for r in records if "sampling" in r.told}
    return replace(
        first,
        time=time,
        channels=channels,
        resting={name: value for r in records for name, value in r.resting.items()},
        told=told | ({"sampling": sampling} if sampling else {}),
        scales={name: scale for r in records for name, scale in r.scales.items()},
        said=(*(text for r in records for text in r.said), said),
    )


def _one(table: Table, reading: Reading, sha256: str) -> Record:
    """The record in one file."""
    clock, chosen = choose(table, reading)
    place = table.place
    axis = time_axis(clock.column.values, clock.factor, clock.column.title, place)
    titles = {each.name: each.column.title for each in chosen}
    scales = {each.name: each.scale for each in chosen}
    channels: dict[str, Array] = {}
    resting: dict[str, float] = {}
    del table, clock
    while chosen:
        each = chosen.pop(0)  # what is not needed is not kept: a record may be large
        with np.errstate(over="ignore"):
            channels[each.name] = each.column.values * each.factor
        check_numbers(channels[each.name], each.column.title, place)
    check_ranges(channels, titles, place)
    for name, title in titles.items():
        constant = constant_value(channels[name])
        if constant is None:
            check_plateaus(channels[name], name, title, place)
        elif may_rest(name) and len(channels) > 1:
            del channels[name]
            resting[name] = constant
        else:
            refuse_constant(name, constant, title, place)
    channels = {name: axis.of(values) for name, values in channels.items()}
    return Record(place.source, sha256, axis.time, channels, resting, {**reading.told, **axis.told}, scales, axis.said)


def write_record(
    path: str | os.PathLike[str], time: Array, channels: Mapping[str, Array], units: Mapping[str, str] | None = None
) -> None:
    """Write a record, whole or not at all, as :func:`record_content` makes it. Raises ValueError as that does."""
    write_whole(path, record_content(path, time, channels, units))


def record_content(
    path: str | os.PathLike[str], time: Array, channels: Mapping[str, Array], units: Mapping[str, str] | None = None
) -> bytes:
    """The file of a record: time (n,) [s], channels in SI with NaN for gaps.

    path : for errors. units : by channel name, or "time"; default the SI unit of the kind. Each value reads back to a
    few units in the last place. Raises ValueError for a name that no record has, a unit that does not fit, or unequal
    lengths.
    """
    source, units = os.fspath(path), dict(units or {})
    time = np.asarray(time, float)
    for name in units:
        if name != "time" and name not in channels:
            raise InputError(f"{source}: a unit is given for {name}, which is not written; remove it.")
    columns = [Column(f"time [{units.get('time', 's')}]", time)]
    for name, values in channels.items():
        kind = KINDS.get(name.rpartition(".")[2], TIME)
        columns.append(Column(f"{name} [{units.get(name, kind.unit)}]", np.asarray(values, float)))
    clock, chosen = choose(Table(Place(source, header=1), columns), Reading())
    table = {}
    for each in (clock, *chosen):
        title, values = each.column.title, each.column.values
        if values.shape != (len(time),) or np.isinf(values).any():
            raise InputError(
                f"{source}: column {title!r} must be {len(time)} numbers, one per time, finite or NaN; "
                f"it has the shape {values.shape}."
            )
        table[title] = values / each.scale
    stream = io.BytesIO()
    pl.DataFrame(table).fill_nan(None).write_csv(stream)
    return stream.getvalue()


def _digest(path: str | os.PathLike[str]) -> str:
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:  # which the reading says
        return ""
