"""Record files: measured channels in one CSV, sampled uniformly. Units are read here, once; inside everything is SI.

The first column is ``time [s]``, then ``<site>.<P|Q|R|D> [unit]`` in the FMU's names; a missing unit is SI, an empty
cell or NaN is a gap. A diameter D is halved and becomes R. Reading is by polars; where it stumbles, the file is gone
through cell by cell to say where and why. Channels that no fit can use (dead, clipped, out of range) are refused here.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from array import array
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import polars as pl

from solver.files import parse_quantity, write_whole

Array = np.ndarray


@dataclass(frozen=True)
class Kind:
    """What a channel measures: its noun, SI unit, the unit a sentence proposes, and the range of any artery."""

    noun: str
    unit: str
    example: str
    low: float = -np.inf
    high: float = np.inf


KINDS: dict[str, Kind] = {
    "P": Kind("pressure", "Pa", "mmHg", -1e5, 1e6),
    "Q": Kind("flow", "m^3/s", "mL/s"),
    "R": Kind("radius", "m", "mm", 1e-5, 0.2),
    "D": Kind("diameter", "m", "mm", 2e-5, 0.4),
}
_TIME = Kind("time", "s", "s")

_FLAT = 1e-9  # a channel that varies by less than this share of its size is dead
_RUN = 4  # equal samples at the extreme that may be a plateau
_STEEP = 12.0  # quanta that a signal falls beside a plateau of a clipped channel; rounding alone makes fewer
_VALVE = 0.05  # share of its range within which a flow may rest near zero: a closed valve, not a clipped sensor
_WIDE = 0.03  # [m]; no radius but a pressure in the wrong column if the site's pressure is small
_SHORTEST = 8  # samples


@dataclass(frozen=True)
class Record:
    """One CSV file: ``time`` : (n,) [s], uniform; ``channels`` : name -> (n,) in SI, NaN in gaps.

    path as given; sha256 of the file's bytes. Names end in .P [Pa], .Q [m³/s] or .R [m].
    """

    path: str
    sha256: str
    time: Array
    channels: Mapping[str, Array]

    @property
    def dt(self) -> float:
        """Time between samples [s]."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    def require(self, names: Iterable[str]) -> None:
        """Raises ValueError that lists the channels unless all of ``names`` are there."""
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
    source = os.fspath(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise ValueError(f"{source}: cannot be read ({error.strerror}); check the path.") from None
    with ThreadPoolExecutor(1) as pool:
        digest = pool.submit(lambda content: hashlib.sha256(content).hexdigest(), data)
        titles, header, body = _split(data, source)
        names, kinds, factors = _columns(titles, source)
        del data
        columns = _read_columns(header, body, titles, source)
        del body
        time = _uniform(columns[0], factors[0], titles[0], source)
        channels = {}
        for i, (name, kind) in enumerate(zip(names, kinds, strict=True), start=1):
            _check_numbers(columns[i], titles[i], source)
            values = columns[i] * factors[i]
            _check_plateaus(values, kind, titles[i], source)
            channels[name] = values / 2.0 if kind == "D" else values
            columns[i] = np.empty(0)  # as soon as it is not needed: a record may be large
        _check_ranges(channels, dict(zip(names, titles[1:], strict=True)), source)
        return Record(source, digest.result(), time, channels)


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


def _split(data: bytes, source: str) -> tuple[list[str], bytes, bytes]:
    """The titles, the header line and the lines below it."""
    data = data.removeprefix(b"\xef\xbb\xbf")
    if not data.isascii():
        try:
            data.decode("utf-8")
        except UnicodeDecodeError as error:
            raise ValueError(f"{source}: not UTF-8 text (byte {error.start}); save it as CSV in UTF-8.") from None
    if not data.strip():
        raise ValueError(f"{source}: the file is empty; it must hold a header and samples.")
    if b"\r" in data[:65536] and b"\n" not in data[:65536]:
        data = data.replace(b"\r", b"\n")  # line ends of old spreadsheets
    header, _, body = data.partition(b"\n")
    if body.endswith((b"\n\n", b"\n\r\n")):
        body = body.rstrip(b"\r\n")
    text = header.decode("utf-8").rstrip("\r")
    try:
        titles = next(csv.reader([text], skipinitialspace=True), [])
    except csv.Error as error:
        raise ValueError(f"{source}: line 1: not a CSV header ({error}); write time [s],AA.P [mmHg], ...") from None
    if len(titles) < 2:
        for mark, word in ((";", "semicolons"), ("\t", "tabs")):
            if mark in text:
                raise ValueError(
                    f"{source}: line 1: the fields are separated by {word}; "
                    "save it with commas between the fields and points as decimal marks."
                )
    return [title.strip() for title in titles], header, body


def _columns(titles: list[str], source: str) -> tuple[list[str], list[str], list[float]]:
    """Channel names (D as R), kinds, and the factor to SI of every column, time first."""
    parts = [_title(title) for title in titles]
    if not parts or parts[0][0] != "time":
        _refuse(source, 1, titles[0] if titles else "", "the first column must be the time; name it 'time [s]'")
    if len(parts) == 1:
        raise ValueError(f"{source}: line 1: there is no channel beside the time; add one, such as 'AA.P [mmHg]'.")
    names: list[str] = []
    kinds: list[str] = []
    factors = [_factor(_TIME, parts[0][1], titles, source, titles[0])]
    for title, (name, unit) in zip(titles[1:], parts[1:], strict=True):
        site, _, kind = name.rpartition(".")
        if kind not in KINDS or not site or site != site.strip():
            _refuse(
                source,
                1,
                title,
                "no such channel; allowed are <site>.P, <site>.Q, <site>.R and <site>.D (a diameter), "
                "such as 'AA.P [mmHg]'",
            )
        factors.append(_factor(KINDS[kind], unit, titles, source, title))
        own = f"{site}.R" if kind == "D" else name
        if own in names:
            both = "R and D of one site" if own != name or kinds[names.index(own)] != kind else "a name twice"
            _refuse(source, 1, title, f"{both}; keep one of the two columns")
        names.append(own)
        kinds.append(kind)
    return names, kinds, factors


def _title(title: str) -> tuple[str, str]:
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
    _refuse(source, 1, title, f"{what} and does not fit a {kind.noun}; {advice}")


def _convert(unit: str, wanted: str) -> float | None:
    if re.search(r"\d{3}|(\*\*|\^).*(\*\*|\^)", unit) or len(unit) > 40:
        return None  # powers without end would keep pint busy for hours
    try:
        return parse_quantity(f"1 {unit}", wanted, unit)
    except ValueError:
        return None


def _other_is(title: str, titles: list[str], kind: Kind) -> bool:
    """Whether the site's other column of pressure and radius has the unit that this one should have."""
    name = _title(title)[0]
    site, _, own = name.rpartition(".")
    others = {"P": ("R", "D"), "R": ("P",), "D": ("P",)}.get(own, ())
    return any(n in [f"{site}.{o}" for o in others] and u and _convert(u, kind.unit) for n, u in map(_title, titles))


def _refuse(source: str, line: int, title: str, reason: str) -> NoReturn:
    raise ValueError(f"{source}: line {line}, column {title!r}: {reason}.")


# --- the numbers --------------------------------------------------------------------------------------------------


def _read_columns(header: bytes, body: bytes, titles: list[str], source: str) -> list[Array]:
    """One float array per column, NaN in gaps."""
    if not body.strip():
        raise ValueError(f"{source}: line 2: there are no samples below the header; add them.")
    schema = {str(i): pl.Float64() for i in range(len(titles))}
    try:
        frame = pl.read_csv(body, has_header=False, schema=schema)
    except pl.exceptions.PolarsError:
        return _read_slowly(body, titles, source)
    if body.count(b",") != frame.height * (len(titles) - 1):
        return _read_slowly(body, titles, source)  # a row too short is filled up by polars; here it is an error
    return [frame[name].fill_null(np.nan).to_numpy() for name in frame.columns]


_NUMBER = re.compile(r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf(?:inity)?)|nan|", re.IGNORECASE)


def _read_slowly(body: bytes, titles: list[str], source: str) -> list[Array]:
    """The same cell by cell: for files with spaces in the cells, and to say where a bad cell is."""
    numbers = array("d")
    rows = csv.reader(io.TextIOWrapper(io.BytesIO(body), encoding="utf-8", newline=""))
    try:
        for row in rows:
            line = rows.line_num + 1
            if len(row) != len(titles):
                raise ValueError(
                    f"{source}: line {line}: {len(row)} fields where the header has {len(titles)}; "
                    "complete or remove the line (gaps are empty fields; decimal marks are points)."
                )
            for i, cell in enumerate(row):
                text = cell.strip()
                if not _NUMBER.fullmatch(text):
                    hint = (
                        "write the decimal mark as a point" if "," in text else "write a number, or nothing for a gap"
                    )
                    _refuse(source, line, titles[i], f"{text[:40]!r} is not a number; {hint}")
                numbers.append(float(text or "nan"))
    except csv.Error as error:
        raise ValueError(f"{source}: line {rows.line_num + 1}: not CSV ({error}); correct the line.") from None
    table = np.array(numbers).reshape(-1, len(titles))
    return [np.ascontiguousarray(column) for column in table.T]


def _uniform(given: Array, factor: float, title: str, source: str) -> Array:
    """The uniform time axis [s] behind printed times: the straight line through them.

    A printed time may be off by its rounding: half a unit of its last decimal, or of single precision.
    """
    n = len(given)
    bad = np.flatnonzero(~np.isfinite(given))
    if len(bad):
        _refuse(source, int(bad[0]) + 2, title, "the time is missing or not finite; every sample needs its time")
    if n < _SHORTEST:
        raise ValueError(f"{source}: {n} samples are too few; a record holds several beats.")
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.diff(given)
        span = given[-1] - given[0]
    if not np.isfinite(span):
        _refuse(source, 2, title, "the times are too large; start the record at zero")
    bad = np.flatnonzero(step <= 0.0)
    if len(bad):
        _refuse(
            source, int(bad[0]) + 3, title, f"the time does not increase ({given[bad[0]]:g} to {given[bad[0] + 1]:g})"
        )
    index = np.arange(n) - (n - 1) / 2.0
    dt = (given - given[0]) @ index / (index @ index)
    line = given[0] + np.mean(given - given[0]) + dt * index
    decimal = _last_decimal(given)
    rounding = 0.75 * decimal + 1.2e-7 * np.abs(given).max()
    if not dt > 0.0 or np.abs(given - line).max() > rounding + 1e-6 * dt:
        usual = float(np.median(step))
        off = np.abs(step - usual)
        first = np.flatnonzero(off > min(max(1.01 * decimal, 1e-6 * usual), 0.999 * off.max()))
        at = int(first[0]) if len(first) else int(off.argmax())
        _refuse(
            source,
            at + 3,
            title,
            f"the sampling is not uniform: a step of {step[at]:.6g} where the usual one is {usual:.6g}; "
            "resample the record, or fill lost samples with empty fields",
        )
    return line * factor


def _last_decimal(values: Array) -> float:
    """The largest power of ten that all values are multiples of, 0 if there is none: the rounding of printing."""
    size = float(np.abs(values).max())
    for digits in range(-3, 16):
        scaled = values * 10.0**digits
        if size * 10.0**digits > 1e11:
            return 0.0
        if np.abs(scaled - np.round(scaled)).max() < 1e-4:
            return float(10.0**-digits)
    return 0.0


# --- channels that cannot be used ---------------------------------------------------------------------------------


def _check_numbers(values: Array, title: str, source: str) -> None:
    bad = np.flatnonzero(np.isinf(values))
    if len(bad):
        _refuse(source, int(bad[0]) + 2, title, "the value is infinite; leave the field empty for a gap")
    measured = values[~np.isnan(values)]
    if len(measured) == 0:
        raise ValueError(f"{source}: column {title!r}: it holds gaps only; remove the column.")
    low, high = float(measured.min()), float(measured.max())
    if high / 2 - low / 2 <= _FLAT * max(abs(low), abs(high)) / 2:
        raise ValueError(
            f"{source}: column {title!r}: the channel is constant ({high:g}), it does not pulsate; "
            "check the sensor, or remove the column."
        )


def _check_plateaus(values: Array, kind: str, title: str, source: str) -> None:
    """Refuses a channel whose sensor was saturated: it enters and leaves a plateau at its extreme steeply.

    Rounding makes plateaus too, but beside one of n samples a rounded smooth signal is a few quanta lower at n/4
    samples from it; noise makes none. A flow may rest at zero.
    """
    range_ = float(np.nanmax(values) - np.nanmin(values))
    for sign, word in ((1.0, "highest"), (-1.0, "lowest")):
        y = sign * values
        top = float(np.nanmax(y))
        if kind == "Q" and abs(top) < _VALVE * range_:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[False], y == top, [False]]).astype(np.int8)))
        start, stop = edges[::2], edges[1::2]
        beside = np.maximum(2, (stop - start) // 4)
        whole = (stop - start >= _RUN) & (start - beside >= 0) & (stop - 1 + beside < len(y))
        start, stop, beside = start[whole], stop[whole], beside[whole]
        fall = np.minimum(top - y[start - beside], top - y[stop - 1 + beside])
        start, fall = start[np.isfinite(fall)], fall[np.isfinite(fall)]
        if len(fall) and np.median(fall) > _STEEP * _quantum(values):
            _refuse(
                source,
                int(start[0]) + 2,
                title,
                f"the channel is clipped: it rests at its {word} value, {top * sign / _shown(kind):.6g} "
                f"{KINDS[kind].example}; widen the sensor's range, or leave these fields empty",
            )


def _quantum(values: Array) -> float:
    """The step between neighbouring values of a digitised signal [its unit]; small for a continuous one."""
    steps = np.abs(np.diff(values))
    return float(np.quantile(steps[steps > 0.0], 0.01))


def _shown(kind: str) -> float:
    return parse_quantity(f"1 {KINDS[kind].example}", KINDS[kind].unit, "unit")


def _check_ranges(channels: Mapping[str, Array], titles: Mapping[str, str], source: str) -> None:
    for name, values in channels.items():
        site, _, letter = name.rpartition(".")
        kind = KINDS[letter]
        bad = np.flatnonzero((values < kind.low) | (values > kind.high))
        if letter in "PR" and _swapped(channels.get(f"{site}.P"), channels.get(f"{site}.R")):
            _refuse(source, 1, titles[name], f"P and R of {site} seem swapped; exchange the two names")
        if len(bad):
            _refuse(
                source,
                int(bad[0]) + 2,
                titles[name],
                f"{values[bad[0]]:.4g} {kind.unit} is outside {kind.low:g} to {kind.high:g} {kind.unit}; "
                "the unit is probably wrong",
            )


def _swapped(P: Array | None, R: Array | None) -> bool:
    """Whether P is a radius and R a pressure: out of range both, or R too wide for its small pressure and livelier."""
    if P is None or R is None:
        return False
    low, high = KINDS["R"].low, KINDS["R"].high
    small, large = float(np.nanmin(P)), float(np.nanmax(P))
    middle = float(np.nanmedian(R))
    if low <= small and large <= high and (middle > high or middle < low):
        return True
    livelier = np.nanmax(R) - np.nanmin(R) > middle * (large - small) / max(abs(small), abs(large))
    return bool(middle > _WIDE and 0.0 < small and large < 3e3 and livelier)
