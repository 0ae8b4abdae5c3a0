"""Find operations of a program that only produce zeros if some parameters are zero, so that the engine can skip them.

Walls with enough viscosity need no further damping: its coefficients, ``np.maximum(..., 0.0)``, are then all 0. A
*block* contains operations that only lead up to a product with such clipped coefficients; if these are all zero, the
engine skips the block and sets its result to zero.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from heapq import heappop, heappush
from typing import NamedTuple

from .recorder import CONSTANT, Instruction, Slot

_FACTORS = {"multiply", "product"}  # 0 if any operand is
_TERMS = {"add", "subtract", "maximum", "minimum"}  # 0 if all operands are
_PASSED = {"copy", "gather", "negative", "absolute", "square", "sign", "sqrt", "sum", "sums", "largest", "least"}
_LEAST = 6  # operations; a smaller block takes less time than the test whether to skip it


class Block(NamedTuple):
    """Operations of which the last writes the result; it is zero if all numbers of the slot ``of`` are."""

    of: Slot
    instructions: list[Instruction]


def blocks(kept: Mapping[int, Sequence[Instruction]], asked: Iterable[Slot]) -> dict[int, list[Instruction | Block]]:
    """The operations of every phase, skippable ones in blocks; asked : slots that are read from outside."""
    written = Counter(i.out for each in kept.values() for i in each)
    uses = defaultdict[Slot, list[tuple[int, int]]](list)
    for phase, each in kept.items():
        for n, i in enumerate(each):
            for slot in {o.slot for o in i.operands}:
                uses[slot].append((phase, n))
    zero, outside = _zeros(kept, written), set(asked)
    # candidates for blocks: written once, read only here, from slots that are written once, so that they may move
    inner = {
        i.out: uses[i.out]
        for each in kept.values()
        for i in each
        if i.out not in outside and written[i.out] == 1 and all(written[o.slot] <= 1 for o in i.operands)
    }
    return {phase: _in_blocks(each, zero, inner, phase) if phase else [*each] for phase, each in kept.items()}


def _zeros(kept: Mapping[int, Sequence[Instruction]], written: Mapping[Slot, int]) -> dict[Slot, tuple[Slot, ...]]:
    """For every slot the clipped coefficients of which any single one suffices: if it is zero, so is the slot."""
    zero = dict[Slot, tuple[Slot, ...]]()
    for phase in sorted(kept):
        for i in kept[phase]:
            of = [zero.get(o.slot, ()) for o in i.operands]
            found: tuple[Slot, ...] = ()
            if i.name in _FACTORS:
                found = tuple(dict.fromkeys(s for each in of for s in each))
            elif i.name in _TERMS:
                found = tuple(s for s in of[0] if s in of[1])
            elif i.name in _PASSED:
                found = of[0]
            zero[i.out] = (*found, i.out) if phase == 0 and _clipped(i) else found if written[i.out] == 1 else ()
    return zero


def _clipped(i: Instruction) -> bool:
    """True if an operation clips negative numbers to 0: coefficients that are often all 0."""
    data = [o.slot.data for o in i.operands if o.slot.phase == CONSTANT]
    return i.name == "maximum" and any(x is not None and not x.any() for x in data)


def _in_blocks(
    each: Sequence[Instruction],
    zero: Mapping[Slot, tuple[Slot, ...]],
    inner: Mapping[Slot, Sequence[tuple[int, int]]],
    phase: int,
) -> list[Instruction | Block]:
    """The operations of one phase, in blocks. inner : users of the candidates for blocks, by phase and place there."""
    makes = {i.out: n for n, i in enumerate(each) if i.out in inner}
    taken, found = set[int](), dict[int, Block]()
    for end in range(len(each))[::-1]:
        if end in taken or not zero[each[end].out]:
            continue
        own, asked = {end}, [-end]
        while asked:  # latest first, so that all users of an operation were already visited
            for operand in each[-heappop(asked)].operands:
                n = makes.get(operand.slot, -1)
                fits = n >= 0 and n not in own and n not in taken
                if fits and all(p == phase and user in own for p, user in inner[operand.slot]):
                    own.add(n)
                    heappush(asked, -n)
        if len(own) >= _LEAST:
            taken |= own
            of = min(zero[each[end].out], key=lambda slot: slot.size)
            found[end] = Block(of, [each[n] for n in sorted(own)])
    return [found.get(n, i) for n, i in enumerate(each) if n in found or n not in taken]
