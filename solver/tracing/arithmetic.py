"""The steps of hearts and bodies as programs: from values, state and time to the next state and the outputs, and the
directional derivatives of these outputs by the values (:mod:`~solver.tracing.tangent`).

A loop is a phase of its own, which runs as long as the first of its numbers is true: phase 1 is that of the first loop,
phase 2 what follows it, and so on. What a loop needs but does not change is computed before it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from ..lumped.arithmetic import Number, State
from ..lumped.component import Arithmetic
from .array import Traced, array, later, of
from .program import Program, Shared, compiled
from .recorder import Recorder, Slot, Untraceable
from .tangent import derivative_of, tangents


class Requirement(NamedTuple):
    """What must be true after a phase; else the sentence, in which %g stands for the next of the numbers."""

    phase: int
    sentence: str
    numbers: int


@dataclass(frozen=True)
class Recorded:
    """A program. loops : how many numbers each has. In ``program.address``: what it is given (``values``, ``t``, ``h``,
    ``state``, ``direction`` of the values), where it reads any; ``next_state`` and ``outputs``, or the derivatives of
    these; of loop k ``begin_k``, ``before_k`` and ``after_k``; of requirement k ``required_k`` and its numbers
    ``number_k_i``."""

    program: Program
    loops: tuple[int, ...]
    requirements: tuple[Requirement, ...]
    n_state: int


def recorded(
    component: Arithmetic, names: Sequence[str], choices: Mapping[str, Sequence[str]], shared: Shared
) -> tuple[Recorded, Recorded, Recorded]:
    """The programs of its initialization, of its step and of the derivatives of the step.

    names : of inputs and parameters, in the order of their numbers. choices : the items of those that are Enumerations,
    whose numbers count from 1. Raises Untraceable.
    """
    first = _Recording(names, choices)
    component = copy.copy(component)
    component.initialize(first.given("t"), first.values)
    begin = first.finished(component, shared)
    step, derivative = _Recording(names, choices), _Derivative(names, choices)
    return begin, _step(step, component, begin.n_state, shared), _step(derivative, component, begin.n_state, shared)


def _step(r: _Recording, begun: Arithmetic, n_state: int, shared: Shared) -> Recorded:
    """A step from a state that is given. begun : the component after its initialization."""
    component = copy.copy(begun)
    state = iter(r.given("state", (n_state,)))
    for name in component.kept:
        setattr(component, name, _rebuilt(getattr(component, name), state))
    component.retune(r.values)
    component.advance(r.given("t"), r.given("h"), r.values)
    return r.finished(component, shared)


class _Recording(Recorder):
    """Records loops and requirements, too."""

    def __init__(self, names: Sequence[str], choices: Mapping[str, Sequence[str]]) -> None:
        super().__init__()
        self.loops: list[int] = []
        self.requirements: list[Requirement] = []
        self.inputs: dict[str, list[Traced]] = {}
        self.out: dict[str, Traced] = {}
        given = self.given("values", (len(names),))
        self.values = {
            name: _Item(x, choices[name]) if name in choices else x for name, x in zip(names, given, strict=True)
        }

    def given(self, name: str, shape: tuple[int, ...] = (), phase: int = 0) -> Any:
        """Numbers that the program is given under a name."""
        self.inputs[name] = [array(self, phase, shape)]
        return self.inputs[name][0]

    def finished(self, component: Arithmetic, shared: Shared) -> Recorded:
        """The program, with the state and the outputs of a component."""
        state = [x for name in component.kept for x in _numbers(getattr(component, name))]
        self.out |= {"next_state": self._stacked(state), "outputs": self.shown(self._stacked(component.outputs()))}
        program = compiled(self, 1 + 2 * len(self.loops), 1, self.inputs, self.out, shared=shared)
        return Recorded(program, tuple(self.loops), tuple(self.requirements), len(state))

    def shown(self, outputs: Traced) -> Traced:
        """The results of the program: the outputs themselves."""
        return outputs

    def solution(self, found: State, correction: Callable[..., State]) -> State:
        """See :func:`solver.lumped.arithmetic.solution`."""
        return found

    def repeated(self, body: Callable[[State], State], state: State) -> State:
        """A loop: see :func:`solver.lumped.arithmetic.repeated`."""
        k = len(self.loops)
        phase = 1 + 2 * k
        numbers = _numbers(state)
        self.loops.append(len(numbers))
        self.out[f"begin_{k}"] = self._stacked(numbers)
        before = self.given(f"before_{k}", (len(numbers),), phase)
        self.out[f"after_{k}"] = self._stacked(_numbers(body(_rebuilt(state, iter(before)))))
        return _rebuilt(state, iter(later(self, before, phase + 1)))

    def require_or_say(self, condition: Traced, sentence: str, numbers: Sequence[Number]) -> None:
        """See :func:`solver.lumped.arithmetic.require`."""
        k = len(self.requirements)
        self.out[f"required_{k}"] = condition
        self.out |= {f"number_{k}_{i}": self._stacked([x]) for i, x in enumerate(numbers)}
        phase = max(x.buffer.slot.phase for x in (condition, *numbers) if isinstance(x, Traced))
        self.requirements.append(Requirement(phase, sentence, len(numbers)))

    def _stacked(self, numbers: Sequence[Number]) -> Traced:
        if any(isinstance(x, Traced) for x in numbers):
            return np.stack(numbers)  # type: ignore[return-value]
        return of(self, self.constant(numbers), (len(numbers),))


class _Derivative(_Recording):
    """Records the derivatives of the outputs in a direction of the values, from a state that has none."""

    def __init__(self, names: Sequence[str], choices: Mapping[str, Sequence[str]]) -> None:
        super().__init__(names, choices)
        self.solved: set[Slot] = set()

    def shown(self, outputs: Traced) -> Traced:
        """The derivatives of the outputs. Raises Untraceable if they depend on a loop that searches for no solution."""
        loops = {self.inputs[f"before_{k}"][0].buffer.slot for k in range(len(self.loops))}
        if self._needed(outputs.buffer.slot) & loops:
            raise Untraceable("a loop has no derivative, unless it searches for a solution()")
        direction = self.given("direction", self.inputs["values"][0].shape)
        self.merge()
        return derivative_of(outputs, tangents(self, {self.inputs["values"][0].buffer.slot: direction.buffer.slot}))

    def solution(self, found: State, correction: Callable[..., State]) -> State:
        """The solution as numbers without derivatives, plus Newton's correction, which has the derivatives."""
        numbers = self._stacked(found)
        x = later(self, numbers, numbers.buffer.slot.phase)
        self.solved.add(x.buffer.slot)
        return tuple(a + b for a, b in zip(x, correction(*x), strict=True))  # type: ignore[return-value]

    def _needed(self, slot: Slot) -> set[Slot]:
        """The slots on which a slot depends, except those from which a search has found a solution."""
        needed = {slot}
        for phase in sorted(self.phases, reverse=True):
            for i in reversed(self.phases[phase]):
                if i.out in needed - self.solved:
                    needed |= {operand.slot for operand in i.operands}
        return needed


def _parts(x: Any) -> Iterable[Any] | None:
    """What a dict, a dataclass or a tuple holds; None for a number."""
    if isinstance(x, dict):
        return x.values()
    return x if isinstance(x, tuple) else [getattr(x, f.name) for f in fields(x)] if is_dataclass(x) else None


def _numbers(x: Any) -> list[Number]:
    """All numbers in it."""
    parts = _parts(x)
    return [x] if parts is None else [number for each in parts for number in _numbers(each)]


def _rebuilt(x: Any, numbers: Iterator[Number]) -> Any:
    """The same of other numbers."""
    parts = _parts(x)
    if parts is None:
        return next(numbers)
    made = [_rebuilt(each, numbers) for each in parts]
    return dict(zip(x, made, strict=True)) if isinstance(x, dict) else type(x)(*made)


class _Item:
    """An Enumeration: its number, which is compared with texts."""

    def __init__(self, number: Traced, choices: Sequence[str]) -> None:
        self.number, self.choices = number, choices

    def __eq__(self, other: object) -> Any:
        return self.number == float(self.choices.index(str(other)) + 1)

    __hash__ = None  # type: ignore[assignment]
