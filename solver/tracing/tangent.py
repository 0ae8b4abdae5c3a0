"""Forward-mode differentiation of recorded operations, in one direction.

Each operation that depends on a seeded input is followed by its derivative, in the same phase, by the rules in
:data:`_RULES`. Comparisons have no derivative; branches stay as taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .array import Traced, of
from .recorder import CONSTANT, Buffer, Instruction, Operand, Recorder, Slot

_FLAT = {"greater", "greater_equal", "less", "less_equal", "equal", "not_equal", "logical_and", "logical_or",
         "logical_not", "isfinite", "sign", "require"}  # fmt: skip
_LINEAR = {"copy", "negative", "gather", "scatter", "sums", "sum"}


def tangents(r: Recorder, seeds: Mapping[Slot, Slot]) -> dict[Slot, Slot]:
    """Write derivatives behind the operations, and return their slots. seeds : directions of inputs, by slot."""
    made = dict(seeds)
    grown = True
    while grown:  # a part of an array may be written, and read, before another part that has a direction
        grown = False
        for phase in sorted(r.phases):
            for i in r.phases[phase]:
                if i.name not in _FLAT and i.out not in made and any(o.slot in made for o in i.operands):
                    made[i.out] = Slot(i.out.size, i.out.phase)
                    grown = True
    for phase, each in r.phases.items():
        forward = _Forward(r, made)
        for i in each:
            forward.written.append(i)
            if i.out in made and i.name != "require":
                forward.derive(i)
        r.phases[phase] = forward.written
    return made


def derivative_of(x: Traced, slopes: Mapping[Slot, Slot]) -> Traced:
    """The derivative of an array, zeros if it depends on no seed. slopes : what :func:`tangents` returned."""
    slot = slopes.get(x.buffer.slot)
    if slot is None:
        return of(x.recorder, x.recorder.constant(np.zeros(x.size)), x.shape)
    return Traced(x.recorder, Buffer(slot), x.index)


class _Forward:
    """The operations of a phase with their derivatives."""

    def __init__(self, r: Recorder, made: Mapping[Slot, Slot]) -> None:
        self.r, self.made, self.written = r, made, list[Instruction]()
        every = (i for each in r.phases.values() for i in each)  # comparisons with a constant of the code
        self.alone = {i.out for i in every if i.name == "equal" and any(o.slot.phase == CONSTANT for o in i.operands)}

    def constant(self, x: float) -> Operand:
        return Operand(self.r.constant(x), 0, True)

    def tangent(self, o: Operand) -> Operand | None:
        return o._replace(slot=self.made[o.slot]) if o.slot in self.made else None

    def derive(self, i: Instruction) -> None:
        """Write the derivative of an operation's result."""
        self.i, out, d = i, self.made[i.out], [self.tangent(o) for o in i.operands]
        self.size = i.out.size if i.name == "product" else i.sizes[0]

        def put(name: str, operands: tuple[Operand, ...], sizes: tuple[int, ...], places: Any = None) -> None:
            self.written.append(Instruction(name, out, i.start, operands, sizes, places))

        if i.name in _LINEAR and d[0] is not None:
            put(i.name, (d[0],), i.sizes, i.places)
        elif i.name == "scatter":
            put(i.name, (self.constant(0.0),), i.sizes, i.places)
        elif not any(d):
            put("copy", (self.constant(0.0),), (self.size,))
        elif i.name == "product":
            parts = [x for x in (d[0] and (d[0], i.operands[1]), d[1] and (i.operands[0], d[1])) if x]
            if len(parts) == 1:
                put("product", parts[0], i.sizes)
            else:
                put("add", (self.product(*parts[0]), self.product(*parts[1])), (self.size,))
        elif i.name in _RULES:
            value = Operand(i.out, i.start, False)
            put("copy", (_RULES[i.name](self, value, *i.operands, *d),), (self.size,))
        else:  # never used
            put("copy", (self.constant(np.nan),), (self.size,))

    def product(self, a: Operand, b: Operand) -> Operand:
        return self._new("product", (a, b), self.i.sizes)

    def __call__(self, name: str, *operands: Operand) -> Operand:
        return self._new(name, operands, (self.size,))

    def _new(self, name: str, operands: tuple[Operand, ...], sizes: tuple[int, ...]) -> Operand:
        slot = Slot(self.size, self.i.out.phase)
        self.written.append(Instruction(name, slot, 0, operands, sizes))
        return Operand(slot, 0, False)

    def added(self, a: Operand | None, b: Operand | None) -> Operand:
        """The sum of the operands that are not None."""
        return self("add", a, b) if a and b else a or b or self.constant(0.0)

    def chosen(self, c: Operand, da: Operand, db: Operand) -> Operand:
        """The derivative of ``where``: that of the branch taken. For a condition at a single value only, such as a
        coefficient of 0, the derivative of the other branch is valid nearby, and is taken if finite."""
        if c.slot in self.alone:
            c = self("logical_and", c, self("logical_not", self("isfinite", db)))
        return self("where", c, da, db)

    def times(self, a: Operand, b: Operand | None) -> Operand | None:
        return self("multiply", a, b) if b else None


