"""Recorded operations as numbers that the engine in ``native/`` runs.

A program has four kinds of memory: constants of the code; what a parameter set fixes, one block a member of a batch;
workspace; and indices. An address is 4 · offset + kind. What only one phase uses shares its place with others.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .array import ELEMENTWISE, Traced
from .recorder import CONSTANT, Instruction, Operand, Recorder, Slot

Array = np.ndarray

_OTHER = ("gather", "scatter", "sums", "product", "inverse", "sum", "largest", "least", "require")
OPERATIONS = (*ELEMENTWISE, *_OTHER)
_CODES = {name: code for code, name in enumerate(OPERATIONS, 1)}
_FIRST_OTHER = len(ELEMENTWISE) + 1
_CONSTANT, _FIXED, _WORK = range(3)


@dataclass(frozen=True)
class Program:
    """code : of all phases, begin : (n_phases + 1,) where each begins. constants, index : numbers and places in it.
    n_fixed, n_work : how many numbers a member and the workspace have. address : of inputs and outputs by name."""

    code: Array
    begin: Array
    constants: Array
    index: Array
    n_fixed: int
    n_work: int
    address: Mapping[str, int]


def compiled(r: Recorder, phases: int, inputs: Mapping[str, Traced], outputs: Mapping[str, Traced]) -> Program:
    """The program of all that was recorded and that outputs need."""
    ends = {name: r.operand(x, x.shape) for name, x in outputs.items()}
    for name, end in ends.items():
        if end.single and outputs[name].size > 1 or end.slot.phase == CONSTANT:
            size = max(1, outputs[name].size)
            ends[name] = Operand(r.emit("copy", (end,), (size,), size), 0, False)
    needed = {end.slot for end in ends.values()}
    kept: dict[int, list[Instruction]] = {}
    for phase in range(phases)[::-1]:
        kept[phase] = []
        for instruction in reversed(r.phases.get(phase, ())):
            if instruction.out in needed or instruction.name == "require":
                kept[phase].append(instruction)
                needed |= {operand.slot for operand in instruction.operands}
        kept[phase].reverse()
    place = _Places({x.buffer.slot for x in inputs.values()} | {end.slot for end in ends.values()}, kept)
    written = [place.encoded(kept[phase]) for phase in range(phases)]
    used = {slot for each in kept.values() for i in each for slot in (i.out, *(o.slot for o in i.operands))}
    address = {name: place.of(x.buffer.slot) for name, x in inputs.items()
               if x.buffer.slot.phase or x.buffer.slot in used}  # fmt: skip
    address |= {name: place.of(end.slot) + 4 * end.start for name, end in ends.items()}
    return Program(
        code=np.concatenate([np.array(code, np.int32) for code in written]),
        begin=np.cumsum([0, *map(len, written)]).astype(np.int32),
        constants=np.concatenate([np.zeros(1), *place.constants]),
        index=np.concatenate([np.zeros(1, np.int32), *place.indices]).astype(np.int32),
        n_fixed=place.size[_FIXED],
        n_work=place.size[_WORK],
        address=address,
    )


@dataclass
class _Places:
    """Where slots lie. lasting : those that outlive their phase, or are given or asked for."""

    lasting: set[Slot]
    kept: Mapping[int, list[Instruction]]
    address: dict[Slot, int] = field(default_factory=dict)
    size: list[int] = field(default_factory=lambda: [1, 0, 0])
    constants: list[Array] = field(default_factory=list)
    indices: list[Array] = field(default_factory=list)
    n_index: int = 1
    free: dict[int, list[int]] = field(default_factory=lambda: defaultdict(list))

    def __post_init__(self) -> None:
        for phase, instructions in self.kept.items():
            for instruction in instructions:
                self.lasting |= {o.slot for o in instruction.operands if o.slot.phase != phase}

    def of(self, slot: Slot) -> int:
        """The address of a slot, which gets one the first time."""
        if slot not in self.address:
            kind = _WORK if slot.phase > 0 else _FIXED if slot.phase == 0 else _CONSTANT
            if kind == _CONSTANT:
                self.constants.append(np.zeros(slot.size) if slot.data is None else slot.data)
            if kind == _WORK and slot not in self.lasting and self.free[slot.size]:
                self.address[slot] = self.free[slot.size].pop()
            else:
                self.address[slot] = 4 * self.size[kind] + kind
                self.size[kind] += slot.size
        return self.address[slot]

    def encoded(self, instructions: list[Instruction]) -> list[int]:
        """The code of a phase."""
        last = {slot: i for i, each in enumerate(instructions) for slot in (each.out, *(o.slot for o in each.operands))}
        code, group, length = list[int](), list[int](), 0
        for i, each in enumerate(instructions):
            fused = each.name in ELEMENTWISE and self._whole(each)
            if group and not (fused and each.sizes[0] == length):
                code += [0, length, len(group) // 6, *group]
                group = []
            if each.name in ELEMENTWISE:
                group += self._elementwise(each)
                length = each.sizes[0]
                if not fused:
                    code += [0, length, 1, *group]
                    group = []
            else:
                code += self._other(each)
            for slot in {each.out, *(o.slot for o in each.operands)}:
                if last[slot] == i and slot.phase > 0 and slot not in self.lasting:
                    self.free[slot.size].append(self.address[slot])
        return code + ([0, length, len(group) // 6, *group] if group else [])

    def _whole(self, each: Instruction) -> bool:
        """Whether it may run piece by piece with its neighbours: it reads and writes the same places of slots."""
        same = all(o.single and o.slot.phase != each.out.phase or not o.start and not o.single or o.slot in self.lasting
                   and o.slot.phase != each.out.phase for o in each.operands)  # fmt: skip
        return same and not each.start and each.sizes[0] == each.out.size

    def _elementwise(self, each: Instruction) -> list[int]:
        single = sum(1 << i for i, o in enumerate(each.operands) if o.single)
        places = [self.of(o.slot) + 4 * o.start for o in each.operands]
        return [_CODES[each.name], single, self.of(each.out) + 4 * each.start, *places, *[0] * (3 - len(places))]

    def _other(self, each: Instruction) -> list[int]:
        at = 0
        if each.places is not None:
            at = self.n_index
            self.indices.append(each.places)
            self.n_index += len(each.places)
        places = [self.of(o.slot) + 4 * o.start for o in each.operands]
        single = [int(o.single) for o in each.operands]
        numbers = [self.of(each.out) + 4 * each.start, at, *each.sizes, *places, *single]
        return [_CODES[each.name], 2 + len(numbers), *numbers]
