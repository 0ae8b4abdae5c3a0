"""Rest and mass: exact to round-off, whatever the parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.native import comb, fork, tree
from solver import Network, Windkessel, simulate
from solver.scheme.model import Model, build
from solver.scheme.sdirk import INFLOW_AT_STAGES, INFLOW_TIMES, SDIRK3
from solver.scheme.step import State, initial_state, step


@pytest.mark.parametrize("P_0", [0.0, 5000.0, -500.0])
def test_rest_stays_at_rest(sheep: Network, P_0: float) -> None:
    """Q = 0, P = P_0 is a solution: after one beat flow, pressure and radius have moved by round-off only."""
    venous = {f"{outlet.segment}.outlet.P_venous": P_0 for outlet in sheep.outlets}
    beat = simulate(sheep.with_parameters({"network.P_0": P_0, **venous}), lambda t: 0.0 * t)
    assert max(np.abs(beat[name]).max() for name in beat if name.endswith(".Q")) < 1e-17  # of 5e-5 m³/s
    assert max(np.abs(beat[name] - P_0).max() for name in beat if name.endswith(".P")) <= 1e-12 * max(
        abs(P_0), 1e3
    )  # wall stiffness: 1e5 Pa
    assert max(np.ptp(beat[name]) for name in beat if name.endswith(".R")) <= 1e-17


def test_rest_of_a_windkessel_network(sheep: Network) -> None:
    """With P_ref, RCR outlets and P_C at P_0 = P_venous nothing moves either."""
    outlets = tuple(Windkessel(o.segment, 1e7, 1e-9, 1e9, P_venous=12e3) for o in sheep.outlets)
    beat = simulate(replace(sheep, outlets=outlets, P_ref=11e3, P_0=12e3), lambda t: 0.0 * t)
    assert max(np.abs(beat[name]).max() for name in beat if name.endswith(".Q")) < 1e-16


@pytest.mark.parametrize("beats", [4, pytest.param(20, marks=pytest.mark.endurance)])
@pytest.mark.parametrize("wall", ["viscous", "elastic"])
def test_mass_over_many_beats(sheep: Network, wall: str, beats: int) -> None:
    """d/dt ∫A dx = Q_in - ΣQ_out by the scheme's quadrature in time, of the volume: 1.6e-15 measured in 4 beats, 1e-14
    in 20."""
    parameters = None if wall == "viscous" else {f"{s.name}.phi0": 0.0 for s in sheep.segments}
    assert _imbalance(build(sheep, parameters), beats * 250, 2e-3) <= (5e-14 if beats == 20 else 5e-15)


@pytest.mark.parametrize("parents", [fork, comb])
def test_mass_of_a_large_tree(parents: Callable[[int], list[int]]) -> None:
    """The same of 400 arteries, whose nodes are eliminated in rounds, over 50 steps (3e-16 and 9e-16 measured)."""
    assert _imbalance(build(tree(400, parents)), 50, 2e-3) <= 5e-15


def _imbalance(model: Model, n: int, dt: float) -> float:
    """What the arteries lose in n steps of the network's own inflow, at most, relative to their volume."""
    state = initial_state(model)
    start = expected = _volume(model, state)
    worst = 0.0
    for i in range(n):
        inflow = model.network.inlet.Q((i + INFLOW_TIMES) * dt)
        entering = INFLOW_AT_STAGES @ inflow
        before, state = state, step(model, state, dt, inflow)
        stages = [before.Q + dt * np.tensordot(SDIRK3[j], state.rates, 1) for j in range(3)]
        outflow = np.array([Q[0, model.mesh.outlet_element, -1].sum() for Q in stages])
        expected += dt * SDIRK3[-1] @ (entering - outflow)
        worst = max(worst, abs(_volume(model, state) - expected))
    return worst / start


def _volume(model: Model, state: State) -> float:
    weights = model.mesh.element.w_gauss / -model.minus_J_inverse
    return float(np.sum(state.A * weights))
