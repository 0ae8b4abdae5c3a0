"""Record files: measured channels, sampled uniformly. Units are read here, once; inside everything is SI.

``tables`` reads the file, ``columns`` says which column is which variable: a time, and ``<site>.<P|Q|R|D> [unit]`` in
the FMU's names; an empty cell or NaN is a gap. A diameter D is halved and becomes R. Channels that no fit can use
(dead, clipped, out of range) are rejected here.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.network.files import write_whole
from solver.quantities.units import INFLOW, of_signal

from .. import limits
from .columns import Chosen, Reading, choose
from .kinds import read_table
from .sensors import (
    KINDS,
    TIME,
    UnusableRecord,
    check_numbers,
    check_ranges,
    constant_value,
    without_codes,
    without_hum,
    without_plateaus,
    without_still,
)
from .table import Array, Column, Place, Table
from .time_axis import between, longest_block, rows_of, time_axis

# A Hamming window of 16 slow intervals has a transition of 3.3/16 = 0.2 of the slow rate f: from 0.3 f, as it was,
# to 0.5 f, gone
_HALF, _CUTOFF = 8, 0.8
_DATED = 1e8  # s: later times are since 1970


@dataclass(frozen=True)
class Record:
    """One recording: ``time`` : (n,) [s], uniform; ``channels`` : name -> (n,) in SI, NaN in gaps.

    path as given; sha256 of the file's bytes. Names end in .P [Pa], .Q [m³/s] or .R [m]. resting : flows that do not
    pulsate, such as that of a closed outlet, and their value; nothing can be fitted to them, so they are no channels.
    told : the options of the reading, as ``Reading.told``, and the changes of the samples; said : these changes as
    sentences. scales : of each channel, SI over the unit that was read. maps : of each channel the option --map, but
    for a unit, that reads it. origin : the first time of the file [s], of which a part was read.
    """

    path: str
    sha256: str
    time: Array
    channels: Mapping[str, Array]
    resting: Mapping[str, float] = field(default_factory=dict)
    told: Mapping[str, Any] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)
    maps: Mapping[str, str] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    origin: float | None = None

    @property
    def start(self) -> float:
        """The first time of the recording [s], whatever part of it was read."""
        return float(self.time[0]) if self.origin is None else self.origin

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


def require(available: Iterable[str], names: Iterable[str], source: str) -> None:
    """Raises ValueError that lists what is ``available`` unless all of ``names`` are."""
    there = list(available)
    missing = [name for name in names if name not in there]
    if missing:
        channel, it = ("channels", "them") if len(missing) > 1 else ("channel", "it")
        raise InputError(
            f"{source}: the {channel} {' and '.join(missing)} {'are' if len(missing) > 1 else 'is'} missing; it holds "
            f"{', '.join(there)}: record {it} or ask for what is there."
        )


def read_record(path: str | os.PathLike[str], reading: Reading | None = None) -> Record:
    """The record in a file, and in those beside it; reading : the meaning of columns whose titles do not state it.

    Raises ValueError, one sentence with file, line and column, if a file cannot be read, and UnusableRecord, which is
    one, if it can be and no fit can use what it holds.
    """
    reading = reading or Reading()
    tables = [read_table(file, reading.decimal) for file in (path, *reading.beside)]
    records: list[Record] = []
    for own in reading.each(tables) if reading.beside else [reading]:
        records += _of_one_file(tables.pop(0), own, records[0] if records else None)
    if len(records) == 1:
        return records[0]
    records = [records[0], *(_shifted(each, records[0], reading) for each in records[1:])]
    time, channels, note = together(records)
    beside = {r.path: r.sha256 for r in records if r.path != records[0].path}
    details = {**reading.told, **({"with": beside} if beside else {})}
    sampling = {r.path: r.told["sampling"] for r in records if "sampling" in r.told}
    return replace(
        records[0],
        time=time,
        channels=channels,
        resting={name: value for r in records for name, value in r.resting.items()},
        told=details | ({"sampling": sampling} if sampling else {}),
        scales={name: scale for r in records for name, scale in r.scales.items()},
        maps={name: option for r in records for name, option in r.maps.items()},
        said=(*(text for r in records for text in r.said), note),
    )


def _shifted(part: Record, first: Record, reading: Reading) -> Record:
    """A further file with its times on the clock of the first."""
    if part.path not in reading.shifts:
        return part
    shift = reading.shifts[part.path]
    shift = first.start - part.start if shift is None else shift
    return replace(
        part, time=part.time + shift, said=(*part.said, f"{shift:+.10g} s were added to the times of {part.path}.")
    )


def _of_one_file(table: Table, reading: Reading, first_file: Record | None) -> list[Record]:
    """The records in one file, one for each of the rates that its channels were sampled at. first_file : the record in
    the file that this one is beside, and whose part is read."""
    clock, chosen = choose(table, reading)
    place = table.place
    with open(place.source, "rb") as stream:
        sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    stamps, factor, origin = clock.column.values, clock.factor, None
    asked, notes = slice(0, len(stamps)), tuple[str, ...]()
    span = reading.part(first_file.path if first_file else place.source)
    if span is not None and np.isfinite(stamps).any():
        shift = reading.shifts.get(place.source, 0.0)
        origin = float(stamps[np.isfinite(stamps)][0]) * factor
        begin = first_file.start - shift if first_file and shift is not None else origin
        asked, notes = rows_of(stamps, factor, begin, span, place)
    inner, others = longest_block(stamps[asked], factor, replace(place, rows=range(asked.start, asked.stop)))
    block, notes = slice(asked.start + inner.start, asked.start + inner.stop), (*notes, *others)
    del table, stamps
    every = [_every(each.column.values[block]) for each in chosen]
    usual = min((rows for rows in every if rows is not None), key=lambda rows: rows[1], default=(0, 1))
    groups: dict[tuple[int, int], list[Chosen]] = {}
    for rows in every:
        groups.setdefault(rows or usual, []).append(chosen.pop(0))
    found = []
    for first, step in list(groups):
        mine = groups.pop((first, step))
        if step > 1:
            names = " and ".join(each.name for each in mine)
            notes = (
                *notes,
                f"{names} of {place}: one row in {step} has a value of its own, which is held or empty between; "
                "only these were read.",
            )
        used = replace(place, rows=range(block.start + first, block.stop, step))
        found.append(replace(_one(clock, mine, used, reading, sha256, notes), origin=origin))
        notes = ()
    return found


def _every(values: Array) -> tuple[int, int] | None:
    """The first row with a value of its own and the step to the next, of a channel that is held or empty between; None
    where too few differ to tell."""
    new = 1 + np.flatnonzero(~np.isnan(values[1:]) & (values[1:] != values[:-1]))
    if len(new) < limits.STEP_FEWEST:
        return None
    step = int(np.gcd.reduce(np.diff(new)))
    return (int(new[0]) % step, step) if len(new) > len(values) / step / 2 else (0, 1)


def _one(
    clock: Chosen, chosen: list[Chosen], place: Place, reading: Reading, sha256: str, notes: tuple[str, ...]
) -> Record:
    """The record of channels of one file that have one rate."""
    assert isinstance(place.rows, range)
    used = slice(place.rows.start, place.rows.stop, place.rows.step)
    axis = time_axis(clock.column.values[used], clock.factor, clock.column.title, place)
    titles = {each.name: each.column.title for each in chosen}
    scales = {each.name: each.scale for each in chosen}
    maps = {each.name: f"{each.column.title}={each.variable}" for each in chosen}
    channels: dict[str, Array] = {}
    resting: dict[str, float] = {}
    while chosen:
        each = chosen.pop(0)  # what is not needed is not kept: a record may be large
        with np.errstate(over="ignore"):
            channels[each.name] = each.column.values[used] * each.factor
        check_numbers(channels[each.name], each.column.title, place)
    notes += axis.said
    for name in channels:
        channels[name], codes = without_codes(channels[name], name, scales[name])
        channels[name], still = without_still(channels[name], name, axis.dt, place)
        notes += codes + still
    check_ranges(channels, titles, place)
    for name, title in titles.items():
        constant = constant_value(channels[name])
        if constant is None:
            channels[name], clipped = without_plateaus(channels[name], name, title, place, axis.dt)
            notes += clipped
        elif name.endswith(".Q") and name != INFLOW and len(channels) > 1:  # a closed outlet has such a flow
            del channels[name]
            resting[name] = constant
        else:
            unit, factor = of_signal(name)
            raise UnusableRecord(
                f"{place}: column {title!r}: the channel is constant ({factor * constant:.6g} {unit}), it does not "
                f'pulsate; check the sensor, or leave it out: --map "{title}=".'
            )
    for name in channels:
        channels[name], hum = without_hum(axis.of(channels[name]), name, axis.dt)
        notes += hum
    told = {**reading.told, **axis.told}
    return Record(place.source, sha256, axis.time, channels, resting, told, scales, maps, notes)


def together(parts: Sequence[Record]) -> tuple[Array, dict[str, Array], str]:
    """Several files on one axis, over the time that all have: time (n,) [s], the channels of all parts (n,), and a
    sentence on the alignment.

    The axis is that of the slowest file, the first of equals. Samples of a faster one are low-passed before they are
    taken there, lest noise beyond half the slow rate folds into the pulse. The other way round, harmonics that no
    sensor measured would count as measured, and free of noise.

    Raises ValueError, one sentence, where the times have nothing in common or two files have one channel.
    """
    base = max(parts, key=lambda p: round(p.dt / parts[0].dt, 4))
    low, high = max(p.time[0] for p in parts), min(p.time[-1] for p in parts)
    at = base.time[(base.time >= low - limits.LOST * base.dt) & (base.time <= high + limits.LOST * base.dt)]
    if len(at) < 2:
        spans = ", ".join(f"{p.path} from {_time_text(p.time[0])} to {_time_text(p.time[-1])}" for p in parts)
        raise InputError(
            f"{spans}: their times do not overlap; give files of one recording, stamped by one clock, or say what to "
            f'add to the times of one: --with "{parts[1].path}=SHIFT", as "0.3 s", or "start" if both start together.'
        )
    channels: dict[str, Array] = {}
    for part in parts:
        for name, values in part.channels.items():
            if name in channels:
                mine = f"{Path(part.path).name}:TITLE"
                raise InputError(
                    f'{part.path}: {name} is in another file, too; leave one out, --map "{mine}=", or say what it '
                    f'is, --map "{mine}=AA.P [mmHg]".'
                )
            channels[name] = _at(part, values, base, at)
    rates = ", ".join(
        f"{' and '.join(p.channels)} of {p.path} at {1.0 / p.dt:.6g} Hz from {p.time[0] - parts[0].time[0]:+.6f} s"
        for p in parts
    )
    note = f"{rates}: aligned by their times over {at[-1] - at[0]:.6g} s that all have, at {1.0 / base.dt:.6g} Hz"
    slowest = "" if base is parts[0] else ", the slowest"
    return at, channels, f"{note}, the rate of {' and '.join(base.channels)}{slowest}."


def _time_text(seconds: float) -> str:
    """A time for people: since midnight or the start in seconds, and since 1970 as a date."""
    if seconds < _DATED:
        return f"{round(seconds, 3) + 0.0:.10g} s"
    return f"{datetime.fromtimestamp(round(seconds, 3), UTC):%Y-%m-%d %H:%M:%S}"


def _at(part: Record, values: Array, base: Record, at: Array) -> Array:
    """A channel at the times ``at`` : (n,) of another file."""
    place = (at - part.time[0]) / part.dt
    near = np.clip(np.rint(place).astype(int), 0, len(values) - 1)
    gaps, ratio = np.isnan(values), base.dt / part.dt
    if ratio > 1.0 + limits.LOST:
        values = _low_passed(np.interp(part.time, part.time[~gaps], values[~gaps]), ratio)
    if np.abs(place - near).max() > limits.LOST:
        there = ~np.isnan(values)
        return np.where(gaps[near], np.nan, between(part.time[there], values[there], at))
    return np.where(gaps[near], np.nan, values[near])


def _low_passed(values: Array, ratio: float) -> Array:
    """Without the frequencies that a rate ``ratio`` times slower cannot show, and without delay."""
    from scipy.signal import firwin, oaconvolve  # takes half a second

    half = min(int(np.ceil(_HALF * ratio)), len(values) - 1)
    padded = np.pad(values, half, mode="reflect", reflect_type="odd")
    return np.asarray(oaconvolve(padded, firwin(2 * half + 1, _CUTOFF / ratio), mode="valid"))


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
    import polars as pl  # takes a fifth of a second

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
