"""The drive of an inlet in the network file: a table or a Fourier series.

    Q = "inflow.csv"                                       a table in a file beside the network file
    t = [0, 0.2, 1]   Q = [0, 1e-4, 0]                     the same in the section
    T = 1   Q_mean = 5e-6   Q_cos = [1e-6]   Q_sin = [0]   Q_mean + Σ Q_cos,k cos 2πkt/T + Q_sin,k sin 2πkt/T

and the same with P.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io import tables
from ..quantities.text import did_you_mean, parse_quantity
from ..quantities.units import SIGNAL_UNITS
from .curve import Curve
from .inlet import CAUSALITY

Array = np.ndarray

_TIMES = ("t", "time")
_OF_TABLES = ("t", "interpolation", "harmonics")
_SERIES = ("mean", "cos", "sin")
KEYS = (*_OF_TABLES, *CAUSALITY, *(f"{signal}_{part}" for signal in CAUSALITY for part in _SERIES))


def signals(table: Mapping[str, Any]) -> list[str]:
    """The keys of a section that prescribe a signal; those of one series count as one."""
    series = {f"{signal}_{part}": f"{signal}_cos" for signal in CAUSALITY for part in _SERIES}
    return list(dict.fromkeys(series.get(key, key) for key in table if key in CAUSALITY or key in series))


def read(table: Mapping[str, Any], where: str, folder: Path | None, period: float | None) -> Curve | None:
    """The curve of a section, or None.

    where : its name in sentences. folder : that of the network file. period [s] : its key T.
    Raises ValueError, one sentence.
    """
    found = signals(table)
    for key in _OF_TABLES:
        if key in table and not any(signal in CAUSALITY for signal in found):
            raise InputError(f"{where}.{key}: it belongs to a table; also give Q or P.")
    if not found:
        return None
    made = _of_table(found[0], table, where, folder) if found[0] in CAUSALITY else None
    try:
        if made is None:
            return _series(found[0][0], table, period)
        interpolation, harmonics = table.get("interpolation", "cubic"), table.get("harmonics", 0)
        if not isinstance(harmonics, int) or isinstance(harmonics, bool):
            raise InputError(f"harmonics = {harmonics!r}: must be a whole number.")
        return Curve.through(found[0], *made, interpolation, period, harmonics)
    except InputError as error:
        raise InputError(f"{where}.{error}") from None


def section(curve: Curve) -> dict[str, Any]:
    """The keys of a section from which :func:`read` restores an equal curve."""
    table = {"t": list(curve.t), curve.signal: list(curve.values), "interpolation": curve.interpolation}
    harmonics = {"harmonics": curve.harmonics} if curve.harmonics else {}
    return {**table, **harmonics, "T": f"{curve.period!r} s"}


def _series(signal: str, table: Mapping[str, Any], period: float | None) -> Curve:
    numbers = {}
    for part in _SERIES:
        key = f"{signal}_{part}"
        if key not in table:
            raise InputError(f"{key}: it is missing; a series has {signal}_mean, {signal}_cos and {signal}_sin.")
        if isinstance(table[key], list) != (part != "mean"):
            raise InputError(f"{key} = {table[key]!r}: must be {'one number' if part == 'mean' else 'a list'}.")
        numbers[part] = _numbers(table[key] if part != "mean" else [table[key]], SIGNAL_UNITS[signal], key)
    if period is None or not period > 0.0:
        given = "it is missing" if period is None else f"{period:g} s is no period"
        raise InputError(f'T: {given}; a series needs a positive one, such as T = "1 s".')
    return Curve.series(signal, float(numbers["mean"][0]), numbers["cos"], numbers["sin"], period)


def _of_table(signal: str, table: Mapping[str, Any], where: str, folder: Path | None) -> tuple[Array, Array]:
    """Times [s] and values in SI, from two lists or from a file."""
    given, name = table[signal], f"{where}.{signal}"
    if isinstance(given, list):
        times = table.get("t")
        if not isinstance(times, list) or len(times) != len(given):
            raise InputError(f"{name}: a list of {len(given)} values needs a list t of as many times; add t.")
        return _numbers(times, "s", f"{where}.t"), _numbers(given, SIGNAL_UNITS[signal], name)
    if not isinstance(given, str):
        raise InputError(f'{name} = {given!r}: must be the name of a table in quotes, such as "inflow.csv".')
    if "t" in table:
        raise InputError(f"{where}.t: the times are in the table; leave t out.")
    if folder is None and not Path(given).is_absolute():
        raise InputError(f"{name} = {given!r}: text has no folder for tables; read the network from its file.")
    return read_signal(signal, (folder or Path()) / given)


def _numbers(values: list[Any], unit: str, name: str) -> Array:
    return np.array([parse_quantity(value, unit, name) for value in values])


def read_signal(name: str, path: str | os.PathLike[str]) -> tuple[Array, Array]:
    """Times [s] and values in SI of a table with a column t or time and one named after the signal.

    ``name``: Q, or P; the column may be inlet.Q too. Raises ValueError as :func:`solver.io.tables.read`.
    """
    table = tables.read(path)
    found = []
    for wanted, unit in ((_TIMES, "s"), ((name, f"inlet.{name}"), SIGNAL_UNITS[name])):
        columns = [i for i, column in enumerate(table.names) if column in wanted]
        if len(columns) != 1:
            near = did_you_mean(wanted[-1], table.names)
            have = ", ".join(table.names)
            raise InputError(f"{path}: it needs one column {' or '.join(wanted)} and has {have}{near}; rename one.")
        i = columns[0]
        texts = [(f"{path}, line {n}", cells[i]) for n, cells in table.rows]
        found.append(np.array([tables.number(cell, table.units[i], unit, where, wanted[0]) for where, cell in texts]))
    return found[0], found[1]
