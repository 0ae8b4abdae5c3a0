"""The arrays of ``resources/arterial.bin``: the table of variables and its texts; and the file that holds them.

A head (magic, version, number of arrays, size, checksum), a table of where each array lies, and the arrays, which
``native/fmu/resource.c`` reads. Little-endian. Not part of the code of other FMUs.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from solver.tracing.program import OPERATIONS

from ..variables.variable import Variable

Array = np.ndarray

GUID = 64  # bytes
_MAGIC, _VERSION = b"ARTERIAL", 3
_BYTES, _INTEGERS, _NUMBERS = np.uint8, np.int32, np.float64
# in the order of native/fmu/component.h; after them those of each program
_ARRAYS: dict[str, Any] = {
    "meta": _INTEGERS, "guid": _BYTES, "operations": _BYTES, "variables": _INTEGERS, "ranges": _NUMBERS,
    "strings": _BYTES, "parameters": _INTEGERS, "inlets": _INTEGERS, "inlet_numbers": _NUMBERS, "curves": _NUMBERS,
    "venous": _INTEGERS, "segments": _INTEGERS, "elements": _INTEGERS, "positions": _NUMBERS, "periodic": _NUMBERS,
    "sources": _INTEGERS, "source_periods": _NUMBERS, "index": _INTEGERS, "numbers": _NUMBERS,
}  # fmt: skip
# the numbers of "meta"; -1 where there is no such variable
_META = (
    "n_variables", "first_output", "first_late", "n_points", "n_programs", "solver.dt", "solver.element_length",
    "network.elastic_law", "network.viscous_law", "inlet.interpolation", "inlet.drive", "network.start", "inlet.T",
    "network.P_0", "name", "unsolved", "shorter", "n_arithmetic",
)  # fmt: skip
_CAUSALITIES, _VARIABILITIES = ("input", "parameter", "output"), ("continuous", "fixed", "tunable")
_HEAD, _ENTRY = struct.Struct("<8s2i2Q"), struct.Struct("<2q2i")
_KINDS = {"uint8": 0, "int32": 1, "float64": 2}


class Texts:
    """Texts one after the other, each ended by a zero."""

    def __init__(self) -> None:
        self.bytes = bytearray(b"\0")

    def at(self, *texts: str) -> int:
        """Where they begin."""
        where = len(self.bytes)
        self.bytes += b"".join(text.encode() + b"\0" for text in texts)
        return where


def integers(numbers: Any) -> Array:
    return np.asarray(numbers, np.int32)


def number_of(variable: Variable, value: Any) -> float:
    """A value as FMI has it."""
    return float(variable.number(str(value))) if variable.quantity is None else float(value)


def tables(table: Sequence[Variable], texts: Texts, **meta: int) -> dict[str, Array]:
    """The arrays that every FMU has: its variables, and the numbers of ``meta``."""
    outputs = [i for i, v in enumerate(table) if v.causality == "output"]
    late = [i for i in outputs if table[i].late]
    numbers = dict.fromkeys(_META, -1) | {variable.name: i for i, variable in enumerate(table)}
    numbers |= {"n_variables": len(table), "first_output": outputs[0], "first_late": [*late, len(table)][0]}
    numbers |= {"n_points": 0, "name": 0, "unsolved": 0, "shorter": 0, "n_arithmetic": 0, **meta}
    return {
        "meta": integers([numbers[name] for name in _META]),
        "guid": np.zeros(GUID, np.uint8),
        "operations": np.frombuffer("".join(f"{name} " for name in OPERATIONS).encode() + b"\0", np.uint8),
        "variables": integers([number for variable in table for number in _row(variable, texts)]),
        "ranges": np.array([number for variable in table for number in _range(variable)], float),
    }


def _row(variable: Variable, texts: Texts) -> list[int]:
    quantity = variable.quantity
    flags = 0 if quantity is None else quantity.open_low + 2 * quantity.whole
    return [
        0 if quantity is not None else 1,
        _CAUSALITIES.index(variable.causality),
        _VARIABILITIES.index(variable.variability),
        flags,
        len(variable.choices),
        texts.at(variable.name),
        texts.at(quantity.description if quantity is not None else variable.description),
        texts.at(quantity.unit_text if quantity is not None else ""),
        texts.at(*variable.choices),
    ]


def _range(variable: Variable) -> tuple[float, float, float]:
    start = 0.0 if variable.start is None else number_of(variable, variable.start)
    if variable.quantity is None:
        return start, 1.0, float(len(variable.choices))
    return start, variable.quantity.low, variable.quantity.high


# --- the file -------------------------------------------------------------------------------------------------------


def file_of(named: Mapping[str, Array], texts: Texts, programs: Sequence[Array]) -> bytes:
    """The file, its GUID still open (:func:`with_guid`). named : what is not empty of its arrays, but the texts."""
    all_texts = np.frombuffer(bytes(texts.bytes), np.uint8)
    empty = {name: np.zeros(0, kind) for name, kind in _ARRAYS.items()}
    arrays = [*{**empty, **named, "strings": all_texts}.values(), *programs]
    at = _HEAD.size + _ENTRY.size * len(arrays)
    entries, parts = [], []
    for x in arrays:
        kind = _KINDS[str(x.dtype)]
        entries.append(_ENTRY.pack(at, len(x), kind, 0))
        data = np.ascontiguousarray(x, x.dtype.newbyteorder("<")).tobytes()
        parts.append(data + bytes(-len(data) % 8))
        at += len(parts[-1])
    return _sealed(_HEAD.pack(_MAGIC, _VERSION, len(arrays), at, 0) + b"".join([*entries, *parts]))


def _entries(content: bytes) -> list[tuple[Any, ...]]:
    n = _HEAD.unpack_from(content)[2]
    return [_ENTRY.unpack_from(content, _HEAD.size + i * _ENTRY.size) for i in range(n)]


def _sealed(content: bytes) -> bytes:
    """The same with its checksum."""
    magic, version, n, size, _ = _HEAD.unpack_from(content)
    return _HEAD.pack(magic, version, n, size, checksum(content[_HEAD.size :])) + content[_HEAD.size :]


def checksum(content: bytes) -> int:
    """As ``digest`` in native/fmu/resource.c: FNV-1a of words of eight bytes."""
    found = 14695981039346656037
    for word in np.frombuffer(content, "<u8").tolist():
        found = (found ^ word) * 1099511628211 & 0xFFFFFFFFFFFFFFFF
        found ^= found >> 32
    return found


def with_guid(content: bytes, guid: str) -> bytes:
    """The same with the GUID of the FMU."""
    at = int(_entries(content)[1][0])
    return _sealed(content[:at] + guid.encode().ljust(GUID, b"\0") + content[at + GUID :])
