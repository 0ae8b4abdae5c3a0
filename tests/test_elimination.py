"""The system of the nodal pressures: elimination against a dense solve, and what it takes of large networks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.native import comb, fork, tree
from solver import Network, Settings
from solver.mesh.elimination import CORE, eliminate, eliminated
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import initial_state, step

Array = np.ndarray


def graph(n: int, chords: int, random: np.random.Generator) -> Array:
    """Element ends of a random tree of n nodes, more like chains or more like bushes, and of some more that close
    loops: some of them side by side, one back to where it starts."""
    reach = random.integers(1, n)
    ends = [(random.integers(max(0, i - reach), i), i) for i in range(1, n)]
    ends += [tuple(random.integers(0, n, 2)) for _ in range(chords)] + ends[: chords // 2] + [(2, 2)] * (chords > 0)
    return np.array(ends)[random.permutation(len(ends))]


def dense(ends: Array, n: int, products: Array, scale: Array, less: Array) -> Array:
    """G : (B, n, n) entry by entry."""
    G = np.zeros((len(products), n, n), products.dtype)
    for (a, b), each in zip(ends.tolist(), np.moveaxis(products.reshape(len(products), -1, 4), 1, 0), strict=True):
        for k, (i, j) in enumerate(((a, a), (a, b), (b, a), (b, b))):
            G[:, i, j] += each[:, k]
    G *= scale[..., None]
    G[:, np.arange(n), np.arange(n)] -= less
    return G


@pytest.mark.parametrize("chords", [0, 3, 30])
@pytest.mark.parametrize("imaginary", [0.0, 1.0])
def test_against_dense(chords: int, imaginary: float) -> None:
    """-G⁻¹ net of random trees and loops, batches of three, as by numpy's dense solve: 5e-15 of the largest (8e-16).

    Case: the elements conduct, in complex numbers too, and every node leaks a little to the ground.
    """
    random = np.random.default_rng(7 + chords)
    for n in (2, 5, 40, 150):
        ends = graph(n, chords if n > 5 else 0, random)
        conducts = random.uniform(0.1, 1.0, (3, len(ends), 1)) * (1.0 + imaginary * 1j * random.uniform())
        products = (conducts * [-1.0, 0.9, 1.1, -1.05]).reshape(3, -1)
        scale, less = random.uniform(0.5, 1.0, (3, n)), random.uniform(0.1, 0.2, (3, n))
        net = random.normal(size=(3, n)) + 0j
        expected = -np.linalg.solve(dense(ends, n, products, scale, less), net[..., None])[..., 0]
        for core in (1, 4, 30):
            plan = eliminate(ends, n, core)
            factor = plan.factor(products, scale, less)
            assert factor.whole().plan.rounds == ()
            for found in (factor.solve(net), factor.whole().solve(net)):
                np.testing.assert_allclose(found, expected, rtol=0.0, atol=5e-15 * np.abs(expected).max())
            assert plan.rounds or n <= max(core, 40)


def test_rounds() -> None:
    """A chain of 4000 nodes loses half of them a round, a star all at once; where all meet all, none can go."""
    chain = np.column_stack([np.arange(3999), np.arange(1, 4000)])
    assert len(eliminate(chain, 4000).rounds) == np.ceil(np.log2(4000 / CORE))
    star = np.column_stack([np.zeros(3999, int), np.arange(1, 4000)])
    assert [len(r.nodes) for r in eliminate(star, 4000).rounds] == [3999]
    full = np.argwhere(np.tri(200, k=-1))
    assert eliminate(full, 200).rounds == () and eliminate(full, 200).inner.shape == (200, 200)


def test_singular() -> None:
    """Nodes that nothing holds: an error of linear algebra, as by numpy, and no nan."""
    ends = np.array([[0, 1], [1, 2], [1, 3]])
    for core in (1, 4):
        with pytest.raises(np.linalg.LinAlgError, match="Singular"):
            eliminate(ends, 4, core).factor(np.zeros((1, 12)), np.ones((1, 4)), np.zeros((1, 4)))


def outputs(network: Network, E: Array) -> dict[str, Array]:
    """P, Q and R of the two parameter sets with E of the root, after 25 steps of 2 ms from rest."""
    model = build(network, {"S0.E": E}, Settings(dt=2e-3, tolerance=1e-8))
    state = initial_state(model)
    for i in range(25):
        state = step(model, state, 2e-3, network.inlet.Q((i + INFLOW_TIMES) * 2e-3))
    report = reporter(model)
    return {signal: report(state)[:, [name.endswith(f".{signal}") for name in report.names]] for signal in "PQR"}


@pytest.mark.parametrize("parents", [fork, comb])
def test_network(parents: Callable[[int], list[int]], monkeypatch: pytest.MonkeyPatch) -> None:
    """300 arteries, two parameter sets: as with the dense inverse, to 3e-14 (4e-15)."""
    network, E = tree(300, parents), np.array([6e5, 9e5])
    found = outputs(network, E)
    monkeypatch.setattr("solver.mesh.mesh.eliminated", lambda ends, n, core: eliminated(ends, n, 10**6))
    expected = outputs(network, E)
    assert np.ptp(expected["P"], axis=0).max() > 10.0  # Pa: the two differ
    for signal, values in expected.items():
        assert np.abs(found[signal] - values).max() <= 3e-14 * np.abs(values).max()