def _power(f: _Forward, y: Operand, a: Operand, b: Operand, da: Operand | None, db: Operand | None) -> Operand:
    slope = f("multiply", b, f("power", a, f("subtract", b, f.constant(1.0))))
    return f.added(f.times(slope, da), db and f("multiply", f("multiply", y, f("log", a)), db))


def _chosen(comparison: str) -> Callable[..., Operand]:
    def rule(f: _Forward, y: Operand, a: Operand, b: Operand, da: Operand | None, db: Operand | None) -> Operand:
        none = f.constant(0.0)
        return f("where", f(comparison, a, b), da or none, db or none)

    return rule


def _of_slope(slope: Callable[[_Forward, Operand, Operand], Operand]) -> Callable[..., Operand]:
    """The chain rule of a function y of one number a, with a slope computed from both."""
    return lambda f, y, a, da: f("multiply", slope(f, y, a), da)


_RULES: Mapping[str, Callable[..., Operand]] = {
    "add": lambda f, y, a, b, da, db: f.added(da, db),
    "subtract": lambda f, y, a, b, da, db: f.added(da, db and f("negative", db)),
    "multiply": lambda f, y, a, b, da, db: f.added(f.times(b, da), f.times(a, db)),
    "divide": lambda f, y, a, b, da, db: f("divide", f.added(da, db and f("negative", f("multiply", y, db))), b),
    "power": _power,
    "where": lambda f, y, c, a, b, dc, da, db: f.chosen(c, da or f.constant(0.0), db or f.constant(0.0)),
    "maximum": _chosen("greater_equal"),
    "minimum": _chosen("less_equal"),
    "sqrt": _of_slope(lambda f, y, a: f("divide", f.constant(0.5), y)),
    "exp": _of_slope(lambda f, y, a: y),
    "expm1": _of_slope(lambda f, y, a: f("exp", a)),
    "log": _of_slope(lambda f, y, a: f("reciprocal", a)),
    "log1p": _of_slope(lambda f, y, a: f("reciprocal", f("add", f.constant(1.0), a))),
    "absolute": _of_slope(lambda f, y, a: f("sign", a)),
    "square": _of_slope(lambda f, y, a: f("multiply", f.constant(2.0), a)),
    "reciprocal": _of_slope(lambda f, y, a: f("negative", f("square", y))),
    "sin": _of_slope(lambda f, y, a: f("cos", a)),
    "cos": _of_slope(lambda f, y, a: f("negative", f("sin", a))),
    "sinh": _of_slope(lambda f, y, a: f("cosh", a)),
    "cosh": _of_slope(lambda f, y, a: f("sinh", a)),
    "tanh": _of_slope(lambda f, y, a: f("subtract", f.constant(1.0), f("square", y))),
}
