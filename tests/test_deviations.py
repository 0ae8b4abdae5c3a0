"""What every artery may have of its own: its unknowns, the values that they give, and their intervals."""

from __future__ import annotations

import numpy as np
import pytest
from forked import NETWORK
from small_network import term

from fitting.inference.extended_network import estimates, extended
from fitting.inference.fit import Fit
from fitting.inference.hypothesis import PlacedEffect, about_common, candidates, deviations, nuisances
from fitting.inference.unknown import Unknown, interval, values
from solver import Network, load
from solver.quantities.coordinate import SCALE, SHIFT
from solver.quantities.quantity import Quantity

ELASTIC = NETWORK.with_parameters({f"{s}.phi0": 0.0 for s in "ABC"})
SPREADS = {"R0": 0.02, "E": 0.08, "phi0": 0.2, "R_t": 0.03}


def viscous() -> PlacedEffect:
    """Viscosity of all walls of an elastic network."""
    return next(t for t in candidates(ELASTIC, ()) if t.label == "wall_viscosity at all")


# --- names, groups and spreads ----------------------------------------------------------------------------------------


def test_deviations_of_a_network() -> None:
    """R0, E and φ0 of every artery, R_t of every outlet: one unknown and one variable each, a group a quantity, x = 1
    its spread. Thickness has none."""
    found = deviations(NETWORK)
    paths = [f"{s}.{key}" for s in "ABC" for key in ("R0", "E", "phi0")] + ["B.outlet.R_t", "C.outlet.R_t"]
    assert [u.name for u in found] == [f"{path} of its own" for path in paths]
    for unknown, path in zip(found, paths, strict=True):
        key = path.rpartition(".")[2]
        assert unknown.moves == ((path, SPREADS[key]),) and unknown.group == key and unknown.prior_sd == 1.0
        assert unknown.kind == (SHIFT if key == "R_t" else SCALE) and not unknown.of_size


def test_what_is_counted_relative_to_it_goes_with_it() -> None:
    """With nonlinear walls φNL keeps its ratio to φ0; a wall without viscosity has no deviation of it."""
    moves = {u.name: u.variables for u in deviations(load("sheep_nonlinear"))}
    assert moves["CA.phi0 of its own"] == ("CA.phi0", "CA.phiNL")
    assert not any(u.group == "phi0" for u in deviations(ELASTIC))


def test_deviations_reach_the_ends_of_a_range() -> None:
    """The reflection coefficient stays 1e-3 off -0.999 and 1."""
    B = next(u for u in deviations(NETWORK) if u.name.startswith("B.outlet"))
    ends = [0.4 + SPREADS["R_t"] * x for x in (B.low, B.high)]
    assert ends == pytest.approx([-0.998, 0.999], abs=1e-12)


def test_about_what_is_common() -> None:
    """φ0/E of 0.5 typical sizes everywhere, and a spread of 20 % of that in every artery, of a group, not negative."""
    found = about_common(ELASTIC, viscous(), (0.5,))
    assert found is not None and found.label == "wall_viscosity at every segment"
    common, *own = found.unknowns
    assert common == viscous().unknowns[0]
    assert [u.name for u in own] == [f"{s}.phi0 of its own" for s in "ABC"]
    for unknown, (variable, step) in zip(own, common.moves, strict=True):
        ((moved, size),) = unknown.moves
        assert moved == variable and size == pytest.approx(0.2 * 0.5 * step)
        assert (unknown.group, unknown.ratio, unknown.prior_sd, unknown.of_size) == ("phi0", "E", 1.0, False)
        assert 0.5 * step + size * unknown.low == pytest.approx(0.0, abs=1e-9 * step)
    assert found.starts == ((0.5, 0.0, 0.0, 0.0),)


@pytest.mark.parametrize(
    ("asked", "x"), [(term("wall_stiffness", "B"), 0.5), (term("channel_gain", "A.P"), 0.5), (viscous(), 0.0)]
)
def test_nothing_to_differ(asked: PlacedEffect, x: float) -> None:
    """An effect of one place, a sensor, and one of no size have no sizes of their own."""
    assert about_common(ELASTIC, asked, (x,)) is None


