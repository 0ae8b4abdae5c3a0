"""Record files: measured channels in one CSV, sampled uniformly. Units are read here, once; inside everything is SI.

The first column is ``time [s]``, then ``<site>.<P|Q|R|D> [unit]`` in the FMU's names; a missing unit is SI, an empty
cell or NaN is a gap. A diameter D is halved and becomes R. Reading is by polars; where it stumbles, the file is gone
through cell by cell to say where and why. Channels that no fit can use (dead, clipped, out of range) are refused here.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
import os
import re
from array import array
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from solver.files import parse_quantity, write_whole

from .sensors import (
    KINDS,
    Kind,
    check_numbers,
    check_plateaus,
    check_ranges,
    constant_value,
    may_rest,
    refuse,
    refuse_constant,
)
from .time_axis import uniform

Array = np.ndarray


_TIME = Kind("time", "s", "s")

_LONGEST_HEADER = 1 << 20  # bytes
_ZIP = b"PK\x03\x04"  # how an archive begins


@dataclass(frozen=True)
class Record:
    """One CSV file: ``time`` : (n,) [s], uniform; ``channels`` : name -> (n,) in SI, NaN in gaps.

    path as given; sha256 of the file's bytes. Names end in .P [Pa], .Q [m³/s] or .R [m]. resting : flows that do not
    pulsate, such as that of a closed outlet, and their value; nothing can be fitted to them, so they are no channels.
    """

    path: str
    sha256: str
    time: Array
    channels: Mapping[str, Array]
    resting: Mapping[str, float] = field(default_factory=dict)

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
                raise ValueError(f"{self.path}: {name} is constant ({value}), it does not pulsate; leave it out.")
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
        raise ValueError(
            f"{source}: the channel {' and '.join(missing)} is missing; it holds {', '.join(there)}: "
            "record it or ask for what is there."
        )


def read_record(path: str | os.PathLike[str]) -> Record:
    """The record in a CSV file.

    Raises ValueError, one sentence with file, line and column, if the file or one of its channels cannot be used.
    """
    source = str(path)
    if os.path.exists(path) and not os.path.isfile(path):
        raise ValueError(f"{source}: cannot be read (not a regular file); give the name of a CSV file.")
    try:
        with open(path, "rb") as stream, ThreadPoolExecutor(1) as pool:
            digest = pool.submit(_digest, path)  # of half a gigabyte it takes as long as the numbers: beside them
            titles = _titles(stream.readline(_LONGEST_HEADER), source)
            names, kinds, factors = _columns(titles, source)
            columns = _read_columns(path, titles, source)
            sha256 = digest.result()
    except OSError as error:
        raise ValueError(f"{source}: cannot be read ({error.strerror}); check the path.") from None
    time = uniform(columns[0], factors[0], titles[0], source)
    channels: dict[str, Array] = {}
    resting: dict[str, float] = {}
    for i, (name, kind) in enumerate(zip(names, kinds, strict=True), start=1):
        with np.errstate(over="ignore"):
            channels[name] = columns[i] * (factors[i] / 2.0 if kind == "D" else factors[i])
        columns[i] = np.empty(0)  # as soon as it is not needed: a record may be large
        check_numbers(channels[name], name, titles[i], source)
    check_ranges(channels, dict(zip(names, titles[1:], strict=True)), source)
    for name, title in zip(names, titles[1:], strict=True):
        constant = constant_value(channels[name])
        if constant is None:
            check_plateaus(channels[name], name, title, source)
        elif may_rest(name) and len(channels) > 1:
            del channels[name]
            resting[name] = constant
        else:
            refuse_constant(name, constant, title, source)
    return Record(source, sha256, time, channels, resting)


def write_record(
    path: str | os.PathLike[str], time: Array, channels: Mapping[str, Array], units: Mapping[str, str] | None = None
) -> None:
    """Write a record, whole or not at all: time (n,) [s], channels in SI with NaN for gaps.

    units : by channel name, or "time"; default the SI unit of the kind. Each value reads back to a few units in the
    last place. Raises ValueError for a name that no record has, a unit that does not fit, or unequal lengths.
    """
    source, units = os.fspath(path), dict(units or {})
    time = np.asarray(time, float)
    for name in units:
        if name != "time" and name not in channels:
            raise ValueError(f"{source}: a unit is given for {name}, which is not written; remove it.")
    titles = [f"time [{units.get('time', 's')}]"]
    for name in channels:
        kind = KINDS.get(name.rpartition(".")[2], _TIME)
        titles.append(f"{name} [{units.get(name, kind.unit)}]")
    factors = _columns(titles, source)[2]
    table = {}
    for title, values, factor in zip(titles, (time, *channels.values()), factors, strict=True):
        values = np.asarray(values, float)
        if values.shape != (len(time),) or np.isinf(values).any():
            raise ValueError(
                f"{source}: column {title!r} must be {len(time)} numbers, one per time, finite or NaN; "
                f"it has the shape {values.shape}."
            )
        table[title] = values / factor
    stream = io.BytesIO()
    pl.DataFrame(table).fill_nan(None).write_csv(stream)
    write_whole(path, stream.getvalue())


# --- the header ---------------------------------------------------------------------------------------------------


def _digest(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _titles(line: bytes, source: str) -> list[str]:
    """The fields of the first line."""
    line = line.removeprefix(codecs.BOM_UTF8)
    if not line:
        raise ValueError(f"{source}: the file is empty; it must hold a header and samples.")
    text = _decode(line, source).strip("\r\n").partition("\r")[0]
    try:
        titles = next(csv.reader([text], skipinitialspace=True, strict=True), [])
    except csv.Error as error:
        raise ValueError(f"{source}: line 1: not a CSV header ({error}); write time [s],AA.P [mmHg], ...") from None
    if len(titles) < 2:
        for mark, word in ((";", "semicolons"), ("\t", "tabs")):
            if mark in text:
                raise ValueError(
                    f"{source}: line 1: the fields are separated by {word}; "
                    "save it with commas between the fields and points as decimal marks."
                )
    return [title.strip() for title in titles]


def _decode(data: bytes, source: str) -> str:
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if data.startswith(_ZIP):
            raise ValueError(f"{source}: not a recording but an FMU or another archive; give a CSV file.") from None
        raise ValueError(f"{source}: not UTF-8 text (byte {error.start}); save it as CSV in UTF-8.") from None


def _columns(titles: list[str], source: str) -> tuple[list[str], list[str], list[float]]:
    """Channel names (D as R), kinds, and the factor to SI of every column, time first."""
    parts = [name_and_unit(title) for title in titles]
    if not parts or parts[0][0].lower() != "time":
        refuse(
            source, 1, titles[0] if titles else "", "the first column must be the time; name it 'time [s]', in brackets"
        )
    if len(parts) == 1:
        raise ValueError(f"{source}: line 1: there is no channel beside the time; add one, such as 'AA.P [mmHg]'.")
    names: list[str] = []
    kinds: list[str] = []
    factors = [_factor(_TIME, parts[0][1], titles, source, titles[0])]
    for title, (name, unit) in zip(titles[1:], parts[1:], strict=True):
        site, _, kind = name.rpartition(".")
        if kind not in KINDS or not site or site != site.strip():
            refuse(
                source,
                1,
                title,
                "no such channel; allowed are <site>.P, <site>.Q, <site>.R and <site>.D (a diameter), "
                "such as 'AA.P [mmHg]'",
            )
        factors.append(_factor(KINDS[kind], unit, titles, source, title))
        own = f"{site}.R" if kind == "D" else name
        if own in names:
            both = "a name twice" if kinds[names.index(own)] == kind else "R and D of one site"
            refuse(source, 1, title, f"{both}; keep one of the two columns")
        names.append(own)
        kinds.append(kind)
    return names, kinds, factors


def name_and_unit(title: str) -> tuple[str, str]:
    """Name and unit of "name [unit]"; the unit may be missing."""
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\])?", title.strip(), re.DOTALL)
    return (match[1], (match[2] or "").strip()) if match else (title, "")


def _factor(kind: Kind, unit: str, titles: list[str], source: str, title: str) -> float:
    """The factor from ``unit`` to the kind's SI unit."""
    factor = _convert(unit, kind.unit)
    if factor is not None and factor > 0.0:
        return factor
    fits = next((each for each in KINDS.values() if _convert(unit, each.unit) is not None), None)
    what = f"the unit {unit} is that of a {fits.noun}" if fits else f"the unit {unit} is not known or of another kind"
    advice = f"write a unit of {kind.noun}, such as [{kind.example}]"
    if fits and _other_is(title, titles, kind):
        advice = "P and R of the site seem swapped, so exchange the two names or their units"
    refuse(source, 1, title, f"{what} and does not fit a {kind.noun}; {advice}")


