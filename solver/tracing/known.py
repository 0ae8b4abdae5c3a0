"""A recorder that also executes its operations, with the numbers of one parameter set.

Code that computes coefficients sometimes branches on parameters: whether any wall is nonlinear, where elements must
end. The recorder takes the branch of this parameter set, and the program *requires* the same branch of every other one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .recorder import CONSTANT, Instruction, Operand, Recorder, Slot, View

Array = np.ndarray

_TRUTHS = set(
    "logical_not isfinite greater greater_equal less less_equal equal not_equal logical_and logical_or".split()
)
_PASSED = {"copy", "gather", "scatter", "largest", "least"}  # operations that make truth values from truth values
_NAMES = {"copy": "positive", "where": "where"}


class Known(Recorder):
    """numbers : of slots in the first phase. lenient : if an ``any`` is true, the program does not require it, so that
    it may include physics that is zero elsewhere."""

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
