"""Where the equations end: NonPhysicalState names segment, place, time and reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver import Network, NonPhysicalState, simulate
from solver.scheme.model import build
from solver.scheme.step import initial_state, step


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
    """Sudden strong suction empties the ascending aorta, elastic here, within a step: A <= 0 there."""
    sentence = r"segment AA at x = [\d.]+ cm, .*: the area fell to zero or below; .*, or use shorter elements: "
    with pytest.raises(NonPhysicalState, match=sentence):
        simulate(sheep, lambda t: np.where(t > 0.0, -2e-2, 0.0), parameters={"AA.phi0": 0.0})


EITHER = (
    "(the wall at the outlet cannot carry|the step did not converge)"  # by round-off: not on all processors the same
)
BREAKDOWNS = {
    "outlet pressure": ({"FA.outlet.P_venous": 2e5}, "quadratic", "FA", "the wall at the outlet cannot carry"),
    "softening wall": ({"CA.ENL": -1e10}, "quadratic", "CA", "the wall at the outlet cannot carry"),
    "steep exponential": ({"CA.phiNL": -90 * 77082.0}, "monotone", "CA", EITHER),
    "steep parabola": ({"CA.phiNL": 90 * 77082.0}, "quadratic", "CA", "the effective wall viscosity"),
    "very negative slope": ({"BT.phiNL": -20 * 12048.0}, "quadratic", "BT", "the step did not converge"),
}


@pytest.mark.parametrize("case", BREAKDOWNS)
def test_breakdown_is_located(sheep: Network, case: str) -> None:
    """One segment is made impossible: the sentence names that segment, although NaN would spread to all at once."""
    values, law, segment, reason = BREAKDOWNS[case]
    with pytest.raises(NonPhysicalState, match=rf"^segment {segment} at .*: {reason}") as caught:
        simulate(replace(sheep, viscous_law=law), parameters=values)
    assert caught.value.segment == segment


def test_outlet_that_cannot_carry_the_start_pressure(sheep: Network) -> None:
    """Refused before any step, naming the outlet."""
    network = replace(sheep, elastic_law="regression")
    with pytest.raises(ValueError, match=r"VA2\.outlet\.P_venous: the wall at the outlet cannot carry P_0 - P_venous"):
        simulate(network, parameters={"VA2.outlet.P_venous": -1e5})


def test_negative_effective_viscosity(sheep: Network) -> None:
    """φ0 + 2 φ_NL ε̇ < 0 beyond ε̇ = 1/(2|r|): the paper's law stops and says so; the monotone goes on."""
    flow = sheep.inlet.Q
    stiff = {"BT.phiNL": -1.380 * sheep.segment("BT").phi0}
    quadratic, monotone = (replace(sheep.with_parameters(stiff), viscous_law=law) for law in ("quadratic", "monotone"))
    simulate(quadratic)  # at 55 mL/s the network stays inside (strain rates up to 0.2 /s in AA, turn at 0.55 /s)
    with pytest.raises(NonPhysicalState, match=r"BT .*viscosity turned negative: the strain rate passed 0\.362 1/s"):
        simulate(quadratic, lambda t: 4 * flow(t))
    assert np.isfinite(simulate(monotone, lambda t: 4 * flow(t))["BT.P"]).all()


def test_batch_member_is_named(sheep: Network) -> None:
    """The second of two parameter sets breaks down: the sentence says which."""
    with pytest.raises(NonPhysicalState, match="in parameter set 1 of the batch"):
        simulate(sheep, lambda t: 4 * sheep.inlet.Q(t), parameters={"AA.E": np.array([1.5e6, 3e3])})


def test_several_states_with_one_parameter_set(sheep: Network) -> None:
    """Three states are stepped side by side; that of the third breaks down: the sentence is that of it alone."""
    model = build(sheep)
    start, inflow = initial_state(model), np.full((4, 3), 1e-5) * [1.0, 1.0, 5e4]
    with pytest.raises(NonPhysicalState) as alone:
        step(model, start, 1e-3, inflow[:, 2])
    with pytest.raises(NonPhysicalState) as together:
        step(model, start.members(np.zeros(3, int)), 1e-3, inflow)
    assert str(together.value) == str(alone.value)


def test_unreachable_start_pressure(sheep: Network) -> None:
    """The regression law carries at most E h/((1-η²) R0): a higher P_0 is refused before any step."""
    with pytest.raises(ValueError, match=r"network\.P_0: the wall of segment \w+ cannot carry"):
        simulate(replace(sheep, elastic_law="regression", P_0=9e4))
