"""Products are fused with the operation that alone uses them, and rounded as NumPy rounds them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from solver.tracing.array import array
from solver.tracing.program import fused
from solver.tracing.recorder import Instruction, Recorder

N = 5


def recorded(f: Callable[..., Any]) -> tuple[list[Instruction], dict[Any, int], Any]:
    """The operations of f(x, y, z), how often they use each slot, and that of the result."""
    r = Recorder()
    out = f(*(array(r, 1, (N,)) for _ in range(3))).buffer.slot
    each, uses = r.phases[1], dict[Any, int]()
    for slot in (slot for i in each for slot in (i.out, *(o.slot for o in i.operands))):
        uses[slot] = uses.get(slot, 0) + 1
    return each, uses, out


def names(f: Callable[..., Any]) -> list[str]:
    each, uses, out = recorded(f)
    return [i.name for i in fused(each, uses, {out})]


@pytest.mark.parametrize(
    ("f", "expected"),
    [
        (lambda x, y, z: x * y + z, ["multiply_add"]),
        (lambda x, y, z: z + x * y, ["multiply_add"]),
        (lambda x, y, z: z * (x * y), ["multiply_multiply"]),
        (lambda x, y, z: x * y + z * x, ["multiply", "multiply_add"]),
        (lambda x, y, z: z - x * y, ["multiply", "subtract"]),
        (lambda x, y, z: 2.0 * x + z, ["multiply", "add"]),  # by one number
        (lambda x, y, z: x * y + 1.0, ["multiply", "add"]),
    ],
)
def test_what_is_fused(f: Callable[..., Any], expected: list[str]) -> None:
    assert names(f) == expected


def test_not_where_it_is_used_again() -> None:
    def f(x: Any, y: Any, z: Any) -> Any:
        product = x * y
        return (product + z) * np.sqrt(product)

    assert names(f) == ["multiply", "add", "sqrt", "multiply"]


def test_not_a_result_of_the_program() -> None:
    each, uses, _ = recorded(lambda x, y, z: x * y + z)
    assert [i.name for i in fused(each, uses, {i.out for i in each})] == ["multiply", "add"]


def test_not_where_a_factor_is_written_again() -> None:
    """A product that were made later would see the numbers that are written in between."""
    each, uses, out = recorded(lambda x, y, z: x * y + z)
    product, end = each
    written = Instruction("copy", product.operands[0].slot, 0, (end.operands[1],), (N,))
    again = [Instruction("copy", product.operands[0].slot, 0, (end.operands[1],), (N,)), product, written, end]
    assert [i.name for i in fused(again, uses, {out})] == ["copy", "multiply", "copy", "add"]
