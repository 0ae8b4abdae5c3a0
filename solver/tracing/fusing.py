"""Fuse a product with the operation that alone uses it: one pass over the numbers in place of two.

Each is rounded as before: a b + c is not a fused multiply-add of the processor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from .recorder import Instruction, Slot

FUSED = {"add": "multiply_add", "multiply": "multiply_multiply"}  # a b + c, a b c


def fused(each: Sequence[Instruction], uses: Mapping[Slot, int], lasting: Collection[Slot]) -> list[Instruction]:
    """Operations that are executed together, with products fused. uses : how often the phase uses each slot; lasting :
    slots that are used elsewhere, too."""
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
