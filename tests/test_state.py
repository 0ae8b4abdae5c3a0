"""Saved states as bytes: what comes back is what was saved, to the last bit; other bytes are refused."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from solver.io.saved import FORMAT, MAGIC, dataclasses, from_bytes, to_bytes

GUID = "{0123}"


@dataclass(frozen=True)
class Place:
    x: Any
    y: Any = None


KINDS = dataclasses(Place)


def again(value: Any) -> Any:
    return from_bytes(to_bytes(GUID, value, KINDS), GUID, KINDS)


plain = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text()
values = st.recursive(
    plain,
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.dictionaries(st.text() | st.tuples(st.integers(), st.floats(allow_nan=False)), inner)
        | st.builds(Place, inner, inner)
    ),
    max_leaves=20,
)


@given(values)
def test_plain_values(value: Any) -> None:
    """Values and their types come back; a number to the last bit, the sign of zero with it."""
    assert repr(again(value)) == repr(value)


@pytest.mark.parametrize("dtype", [float, np.float32, complex, int, np.int32, np.uint8, bool])
def test_arrays(dtype: type) -> None:
    """Bits, type, shape and order in memory: numbers are summed in the same order afterwards."""
    table = np.arange(12).reshape(3, 4).astype(dtype)
    for array in (table, table.T, np.asfortranarray(table), table[::2, 1:], table[:0], np.array(table[1, 1])):
        found = again(array)
        assert (found.dtype, found.shape, found.tobytes()) == (array.dtype, array.shape, array.tobytes())
        contiguous = array.size and (array.flags.c_contiguous or array.flags.f_contiguous)
        assert not contiguous or found.strides == array.strides
        assert found.flags.writeable
    scalar = again(table[2, 3])
    assert (type(scalar), scalar) == (type(table[2, 3]), table[2, 3])


def test_odd_numbers() -> None:
    """NaN with its payload, infinities and the smallest number, in arrays and out of them."""
    array = np.array([np.nan, np.inf, -np.inf, -0.0, 5e-324])
    assert again(array).tobytes() == array.tobytes()
    assert np.array(again(array.tolist())).tobytes() == array.tobytes()


def test_the_same_object_twice() -> None:
    """One object in two places is one object afterwards: components ask whether two are the same."""
    array, place = np.arange(3.0), Place(1.0)
    found = again({"a": array, "b": Place(array, place), "c": [place, place]})
    assert found["a"] is found["b"].x
    assert found["c"][0] is found["c"][1] is found["b"].y


def test_no_other_object() -> None:
    """What is not of a known kind is a fault of the component, said when it is saved."""
    for value in (object(), lambda: None, np.array(["text"]), np.array([object()])):
        with pytest.raises(TypeError, match="a state cannot hold"):
            to_bytes(GUID, value, KINDS)


BLOB = to_bytes(GUID, {"a": np.arange(5.0), "b": "text"}, KINDS)


@pytest.mark.parametrize("n", [0, 1, 7, 8, 47, 48, 60, len(BLOB) - 1])
def test_truncated(n: int) -> None:
    """One sentence for every part of a state."""
    with pytest.raises(ValueError, match=rf"state of {n} bytes: .*\.$"):
        from_bytes(BLOB[:n], GUID, KINDS)


@given(st.integers(0, len(BLOB) - 1), st.integers(1, 255))
def test_damaged(at: int, change: int) -> None:
    """Any other byte is noticed."""
    with pytest.raises(ValueError, match=r"^state .*\.$"):
        from_bytes(BLOB[:at] + bytes([BLOB[at] ^ change]) + BLOB[at + 1 :], GUID, KINDS)


@given(st.binary(max_size=200))
def test_other_bytes(blob: bytes) -> None:
    """Bytes that are no state."""
    with pytest.raises(ValueError, match=r"^state of \d+ bytes: not a saved state of an FMU of this project"):
        from_bytes(blob, GUID, KINDS)


def sealed(header: Any, content: bytes = b"") -> bytes:
    """Bytes with the right seal, whatever they say."""
    text = json.dumps(header).encode()
    digest = hashlib.sha256(text + content).digest()
    return struct.pack("<8sII32s", MAGIC, FORMAT, len(text), digest) + text + content


@pytest.mark.parametrize(
    "header",
    [
        None,
        [],
        {},
        {"fmu": GUID},
        {"fmu": GUID, "arrays": [], "values": ["eval", ["x", "1"]]},
        {"fmu": GUID, "arrays": [], "values": ["array", 0]},
        {"fmu": GUID, "arrays": [], "values": ["again", 0]},
        {"fmu": GUID, "arrays": [], "values": ["Place", ["z", 1.0]]},
        {"fmu": GUID, "arrays": [], "values": ["dict", 3]},
        {"fmu": GUID, "arrays": [], "values": []},
        {"fmu": GUID, "arrays": [["<f8", [10**9], "rows"]], "values": 1},
        {"fmu": GUID, "arrays": [["<f8", [-3], "rows"]], "values": 1},
        {"fmu": GUID, "arrays": [["O", [1], "rows"]], "values": 1},
        {"fmu": GUID, "arrays": [["<f8", [1], "K"]], "values": 1},
    ],
)
def test_forged(header: Any) -> None:
    """A seal proves no sense: what a component does not write is refused with a sentence, and no code is run."""
    with pytest.raises(ValueError, match=r"^state of \d+ bytes: not as this FMU writes it \(.*\); save it anew\.$"):
        from_bytes(sealed(header, bytes(8)), GUID, KINDS)


def test_other_fmu_and_format() -> None:
    """The state of another FMU, or in another format, says so."""
    with pytest.raises(ValueError, match=r"^state of the FMU \{0123\}: this one is \{4567\}; restore it there"):
        from_bytes(BLOB, "{4567}", KINDS)
    with pytest.raises(ValueError, match=r"^state in format 9: this FMU reads format 1; "):
        from_bytes(BLOB[:8] + struct.pack("<I", 9) + BLOB[12:], GUID, KINDS)
