"""What clipped coefficients make zero is skipped where these are zero; what programs share, and their numbers."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus import Store
from native_build import build
from native_fmus import apart, needs_compiler, pair, rows

from solver import Settings, load
from solver.tracing import native
from solver.tracing.array import array
from solver.tracing.component import whole
from solver.tracing.native import Program
from solver.tracing.program import Shared, compiled
from solver.tracing.recorder import Recorder


@pytest.fixture(scope="module", autouse=True)
def engine() -> None:
    try:
        native.library()
    except native.NoEngine:
        said = build()
        native.library.cache_clear()
        try:
            native.library()
        except native.NoEngine as reason:
            pytest.skip(f"{said} ({reason})")


def plain(x: Any) -> Any:
    for _ in range(3):
        x = np.sqrt(x * x + 1.0 / x)
    return x


def rewritten(x: Any) -> Any:
    """Of an array that is written again after it was read."""
    part = np.zeros_like(x)
    part[:2] = x[:2]
    found = plain(part + 1.0)
    part[1:] = 7.0 * x[1:]
    return found + 0.0 * part.sum()


def run(c: Sequence[float], x: Sequence[float], f: Callable[[Any], Any] = plain) -> np.ndarray:
    """x + 2 max(c, 0) f(x), by the engine; c is given in the first phase, x in the second, and both run as one."""
    r = Recorder()
    given = {"c": array(r, 0, (3,)), "x": array(r, 1, (3,))}
    out = 2.0 * np.maximum(given["c"], 0.0) * f(given["x"]) + given["x"]
    made = compiled(r, 2, 1, {name: [slot] for name, slot in given.items()}, {"out": out})
    begin = made.begin[[0, 2]]
    program = Program(*(a.ctypes.data for a in (made.code, begin, made.index, made.constants)), made.n_fixed)
    memory = {1: np.zeros(made.n_fixed), 2: np.zeros(made.n_work)}

    def at(name: str) -> np.ndarray:
        address = made.address[name]
        return memory[address & 3][address >> 2 :][:3]

    at("c")[:], at("x")[:] = c, x
    assert native.library().arterial_bind(ctypes.byref(program), memory[1].ctypes.data, memory[2].ctypes.data)
    return at("out").copy()


def test_skipped_where_all_are_zero() -> None:
    """0 times what would be infinite is 0 where it is skipped; where one coefficient is not 0 all is computed."""
    assert run([-1.0, 0.0, -2.0], [0.0, 1.0, 2.0]).tolist() == [0.0, 1.0, 2.0]
    assert np.isnan(run([-1.0, 1.0, 0.0], [0.0, 1.0, 2.0]))[0]
    x = np.array([2.0, 1.0, 3.0])
    for f in (plain, rewritten):
        found = run([0.5, -1.0, 2.0], x.tolist(), f)
        np.testing.assert_allclose(found, x + 2.0 * np.array([0.5, 0.0, 2.0]) * f(x), rtol=1e-15)


@needs_compiler
def test_walls_that_stop_damping_in_mid_run(stored: Store, tmp_path: Path) -> None:
    """The native FMU takes up the damping when all walls become elastic, and leaves it: as the other FMU (2e-12)."""
    network = load("sheep")
    own = {f"{s.name}.phi0": network.parameters()[f"{s.name}.phi0"] for s in network.segments}
    one, two = pair(stored, network, tmp_path)
    tuned = {20: dict.fromkeys(own, 0.0), 60: own}
    run = ({"inlet.interpolation": "linear"}, 100)
    found, expected = rows(two, *run, tuned=tuned), rows(one, *run, tuned=tuned)
    off, _ = apart(one, found, expected)
    assert off <= 2e-12
    plain = rows(one, *run)
    assert apart(one, plain, expected)[0] > 1e-3


def test_programs_share_constants_and_indices() -> None:
    """The second program adds little to what the first one has, and leaves it as it is."""
    network, shared = load("sheep"), Shared()
    first = whole(network, Settings(), shared=shared).program
    second = whole(network, Settings(), True, shared).program
    alone = whole(network, Settings(), True).program
    for name in ("constants", "index"):
        one, two = getattr(first, name), getattr(second, name)
        np.testing.assert_array_equal(two[: len(one)], one)
        assert len(two) - len(one) < 0.1 * len(getattr(alone, name))