def _convert(unit: str, wanted: str) -> float | None:
    try:
        return parse_quantity(f"1 {unit}", wanted, unit)
    except ValueError:
        return None


def _other_is(title: str, titles: list[str], kind: Kind) -> bool:
    """Whether the site's other column of pressure and radius has the unit that this one should have."""
    name = name_and_unit(title)[0]
    site, _, own = name.rpartition(".")
    others = {"P": ("R", "D"), "R": ("P",), "D": ("P",)}.get(own, ())
    return any(
        n in [f"{site}.{o}" for o in others] and u and _convert(u, kind.unit) for n, u in map(name_and_unit, titles)
    )


# --- the numbers --------------------------------------------------------------------------------------------------


def _read_columns(path: str | os.PathLike[str], titles: list[str], source: str) -> list[Array]:
    """One float array per column, NaN in gaps."""
    schema = {str(i): pl.Float64() for i in range(len(titles))}
    try:
        frame = pl.read_csv(Path(path), has_header=False, skip_rows=1, schema=schema, glob=False)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException):  # its CSV reader panics on some broken files
        return _read_slowly(path, titles, source)
    # polars fills up a row that is too short, and takes line ends of old spreadsheets for part of the header
    if frame.height == 0 or (frame[:, -1].null_count() and _commas(path) != (frame.height + 1) * (len(titles) - 1)):
        return _read_slowly(path, titles, source)
    return [frame[name].fill_null(np.nan).rechunk().to_numpy() for name in frame.columns]


