"""Where the equations end: NonPhysicalState names segment, place, time and reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver import Network, NonPhysicalState, Settings, simulate


def test_supercritical_flow(sheep: Network) -> None:
    """50 times the inflow makes U > c in the softest branch: it stops there and says so. 30 times still runs."""
    with pytest.raises(
        NonPhysicalState, match=r"segment VA2 at x = [\d.]+ cm, t = [\d.]+ s: the flow is supercritical"
    ) as caught:
        simulate(sheep, lambda t: 50 * sheep.inlet.Q(t))
    assert caught.value.segment == "VA2"
    assert 0.0 < caught.value.t < 0.25
    assert np.isfinite(simulate(sheep, lambda t: 30 * sheep.inlet.Q(t))["VA2.P"]).all()


def test_collapse(sheep: Network) -> None:
    """Strong suction empties the vessel: A <= 0."""
    with pytest.raises(NonPhysicalState, match="AA .*(area fell|supercritical)"):
        simulate(sheep, lambda t: -40 * sheep.inlet.Q(t))


def test_negative_effective_viscosity(sheep: Network) -> None:
    """φ0 + 2 φ_NL ε̇ < 0 beyond ε̇ = 1/(2|r|): the paper's law stops and says so; the monotone goes on."""
    flow = sheep.inlet.Q
    stiff = {"BT.phiNL": -1.380 * sheep.segment("BT").phi0}
    quadratic, monotone = (replace(sheep.with_parameters(stiff), viscous_law=law) for law in ("quadratic", "monotone"))
    simulate(quadratic)  # at 55 mL/s the network stays inside (notes on the paper, slip 3)
    with pytest.raises(NonPhysicalState, match=r"BT .*effective wall viscosity .* at strain rate 0\.\d+ 1/s; use visc"):
        simulate(quadratic, lambda t: 4 * flow(t))
    assert np.isfinite(simulate(monotone, lambda t: 4 * flow(t))["BT.P"]).all()


def test_batch_member_is_named(sheep: Network) -> None:
    """The second of two parameter sets breaks down: the sentence says which."""
    with pytest.raises(NonPhysicalState, match="in parameter set 1 of the batch"):
        simulate(sheep, lambda t: 4 * sheep.inlet.Q(t), parameters={"AA.E": np.array([1.5e6, 3e3])})


def test_unreachable_start_pressure(sheep: Network) -> None:
    """The regression law carries at most E h/((1-η²) R0): a higher P_0 is refused before any step."""
    with pytest.raises(ValueError, match=r"network\.P_0: the wall of segment \w+ cannot carry"):
        simulate(replace(sheep, elastic_law="regression", P_0=9e4))


def test_no_convergence_is_said(sheep: Network) -> None:
    """A step far beyond reason at a violent inflow ends in a sentence, not in a hang or in NaN."""
    with pytest.raises(NonPhysicalState):
        simulate(sheep, lambda t: 1e-3 * np.sin(400 * t), settings=Settings(dt=0.05))