# --- values and intervals ---------------------------------------------------------------------------------------------


def ratio_of(variable: str, modulus: str | None) -> Unknown:
    return Unknown(variable, SHIFT, ((variable, 100.0),), -9.0, 9.0, ratio=modulus)


def test_a_ratio_follows_its_modulus() -> None:
    """φ = φ0 e^(0.1 x3) + 100 x1 e^(0.2 x2), where E = E0 e^(0.2 x2) and φ0 is scaled by x3; without a ratio 100 x1."""
    scales = [Unknown(n, SCALE, ((n, s),), -9.0, 9.0) for n, s in (("A.E", 0.2), ("A.phi0", 0.1))]
    x = np.array([[0.0, 0.0, 0.0], [1.5, 2.0, -1.0]])
    nominal = {"A.E": 1e6, "A.phi0": 500.0}
    found = values([ratio_of("A.phi0", "E"), *scales], x, nominal)
    np.testing.assert_allclose(found["A.E"], [1e6, 1e6 * np.exp(0.4)], rtol=1e-14)
    np.testing.assert_allclose(found["A.phi0"], [500.0, 500.0 * np.exp(-0.1) + 150.0 * np.exp(0.4)], rtol=1e-14)
    alone = values([ratio_of("A.phi0", None), *scales], x, nominal)["A.phi0"]
    np.testing.assert_allclose(alone, [500.0, 500.0 * np.exp(-0.1) + 150.0], rtol=1e-14)


def test_an_interval_is_that_of_the_values() -> None:
    """The middle is :func:`values`, half of it 2 √(gᵀ C g) with its gradient by differences, to 1e-7."""
    scales = [Unknown(n, SCALE, ((n, s),), -9.0, 9.0) for n, s in (("A.E", 0.2), ("A.phi0", 0.1))]
    unknowns, x = [ratio_of("A.phi0", "E"), *scales], np.array([1.5, 2.0, -1.0])
    C = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, -0.3], [0.5, -0.3, 3.0]]) * 1e-3
    ahead, behind = (values(unknowns, x + s * 1e-5 * np.eye(3), {"A.phi0": 500.0})["A.phi0"] for s in (1, -1))
    gradient = (ahead - behind) / 2e-5
    told = interval(unknowns, "A.phi0", 500.0, Quantity("Pa.s", "viscosity", 0.0, 1e9), x, C, 2.0)
    assert told.value == pytest.approx(float(values(unknowns, x, {"A.phi0": 500.0})["A.phi0"]), rel=1e-14)
    half = 2.0 * np.sqrt(gradient @ C @ gradient)
    assert told.ci95 == pytest.approx((told.value - half, told.value + half), rel=1e-7)


def test_what_is_said_of_an_effect_that_differs_is_in_the_network() -> None:
    """φ0 of every segment beside E that is stiffer everywhere and once more in B: verdict and network file agree."""
    found = about_common(ELASTIC, viscous(), (0.5,))
    assert found is not None
    unknowns = (*nuisances(ELASTIC), *deviations(ELASTIC), *found.unknowns)
    at = {"all.E": 1.5, "B.E of its own": 1.0, "B.phi0 of its own": 0.5, "all.phi0": 0.5}
    x = np.array([at.get(u.name, 0.0) for u in unknowns])
    fit = Fit((found,), unknowns, x, np.zeros(len(x)), 100.0 * np.eye(len(x)), x, x)
    network: Network = extended(ELASTIC, fit)
    told = estimates(ELASTIC, fit, found, 2.0)
    assert set(told) == {f"{s}.phi0" for s in "ABC"}
    for name, estimate in told.items():
        assert estimate.value == pytest.approx(network.parameters()[name], rel=1e-12)
    assert told["B.phi0"].value == pytest.approx(0.017 * 0.5 * 1.1 * 9e5 * np.exp(0.3 + 0.08))
