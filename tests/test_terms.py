"""Terms of the model: off means absent to the last bit, on means what the equation says; batches equal single runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fmus import mixed

from solver import Network, Settings, simulate
from solver.scheme import terms
from solver.scheme.model import build
from solver.scheme.stage import Stage, operators
from solver.scheme.step import initial_state

QUICK = Settings(dt=2e-3, tolerance=1e-8)


@pytest.mark.parametrize(
    ("name", "value"), [("CA.phiNL", -2e4), ("CA.ENL", 4e4), ("fluid.nu", 3.5e-6), ("CA.phi0", 7e4)]
)
@pytest.mark.parametrize("viscous_law", ["quadratic", "monotone"])
def test_term_off_is_bit_identical(sheep: Network, name: str, value: float, viscous_law: str) -> None:
    """A member whose coefficient is 0 does not notice that the term is switched on in its neighbour."""
    network = replace(sheep, viscous_law=viscous_law)
    absent = simulate(network, duration=0.1, parameters={name: np.array([0.0, 0.0])}, settings=QUICK)
    beside = simulate(network, duration=0.1, parameters={name: np.array([0.0, value])}, settings=QUICK)
    for channel in absent:
        if channel != "inlet.Q":
            assert np.array_equal(absent[channel][0], beside[channel][0]), channel
    assert not np.array_equal(beside["CA.P"][0], beside["CA.P"][1])


def test_batch_equals_single_runs(sheep: Network) -> None:
    """Members of a batch are what they are alone, to 1e-12: geometry, wall, fluid and outlet parameters.

    One mesh serves the batch, made for the longest of each segment: lengths that need as many elements are compared.
    """
    batch = {
        "CA.E": np.array([4e6, 4.2e6, 3e6]),
        "AA.L": np.array([0.04, 0.045, 0.03]),
        "fluid.rho": np.array([1060.0, 1000.0, 1100.0]),
        "FA.outlet.R_t": np.array([0.3, -0.3, 0.8]),
        "BT.phi0": np.array([0.0, 1e4, 2e4]),
    }
    together = simulate(sheep, duration=0.3, parameters=batch, settings=QUICK)
    for i in range(3):
        alone = simulate(sheep, duration=0.3, parameters={n: v[i] for n, v in batch.items()}, settings=QUICK)
        for name in alone:
            value = together.member(i)[name]
            assert np.abs(value - alone[name]).max() <= 1e-12 * np.abs(alone[name]).max(), name


def test_members_do_not_notice_a_struggling_neighbour(sheep: Network) -> None:
    """At 25 times the inflow a softer neighbour needs fresh Jacobians and restarts: member 0 stays itself to 1e-12."""

    def inflow(t: np.ndarray) -> np.ndarray:
        return 25 * sheep.inlet.Q(t)

    alone = simulate(sheep, inflow, 0.12)
    beside = simulate(sheep, inflow, 0.12, parameters={"VA2.E": np.array([0.237e6, 0.2e6])})
    for name in alone:
        if name != "inlet.Q":
            assert np.abs(beside[name][0] - alone[name]).max() <= 1e-12 * np.abs(alone[name]).max(), name


def test_parameters_equal_a_changed_network(sheep: Network) -> None:
    """simulate(parameters=...) is the run of network.with_parameters(...), bit for bit."""
    values = {"CA.phi0": 1e4, "network.P_0": 300.0, "CA.outlet.R_t": 0.1, "fluid.alpha": 1.1, "AA.h": 4e-4}
    one = simulate(sheep, duration=0.1, parameters=values, settings=QUICK)
    two = simulate(sheep.with_parameters(values), duration=0.1, settings=QUICK)
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_monotone_meets_quadratic(sheep: Network) -> None:
    """Both nonlinear viscosities agree to second order in the rate: their difference falls by 8 ± 1.5 when r is halved
    twice as fast as φ_NL, that is in proportion to r²."""
    ratio = {"AA": -0.915, "PD": -0.999, "MD": -0.888, "DD": -0.975, "BT": -1.380, "CA": 0.524, "FA": -0.395}

    def difference(scale: float) -> float:
        values = {f"{name}.phiNL": scale * r * sheep.segment(name).phi0 for name, r in ratio.items()}
        runs = [
            simulate(replace(sheep, viscous_law=law), duration=0.2, parameters=values, settings=QUICK)["AA.P"]
            for law in ("quadratic", "monotone")
        ]
        return float(np.abs(runs[0] - runs[1]).max())

    assert difference(0.5) / difference(0.25) == pytest.approx(4.0, rel=0.1)


def test_elastic_laws_differ_by_the_stretch(sheep: Network) -> None:
    """The two elastic laws differ by R0/R, 0.4–0.8 % here: peak pressures differ by a like amount, waves stay alike."""
    beta, regression = (
        simulate(replace(sheep, elastic_law=law), duration=0.5)["MD.P"] for law in ("beta", "regression")
    )
    relative = np.linalg.norm(beta - regression) / np.linalg.norm(beta)
    assert 2e-3 <= relative <= 2e-2


def test_total_pressure_is_a_junction_of_its_own(sheep: Network) -> None:
    """k = 1 instead of 0 changes the pressures by the order of ρU²/2 (20 Pa), not by more."""
    total = replace(sheep, junctions=tuple(replace(j, k=1.0) for j in sheep.junctions))
    difference = np.abs(simulate(total)["PD.P"] - simulate(sheep)["PD.P"]).max()
    assert 1.0 <= difference <= 60.0


@pytest.mark.parametrize(("name", "value"), [("CA.E", 4.142e6), ("AA.phi0", 25451.0)])
def test_gradients_by_finite_differences(sheep: Network, name: str, value: float) -> None:
    """Central differences of Q at CA over relative steps 1e-2 to 1e-6 in one batch: alike to 1e-4 (6e-5 measured)."""
    steps = 10.0 ** -np.arange(2.0, 7.0)
    both = value * np.concatenate([1.0 + steps, 1.0 - steps])
    Q = simulate(sheep, parameters={name: both})["CA.Q"]
    gradients = (Q[:5] - Q[5:]) / (2.0 * steps[:, None])
    for gradient in gradients:
        assert np.linalg.norm(gradient - gradients[2]) <= 1e-4 * np.linalg.norm(gradients[2])


def test_jacobian_of_an_element(sheep: Network) -> None:
    """The derivative of the momentum that is left over, by each flow of its element: to 1e-9 of the largest (7e-11
    measured, central differences). Case: every kind of outlet, junctions that keep half of the dynamic pressure,
    viscous walls that are nonlinear, flows of ±20 mL/s."""
    network = replace(mixed(), junctions=tuple(replace(j, k=0.5) for j in mixed().junctions))
    model = build(network.with_parameters({f"{s.name}.phiNL": -1e3 for s in sheep.segments}), settings=QUICK)
    state, o = initial_state(model), operators(model, QUICK.dt)
    start = Stage.of(model, o, state.y, 0.0 * model.inlets.gain, model.coefficients.P_venous, 0.0).start
    Q = 2e-5 * np.random.default_rng(5).uniform(-1.0, 1.0, state.Q.shape)
    found = terms.jacobian(start, terms.flow(start, Q))
    for j, change in enumerate(1e-9 * np.eye(Q.shape[-1])):
        slope = (terms.residual(start, Q + change, state.H) - terms.residual(start, Q - change, state.H)) / 2e-9
        np.testing.assert_allclose(found[..., j], slope, rtol=0.0, atol=1e-9 * np.abs(found).max())
    by_ends = terms.d_ends(start, terms.flow(start, Q), terms.change(start, terms.flow(start, Q)))
    assert np.abs(by_ends).max() > 1e-4 * np.abs(found).max()  # 7.5e-4: not lost beside the others
