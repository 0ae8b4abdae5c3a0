"""Record operations on unknown numbers, in the order in which a program executes them.

An operation belongs to the *phase* of the latest of its operands: operations on parameters alone are executed once per
parameter set, those on the state at the start of a stage once per stage, and only the rest in every iteration.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray

CONSTANT = -1  # the phase of numbers in the code itself


class Untraceable(TypeError):
    """An array program cannot be recorded: it needs numbers, or an operation that the engine does not have."""


class Slot:
    """Numbers of a program: their count, the phase in which they are computed, and their values if constant."""

    def __init__(self, size: int, phase: int, data: Array | None = None) -> None:
        self.size, self.phase, self.data = size, phase, data
        self.empty = phase == CONSTANT and data is None  # nothing has been written yet
        self.version = 0  # counts writes to parts of it
        self.read_in = phase  # the last phase that reads it


class Buffer:
    """The storage shared by views: the slot that contains the numbers now. own : no other buffer has this slot."""

    def __init__(self, slot: Slot, own: bool = False) -> None:
        self.slot, self.own = slot, own


class View:
    """Numbers of a buffer : ``index`` contains their places, in the shape of an array. whole : all, in order."""

    def __init__(self, recorder: Recorder, buffer: Buffer, index: Array, whole: bool = False) -> None:
        self.recorder, self.buffer, self.index, self.whole = recorder, buffer, index, whole


@lru_cache(maxsize=512)
def up_to(size: int) -> Array:
    """0, 1, ... size - 1."""
    found = np.arange(size)
    found.setflags(write=False)
    return found


class Operand(NamedTuple):
    """Numbers that an operation reads: consecutive ones from ``start`` in a slot, or a single one repeatedly."""

    slot: Slot
    start: int
    single: bool


class Instruction(NamedTuple):
    """out[start:] = name(operands); ``sizes`` are those that the operation needs, ``places`` its indices."""

    name: str
    out: Slot
    start: int
    operands: tuple[Operand, ...]
    sizes: tuple[int, ...]
    places: Array | None = None

    @property
    def slots(self) -> list[Slot]:
        """The slots that it writes and reads."""
        return [self.out, *[o.slot for o in self.operands]]


class Recorder:
    """Records operations by phase."""

    def __init__(self) -> None:
        self.phases: dict[int, list[Instruction]] = {}
        self._constants: dict[bytes, Slot] = {}
        self._known: dict[tuple[Any, ...], Slot] = {}

    def constant(self, value: Any) -> Slot:
        data = np.ascontiguousarray(value, float).ravel()
        return self._constants.setdefault(data.tobytes(), Slot(data.size, CONSTANT, data))

    def look(self, x: View, kind: str = "truth") -> Array:
        """The numbers of an array that code needs: a "truth", "any" of them, or a "number". Here they are unknown."""
        raise Untraceable("a number is asked for that depends on the state")

    # --- operands -------------------------------------------------------------------------------------------------

    def operand(self, x: Any, shape: tuple[int, ...]) -> Operand:
        """x in a shape, as consecutive numbers; scattered ones are gathered."""
        if not isinstance(x, View):
            if isinstance(x, (float, int)) and x == x and 0 not in shape:
                return Operand(self.constant(x), 0, True)
            value = np.broadcast_to(np.asarray(x, float), shape)
            same = value.size > 0 and value.max() == value.min()
            return Operand(self.constant(value.flat[0] if same else value), 0, bool(same))
        slot, same = x.buffer.slot, x.index.shape == shape
        if x.index.size == 1 and 0 not in shape:
            return Operand(slot, int(x.index.flat[0]), True)
        if same and x.whole:
            return Operand(slot, 0, False)
        index = (x.index if same else np.broadcast_to(x.index, shape)).ravel()
        if index.size == 0:
            return Operand(slot, 0, False)
        first = int(index[0])
        if index[0] == index[-1] and index.min() == index.max():
            return Operand(slot, first, True)
        if index[-1] == first + index.size - 1 and (index - first == up_to(index.size)).all():
            return Operand(slot, first, False)
        return Operand(self.emit("gather", (Operand(slot, 0, False),), (index.size,), index.size, index), 0, False)

    def emit(
        self, name: str, operands: tuple[Operand, ...], shape: tuple[int, ...], size: int, index: Array | None = None
    ) -> Slot:
        """The slot of ``size`` numbers with the result of an operation."""
        read = tuple((o, o.slot.version) for o in operands)
        key = (name, read, shape, None if index is None else index.tobytes())
        slot = self._known.get(key)
        if slot is None:
            slot = self._known[key] = Slot(size, max([0, *(o.slot.phase for o in operands)]))
            self.write(Instruction(name, slot, 0, operands, shape, index))
        return slot

    def write(self, instruction: Instruction) -> None:
        phase = instruction.out.phase
        for operand in instruction.operands:
            operand.slot.read_in = max(operand.slot.read_in, phase)
        self.phases.setdefault(phase, []).append(instruction)

    def merge(self) -> None:
        """Merge consecutive copies of single numbers to the same array into one gather."""
        for phase, each in self.phases.items():
            found = list[Instruction]()
            for i in each:
                if found and (both := _together(found[-1], i)):
                    found[-1] = both
                else:
                    found.append(i)
            self.phases[phase] = found

    # --- writing to a part ----------------------------------------------------------------------------------------

    def assign(self, target: View, value: Any) -> None:
        """target[...] = value, visible in all views of the buffer."""
        buffer, index = target.buffer, target.index.ravel()
        if isinstance(value, View) and value.buffer is buffer and np.array_equal(value.index, target.index):
            return  # the second half of x[...] += y
        source = self.operand(value, target.index.shape)
        if index.size == 0:
            return
        if index.size == buffer.slot.size and not source.single and source.slot.size == index.size \
                and np.array_equal(index, np.arange(index.size)) and source.slot.phase > CONSTANT:  # fmt: skip
            if isinstance(value, View):
                value.buffer.own = False
            buffer.slot, buffer.own = source.slot, False
            return
        phase = max(buffer.slot.phase, source.slot.phase)
        if not buffer.own or phase > buffer.slot.phase or buffer.slot.read_in > phase:
            whole = Slot(buffer.slot.size, max(0, phase))
            if not buffer.slot.empty:
                self.write(Instruction("copy", whole, 0, (Operand(buffer.slot, 0, False),), (whole.size,)))
            buffer.slot, buffer.own = whole, True
        slot, start = buffer.slot, int(index[0])
        slot.version += 1
        if np.array_equal(index, np.arange(start, start + index.size)):
            self.write(Instruction("copy", slot, start, (source,), (index.size,)))
        else:
            self.write(Instruction("scatter", slot, 0, (source,), (index.size,), index))


def _together(one: Instruction, two: Instruction) -> Instruction | None:
    """Two operations as one gather, if they copy numbers of one slot to neighbouring places; otherwise None."""
    count, source = one.sizes[0] if one.sizes else 0, two.operands[0]
    follows = two.name == "copy" and two.sizes == (1,) and one.out is two.out and one.start + count == two.start
    if not follows or len(one.operands) != 1 or one.operands[0].slot is not source.slot or source.slot is two.out:
        return None
    if one.name == "copy" and count == 1:
        places = np.array([one.operands[0].start, source.start])
    elif one.name == "gather" and one.places is not None:
        places = np.append(one.places, source.start)
    else:
        return None
    return Instruction("gather", one.out, one.start, (Operand(source.slot, 0, False),), (count + 1,), places)


# --- with the numbers of one parameter set --------------------------------------------------------------------------

_TRUTHS = set(
    "logical_not isfinite greater greater_equal less less_equal equal not_equal logical_and logical_or".split()
)
_PASSED = {"copy", "gather", "scatter", "largest", "least"}  # operations that make truth values from truth values
_NAMES = {"copy": "positive", "where": "where"}


class Known(Recorder):
    """A recorder that also executes its operations, with the numbers of one parameter set.

    Code that computes coefficients sometimes branches on parameters: whether any wall is nonlinear, where elements must
    end. The recorder takes the branch of this parameter set, and the program *requires* the same branch of every other
    one.
    numbers : of slots in the first phase. lenient : if an ``any`` is true, the program does not require it, so that it
    may include physics that is zero elsewhere.
    """

    def __init__(self) -> None:
        super().__init__()
        self.numbers: dict[Slot, Array] = {}
        self.lenient = False
        self._truths: set[Slot] = set()

    def give(self, x: View, value: Any) -> None:
        """Set the numbers of an input array."""
        self.numbers[x.buffer.slot] = np.array(value, float).ravel()

    def of(self, x: View) -> Array | None:
        """The numbers of an array; None if they depend on more than parameters."""
        slot = x.buffer.slot
        if slot.phase == CONSTANT:
            return np.asarray((np.zeros(slot.size) if slot.data is None else slot.data)[x.index])
        return self.numbers[slot][x.index] if slot in self.numbers else None

    def look(self, x: View, kind: str = "truth") -> Array:
        found, slot = self.of(x), x.buffer.slot
        if found is None or (kind == "truth" and slot not in self._truths and slot.phase != CONSTANT):
            return super().look(x, kind)
        if slot.phase != CONSTANT and not (self.lenient and kind == "any" and found.all()):
            self.require(x, found)
        return found != 0.0 if kind != "number" else found

    def require(self, x: View, value: Array) -> None:
        """Make the program stop if x has other numbers."""
        size = x.index.size
        same = self.emit("equal", (self.operand(x, x.index.shape), self.operand(value, x.index.shape)), (size,), size)
        least = self.emit("least", (Operand(same, 0, False),), (1, size), 1)
        self.emit("require", (Operand(least, 0, False),), (1,), 1)

    def write(self, instruction: Instruction) -> None:
        super().write(instruction)
        operands = [o.slot for o in instruction.operands]
        if instruction.out.phase == 0 and all(slot in self.numbers or slot.phase == CONSTANT for slot in operands):
            if instruction.name in _TRUTHS or (
                instruction.name in _PASSED and all(slot in self._truths for slot in operands)
            ):
                self._truths.add(instruction.out)
            with np.errstate(all="ignore"):
                self._do(instruction)

    # --- the operations of native/engine.c ------------------------------------------------------------------------

    def _do(self, i: Instruction) -> None:
        if i.name == "require":
            return
        out = self.numbers.setdefault(i.out, np.zeros(i.out.size))
        if i.name == "scatter":
            out[i.places] = self._values(i.operands[0], i.sizes[0])
            return
        found = np.ravel(self._result(i))
        out[i.start : i.start + found.size] = found

    def _result(self, i: Instruction) -> Array:
        if i.name == "gather":
            return self._whole(i.operands[0])[i.places]
        if i.name == "sums":
            assert i.places is not None
            return np.asarray(np.add.reduceat(self._values(i.operands[0], i.sizes[1]), i.places[:-1]))
        if i.name == "product":
            count, m, k, n, one, two = i.sizes
            a = self._values(i.operands[0], (count if one else 1) * m * k).reshape(-1, m, k)
            return np.asarray(a @ self._values(i.operands[1], (count if two else 1) * k * n).reshape(-1, k, n))
        if i.name == "inverse":
            count, n = i.sizes
            return np.linalg.inv(self._values(i.operands[0], count * n * n).reshape(count, n, n))
        if i.name in ("sum", "largest", "least"):
            rows = self._values(i.operands[0], math.prod(i.sizes)).reshape(i.sizes)
            return np.asarray(getattr(rows, {"sum": "sum", "largest": "max", "least": "min"}[i.name])(axis=1))
        values = [self._values(o, i.sizes[0]) for o in i.operands]
        if i.name == "where":
            return np.where(values[0] != 0.0, values[1], values[2])
        return np.asarray(getattr(np, _NAMES.get(i.name, i.name))(*values), float)

    def _whole(self, operand: Operand) -> Array:
        slot = operand.slot
        if slot.phase != CONSTANT:
            return self.numbers[slot]
        return np.zeros(slot.size) if slot.data is None else slot.data

    def _values(self, operand: Operand, size: int) -> Array:
        whole = self._whole(operand)
        if operand.single:
            return np.full(size, whole[operand.start])
        return whole[operand.start : operand.start + size]