def _commas(path: str | os.PathLike[str]) -> int:
    with open(path, "rb") as stream:
        return sum(block.count(b",") for block in iter(lambda: stream.read(1 << 22), b""))


_NUMBER = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf(?:inity)?)|nan|", re.IGNORECASE | re.ASCII
)


def _read_slowly(path: str | os.PathLike[str], titles: list[str], source: str) -> list[Array]:
    """The same cell by cell: for files with spaces in the cells, and to say where a bad cell is."""
    numbers = array("d")
    text = _decode(Path(path).read_bytes(), source).rstrip("\r\n")
    rows = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        next(rows)
        for row in rows:
            if len(row) != len(titles):
                raise ValueError(
                    f"{source}: line {rows.line_num}: {len(row)} fields where the header has {len(titles)}; "
                    "complete or remove the line (gaps are empty fields; decimal marks are points)."
                )
            numbers.extend(
                _number(cell.strip(), source, rows.line_num, title) for cell, title in zip(row, titles, strict=True)
            )
    except csv.Error as error:
        raise ValueError(f"{source}: line {rows.line_num}: not CSV ({error}); correct the line.") from None
    if not numbers:
        raise ValueError(f"{source}: line 2: there are no samples below the header; add them.")
    return list(np.ascontiguousarray(np.array(numbers).reshape(-1, len(titles)).T))


def _number(text: str, source: str, line: int, title: str) -> float:
    if not _NUMBER.fullmatch(text):
        hint = "write the decimal mark as a point" if "," in text else "write a number, or nothing for a gap"
        refuse(source, line, title, f"{text[:40]!r} is not a number; {hint}")
    return float(text or "nan")
