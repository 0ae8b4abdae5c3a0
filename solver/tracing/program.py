"""Recorded operations as numbers for the engine in ``native/``.

A program has five kinds of memory: constants of the code; numbers of a parameter set, one block per member of a batch;
workspace; held results of one phase, one block per run of that phase; and indices. An address is 4 · offset + kind.
Numbers used in one phase only share their places.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from .array import ELEMENTWISE, Traced
from .recorder import CONSTANT, Instruction, Operand, Recorder, Slot
from .skipping import Block, blocks

Array = np.ndarray

_OTHER = ("gather", "scatter", "sums", "product", "inverse", "sum", "largest", "least", "require", "skip")
FUSED = {"add": "multiply_add", "multiply": "multiply_multiply"}  # a b + c, a b c
OPERATIONS = (*ELEMENTWISE, *FUSED.values(), *_OTHER)
_CODES = {name: code for code, name in enumerate(OPERATIONS, 1)}
_CONSTANT, _FIXED, _WORK, _HELD = range(4)
_GROUPED = {*ELEMENTWISE, "gather", "product"}  # operations that may be executed together
_AT_ONCE = 256  # numbers of an operation


class Pool:
    """Distinct arrays one after the other, which programs may share: later additions move nothing."""

    def __init__(self, kind: type) -> None:
        self.parts: list[Array] = [np.zeros(1, kind)]
        self.size = 1
        self._known: dict[bytes, int] = {}

    def put(self, x: Array) -> int:
        """The offset of an array, which is added if it is new."""
        x = x.astype(self.parts[0].dtype)
        key = x.tobytes()
        if key not in self._known:
            self._known[key] = self.size
            self.parts.append(x)
            self.size += x.size
        return self._known[key]

    def all(self) -> Array:
        return np.concatenate(self.parts)


@dataclass
class Shared:
    """Constants and indices that the programs of one network share."""

    constants: Pool = field(default_factory=lambda: Pool(float))
    index: Pool = field(default_factory=lambda: Pool(np.int32))

    @property
    def nbytes(self) -> int:
        return 8 * self.constants.size + 4 * self.index.size


@dataclass(frozen=True)
class Program:
    """code : of all phases; begin : (n_phases + 1,) their offsets. constants, index : numbers and places used by it.
    n_fixed, n_work, n_held : sizes of the numbers of a member, the workspace and a held block. address : of inputs and
    outputs by name."""

    code: Array
    begin: Array
    constants: Array
    index: Array
    n_fixed: int
    n_work: int
    n_held: int
    address: Mapping[str, int]


def compiled(
    r: Recorder, phases: int, units: int, inputs: Mapping[str, Sequence[Traced]], outputs: Mapping[str, Traced],
    held: int | None = None, shared: Shared | None = None,
) -> Program:  # fmt: skip
    """The program of all recorded operations that outputs need. units : elements of the mesh. held : the phase whose
    results are held in blocks. shared : constants and indices of earlier programs, to which those of this one are
    added. An input of several phases has one place."""
    r.merge()
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
    given = {name: [x.buffer.slot for x in each] for name, each in inputs.items()}
    asked = {slot for each in given.values() for slot in each} | {end.slot for end in ends.values()}
    laid = blocks(kept, asked)
    asked |= {item.of for each in laid.values() for item in each if isinstance(item, Block)}
    shared = shared or Shared()
    place = _Places(units, asked, kept, held, shared)
    for first, *others in given.values():
        place.address |= {slot: place.of(first) for slot in others}
    written = [place.encoded(laid[phase]) for phase in range(phases)]
    address = {name: place.of(slot) for name, (slot, *_) in given.items() if slot.phase or slot in needed}
    address |= {name: place.of(end.slot) + 4 * end.start for name, end in ends.items()}
    return Program(
        code=np.concatenate([np.array(code, np.int32) for code in written]),
        begin=np.cumsum([0, *map(len, written)]).astype(np.int32),
        constants=shared.constants.all(),
        index=shared.index.all(),
        n_fixed=place.size[_FIXED],
        n_work=place.size[_WORK],
        n_held=place.size[_HELD],
        address=address,
    )


class _Group(NamedTuple):
    """Operations that are executed together, some parts at once, so that intermediate results stay in the cache.

    units : the parts; 0 for a single operation that is not grouped. at_once : the number of parts at once.
    """

    units: int
    at_once: int
    instructions: list[Instruction]

    @staticmethod
    def of(units: int, instructions: list[Instruction]) -> _Group:
        widest = max(_width(each, units) for each in instructions) if units else 1
        return _Group(units, max(1, _AT_ONCE // widest), instructions)

    def inner(self, uses: Mapping[Slot, int]) -> set[Slot]:
        """The slots that only this group uses and of which some parts fit into a block; none if all parts are executed
        at once. uses : how often a phase uses each slot."""
        own = _uses(self.instructions) if self.units > self.at_once else {}
        fit = {slot for slot in own if slot.size // self.units * self.at_once <= _AT_ONCE}
        return {slot for slot in fit if own[slot] == uses[slot]}


def _runs(items: Sequence[Instruction | Block]) -> list[Block | list[Instruction]]:
    """Blocks, and the operations between them."""
    found: list[Block | list[Instruction]] = []
    for item in items:
        if isinstance(item, Block):
            found.append(item)
        elif found and isinstance(found[-1], list):
            found[-1].append(item)
        else:
            found.append([item])
    return found


def _uses(instructions: Iterable[Instruction]) -> Counter[Slot]:
    return Counter([slot for i in instructions for slot in i.slots])


def _width(each: Instruction, units: int) -> int:
    """Numbers of a part; for a product, its rows or matrices."""
    count, *sizes = each.sizes
    return (sizes[0] if each.name == "product" and count == 1 else count) // units


def _apart(each: Instruction) -> list[Operand]:
    """The operands that are read at other places than those written."""
    if each.name == "gather":
        return list(each.operands)
    if each.name == "product":
        count, *_, one, two = each.sizes
        shared = (False, True) if count == 1 else (not one, not two)
        return [o for o, same in zip(each.operands, shared, strict=True) if same or o.start]
    return [o for o in each.operands if o.single or o.start]


@dataclass
class _Places:
    """Addresses of slots. lasting : slots that outlive their phase, or are inputs or outputs. units : elements of the
    mesh, by which operations are divided into parts. blocks : room for the parts at once of slots that only one group
    uses."""

    units: int
    lasting: set[Slot]
    kept: Mapping[int, list[Instruction]]
    held: int | None
    shared: Shared
    address: dict[Slot, int] = field(default_factory=dict)
    size: list[int] = field(default_factory=lambda: [0, 0, 0, 0])
    free: dict[int, list[int]] = field(default_factory=lambda: defaultdict(list))
    blocks: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        for phase, instructions in self.kept.items():
            for instruction in instructions:
                self.lasting |= {o.slot for o in instruction.operands if o.slot.phase != phase}

    def of(self, slot: Slot) -> int:
        """The address of a slot, assigned at the first call."""
        if slot not in self.address:
            kind = {CONSTANT: _CONSTANT, 0: _FIXED, self.held: _HELD}.get(slot.phase, _WORK)
            kind = _WORK if kind != _CONSTANT and slot not in self.lasting else kind
            if kind == _CONSTANT:
                data = np.zeros(slot.size) if slot.data is None else slot.data
                self.address[slot] = 4 * self.shared.constants.put(data) + kind
            elif kind == _WORK and slot not in self.lasting and self.free[slot.size]:
                self.address[slot] = self.free[slot.size].pop()
            else:
                self.address[slot] = 4 * self.size[kind] + kind
                self.size[kind] += slot.size
        return self.address[slot]

    def encoded(self, items: Sequence[Instruction | Block]) -> list[int]:
        """The code of a phase."""
        runs = [(item, item.instructions) if isinstance(item, Block) else (None, item) for item in _runs(items)]
        uses = _uses(i for _, each in runs for i in each)
        grouped = [(block, self._groups(each, uses)) for block, each in runs]
        order = [i for _, groups in grouped for group in groups for i in group.instructions]
        last = {slot: i for i in order for slot in i.slots}
        uses, code = _uses(order), list[int]()
        for block, groups in grouped:
            within = self._straight(groups, last, uses)
            if block:  # the operation that may skip it: tested numbers, result, words skipped
                out = block.instructions[-1].out
                code += [_CODES["skip"], 7, self.of(block.of), block.of.size, self.of(out), out.size, len(within)]
            code += within
        return code

    def _straight(
        self, groups: Sequence[_Group], last: Mapping[Slot, Instruction], uses: Mapping[Slot, int]
    ) -> list[int]:
        """Consecutive operations. last : the last operation of the phase that uses each slot; uses : how often it uses
        them."""
        code = list[int]()
        for group in groups:
            inner, room, within = group.inner(uses) - self.lasting, self.blocks[::-1], dict[Slot, int]()
            if group.units:  # operation 0: parts, how many at once, operations
                code += [0, group.units, group.at_once, len(group.instructions)]
            for each in group.instructions:
                if each.out in inner and each.out not in within:
                    within[each.out] = room.pop() if room else self._block()
                if group.units:
                    code += self._grouped(each, group.units, within)
                else:
                    code += self._elementwise(each) if each.name in ELEMENTWISE else self._other(each)
                # in order, so that the same network has the same program
                for slot in dict.fromkeys(each.slots):
                    if last[slot] is each and slot.phase != CONSTANT and slot not in self.lasting:
                        (room if slot in within else self.free[slot.size]).append(within.get(slot) or self.of(slot))
        return code

    def _groups(self, instructions: Sequence[Instruction], uses: Mapping[Slot, int]) -> list[_Group]:
        """Neighbours that can be executed together. uses : how often the phase uses each slot."""
        found = list[tuple[int, list[Instruction]]]()
        written = set[Slot]()
        for each in instructions:
            units = self._units(each)
            if not units or not found or units != found[-1][0] or any(o.slot in written for o in _apart(each)):
                found.append((units, []))
                written = set()
            found[-1][1].append(each)
            written.add(each.out)
        return [_Group.of(units, fused(each, uses, self.lasting) if units else each) for units, each in found]

    def _block(self) -> int:
        """The address of one more block."""
        self.blocks.append(4 * self.size[_WORK] + _WORK)
        self.size[_WORK] += _AT_ONCE
        return self.blocks[-1]

    def _units(self, each: Instruction) -> int:
        """The number of equal parts in which an operation can be grouped with its neighbours; 0 for none.

        It must then write a whole slot, and operands read at other places must be lasting: no other slot reuses them.
        """
        if each.start or each.name not in _GROUPED:
            return 0
        if any(o.slot not in self.lasting and o.slot.phase != CONSTANT for o in _apart(each) if not o.single):
            return 0
        if each.name == "product":
            count, m, k, n, *_ = each.sizes
            fits = max(k, n) < 256 and each.out.size == count * m * n
            return self.units if fits and (m if count == 1 else count) % self.units == 0 else 0
        n = each.sizes[0]
        return 0 if n != each.out.size else self.units if n % self.units == 0 else n

    def _grouped(self, each: Instruction, units: int, within: Mapping[Slot, int]) -> list[int]:
        """An operation of a group: 8 words. within : the blocks of slots that only the group uses; flags from 8 on say
        which of the result and the operands these are."""
        slots = each.slots
        out, *places = [within.get(slot) or self.of(slot) for slot in slots]
        places = [place + 4 * o.start for place, o in zip(places, each.operands, strict=True)]
        flags, extra = sum(1 << i for i, o in enumerate(each.operands) if o.single), 0
        if each.name == "gather":
            places.append(self._index(each))
        if each.name == "product":
            count, m, k, n, one, two = each.sizes
            places.append(m)
            flags, extra = 4 if count == 1 else one + 2 * two, 256 * k + n
        flags += sum(8 << i for i, slot in enumerate(slots) if slot in within)
        return [_CODES[each.name], flags, _width(each, units), out, *places, *[0] * (3 - len(places)), extra]

    def _elementwise(self, each: Instruction) -> list[int]:
        """An elementwise operation as a group of its own, because of the places that it reads or writes."""
        single = sum(1 << i for i, o in enumerate(each.operands) if o.single)
        places = [self.of(o.slot) + 4 * o.start for o in each.operands]
        numbers = [1, *places, *[0] * (3 - len(places)), 0]
        out = self.of(each.out) + 4 * each.start
        return [0, each.sizes[0], each.sizes[0], 1, _CODES[each.name], single, 1, out, *numbers[1:]]

    def _index(self, each: Instruction) -> int:
        """The offset of its places among all indices."""
        return 0 if each.places is None else self.shared.index.put(each.places)

    def _other(self, each: Instruction) -> list[int]:
        places = [self.of(o.slot) + 4 * o.start for o in each.operands]
        single = [int(o.single) for o in each.operands]
        numbers = [self.of(each.out) + 4 * each.start, self._index(each), *each.sizes, *places, *single]
        return [_CODES[each.name], 2 + len(numbers), *numbers]


def fused(each: Sequence[Instruction], uses: Mapping[Slot, int], lasting: Collection[Slot]) -> list[Instruction]:
    """Operations that are executed together, a product fused with the operation that alone uses it.

    One pass over the numbers in place of two. Each is rounded as before: a b + c is not a fused multiply-add of the
    processor. uses : how often the phase uses each slot; lasting : slots that are used elsewhere, too.
    """
    written = Counter(i.out for i in each)
    found: list[Instruction | None] = []
    products = dict[Slot, int]()  # by result, where they stand in what is found
    for i in each:
        at, other = -1, i
        for own, rest in (i.operands, i.operands[::-1]) if i.name in FUSED else ():
            if own.slot in products and i.sizes == (own.slot.size,) and not rest.single:
                at = products.pop(own.slot)
                product = found[at]
                assert product is not None
                other = i._replace(name=FUSED[i.name], operands=(*product.operands, rest))
                break
        if at >= 0:
            found[at] = None
        elif i.name == "multiply" and uses[i.out] == 2 and i.out not in lasting and not i.start:
            if not any(o.single or written[o.slot] > 1 for o in i.operands):
                products[i.out] = len(found)
        found.append(other)
    return [i for i in found if i is not None]
