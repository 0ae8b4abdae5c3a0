"""Saved states: serialise the state of an FMU's component or of a stage of a study to bytes, and restore it.

Numbers, texts and arrays only: reading runs no code.

    8 bytes "FMUstate" · 4 bytes format · 4 bytes length n of the header · 32 bytes SHA-256 of all that follows
    n bytes JSON: whose state, by GUID; the values as a tree; type, shape, order of each array · the arrays one by one

Numbers are little-endian. A tree is a number, text, truth value or null itself, or a list that begins with its type:
["list", …], ["tuple", …], ["dict", [key, value], …], ["array", its number], [kind, [part, value], …] for an object of a
kind that the owner of the state knows, or ["again", number of the object] for a repeated object.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..errors import InputError

Array = np.ndarray

MAGIC, FORMAT = b"FMUstate", 1
_HEAD = struct.Struct("<8sII32s")
_PLAIN = (bool, int, float, str, type(None))
_NUMBERS = "biufc"  # kinds of NumPy types: truth values, integers, floating point, complex


@dataclass(frozen=True)
class Kind:
    """A type of object in a state: how to split it into named parts, and how to rebuild it."""

    parts: Callable[[Any], Mapping[str, Any]]
    make: Callable[..., Any]


def dataclasses(*types: type) -> dict[type, Kind]:
    """The kinds of dataclasses, whose parts are their fields."""

    def parts(value: Any) -> dict[str, Any]:
        return {field.name: getattr(value, field.name) for field in fields(value)}

    return {each: Kind(parts, each) for each in types}


def to_bytes(guid: str, values: Any, kinds: Mapping[type, Kind]) -> bytes:
    """A state as bytes."""
    writer = _Writer(kinds)
    tree = writer.tree(values)
    arrays = [[a.dtype.str, list(a.shape), _order(a)] for a in writer.arrays]
    header = json.dumps({"fmu": guid, "values": tree, "arrays": arrays}).encode()
    content = header + b"".join(a.tobytes("A") for a in writer.arrays)  # in memory order
    return _HEAD.pack(MAGIC, FORMAT, len(header), hashlib.sha256(content).digest()) + content


def from_bytes(blob: bytes, guid: str, kinds: Mapping[type, Kind]) -> Any:
    """The values given to :func:`to_bytes`. Raises ValueError, one sentence, for invalid bytes or those of another
    FMU."""
    if len(blob) < _HEAD.size or not blob.startswith(MAGIC):
        raise InputError(f"state of {len(blob)} bytes: not a saved state of an FMU of this project; save one anew.")
    _, version, length, digest = _HEAD.unpack_from(blob)
    content = blob[_HEAD.size :]
    if version != FORMAT:
        raise InputError(f"state in format {version}: this FMU reads format {FORMAT}; save the state anew with it.")
    if hashlib.sha256(content).digest() != digest:
        raise InputError(
            f"state of {len(blob)} bytes: incomplete or damaged; give all bytes of the serialized state and no more."
        )
    try:
        header = json.loads(content[:length])
        wrong = header["fmu"] != guid
        values = None if wrong else _Reader(kinds, _arrays(header["arrays"], content[length:])).value(header["values"])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, RecursionError) as error:
        raise InputError(f"state of {len(blob)} bytes: not as this FMU writes it ({error!r}); save it anew.") from None
    if wrong:
        raise InputError(f"state of the FMU {header['fmu']}: this one is {guid}; restore it there, or save one anew.")
    return values


def _order(array: Array) -> str:
    """The memory order of an array, which must be restored, because it affects the order of sums."""
    return "columns" if array.flags.f_contiguous and not array.flags.c_contiguous else "rows"


def _arrays(described: list[Any], content: bytes) -> list[Array]:
    found, at = [], 0
    for name, shape, order in described:
        dtype = np.dtype(name)
        if dtype.kind not in _NUMBERS or min(shape, default=0) < 0:
            raise TypeError(f"array of {name}, {shape}")
        flat = np.frombuffer(content, dtype, int(np.prod(shape, dtype=int)), at)
        ordered = {"rows": flat.reshape(shape), "columns": flat.reshape(shape[::-1]).T}
        found.append(np.array(ordered[order]))
        at += flat.nbytes
    return found


class _Writer:
    def __init__(self, kinds: Mapping[type, Kind]) -> None:
        self.kinds = kinds
        self.arrays: list[Array] = []
        self.objects: list[Any] = []  # kept, so that no other object gets the identity of one of them
        self.number: dict[int, int] = {}

    def tree(self, value: Any) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            return value
        if kind in (list, tuple):
            return [kind.__name__, *map(self.tree, value)]
        if kind is dict:
            return ["dict", *([self.tree(key), self.tree(each)] for key, each in value.items())]
        if id(value) in self.number:
            return ["again", self.number[id(value)]]
        found = self._object(value)
        self.number[id(value)] = len(self.objects)
        self.objects.append(value)
        return found

    def _object(self, value: Any) -> list[Any]:
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in _NUMBERS:
            array = np.asarray(value, value.dtype.newbyteorder("<"))
            self.arrays.append(array)
            return ["array" if isinstance(value, np.ndarray) else "scalar", len(self.arrays) - 1]
        if type(value) not in self.kinds:
            raise TypeError(f"a state cannot hold {type(value).__name__}")
        parts = self.kinds[type(value)].parts(value)
        return [type(value).__name__, *([name, self.tree(part)] for name, part in parts.items())]


class _Reader:
    def __init__(self, kinds: Mapping[type, Kind], arrays: list[Array]) -> None:
        self.kinds = {each.__name__: kind for each, kind in kinds.items()}
        self.arrays = arrays
        self.objects: list[Any] = []

    def value(self, tree: Any) -> Any:
        if not isinstance(tree, list):
            return tree
        tag, *rest = tree
        if tag in ("list", "tuple"):
            return (list if tag == "list" else tuple)(map(self.value, rest))
        if tag == "dict":
            return {self.value(key): self.value(each) for key, each in rest}
        if tag == "again":
            return self.objects[rest[0]]
        if tag == "array":
            found = self.arrays[rest[0]]
        elif tag == "scalar":
            found = self.arrays[rest[0]][()]
        else:
            found = self.kinds[tag].make(**{name: self.value(part) for name, part in rest})
        self.objects.append(found)
        return found
