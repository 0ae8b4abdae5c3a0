"""Fractional viscosity: its Maxwell elements against (iω)^a, in a table, on a loop, in waves, and in a search."""

from __future__ import annotations

import numpy as np
import pytest
from tubes import propagation

from solver import Fluid, Inlet, Network, Reflection, Segment, Settings, Site, simulate_periodic
from solver.laws.effects import BY_NAME
from solver.laws.springpot import RATES, REFERENCE, shares
from solver.loop import loop_pressure

L, R0, H, E, PHI0, RHO, NU, T = 0.4, 8e-3, 1e-3, 8e5, 1.2e4, 1060.0, 3.5e-6, 0.25
OMEGA, A0, K_H = 2.0 * np.pi / T, np.pi * R0**2, H / (0.75 * R0)
SHARE, ORDER = 0.4, 0.35


def response(a: float, omega: np.ndarray) -> np.ndarray:
    """Σ share/(1 + iωτ) of the elements of an order."""
    tau = np.append(1.0 / RATES, 0.0)
    found: np.ndarray = (shares(np.array(a)) / (1.0 + 1j * omega[:, None] * tau)).sum(axis=1)
    return found


def modulus(w: float, a: float) -> complex:
    """What multiplies φ0 iω ε: (1 - w) + w (iω/ω_r)^(a-1)."""
    return 1.0 - w + w * (1j * OMEGA / REFERENCE) ** (a - 1.0)


def tube() -> Network:
    sites = tuple(Site(f"x{i}", "tube", 0.25 * (i + 1)) for i in range(3))
    segment = Segment("tube", L, R0, H, E, PHI0)
    network = Network("tube", (segment,), Inlet("tube"), (), (Reflection("tube", 0.5),), sites, Fluid(RHO, NU))
    return network.with_terms({"tube.springpot": SHARE, "tube.springpot_order": ORDER})


@pytest.mark.parametrize("a", [0.05, 0.2, 0.3, 0.5, 0.7, 0.95, 1.0])
def test_elements(a: float) -> None:
    """Σ share/(1 + iωτ) against (iω/ω_r)^(a-1) from 0.5 to 60 Hz: 0.45 % (0.41 % at a = 0.05); at a = 1 a damper."""
    omega = 2.0 * np.pi * np.geomspace(0.5, 60.0, 200)
    error = np.abs(response(a, omega) / (1j * omega / REFERENCE) ** (a - 1.0) - 1.0).max()
    assert error <= (4.5e-3 if a < 1.0 else 1e-12)


def test_weights_are_smooth_and_positive() -> None:
    """Second differences of the weights fall as the step squared; from a = 0.1 to 0.9 every element takes up work."""
    bends = []
    for h in (2e-3, 1e-3):
        g = shares(np.array([0.4 - h, 0.4, 0.4 + h]))
        bends.append((g[:, 0] - 2.0 * g[:, 1] + g[:, 2]) / h**2)
    np.testing.assert_allclose(bends[0], bends[1], rtol=1e-3)
    assert (shares(np.linspace(0.1, 0.9, 33)) > 0.0).all()
    assert shares(np.full((2, 5), 0.3)).shape == (7, 2, 5)


def test_loop() -> None:
    """One harmonic of strain: P on the loop against the springpot itself, to 0.3 % of the viscous part (0.27 %)."""
    t = np.arange(64) * T / 64
    R = R0 * (1.0 + 0.02 * np.cos(OMEGA * t))
    stress = 0.02 * PHI0 * np.real(1j * OMEGA * modulus(SHARE, ORDER) * np.exp(1j * OMEGA * t))
    expected = K_H * (E * (R / R0 - 1.0) + R0 / R * stress)
    error = np.abs(loop_pressure(tube(), "tube", R, T) - expected).max()
    assert error <= 3e-3 * np.ptp(K_H * stress)


def test_waves() -> None:
    """γ of a tube: time against the frequency domain to 2e-6; against the springpot to 0.3 % of its departure from the
    damper alone."""
    network = tube()
    beat = simulate_periodic(
        network, lambda t: 1e-9 * np.sin(OMEGA * t), T, settings=Settings(tolerance=1e-8), tolerance=1e-8,
        max_beats=300, start="periodic",
    )  # fmt: skip
    P = [np.fft.rfft(beat[f"x{i}.P"][:-1])[1] for i in range(3)]
    measured = complex(np.arccosh((P[0] + P[2]) / (2.0 * P[1])) / (0.25 * L))
    gamma = propagation(network, np.array([OMEGA]))[0][0, 0]
    assert abs(measured / gamma - 1.0) <= 2e-6

    def exact(viscous: complex) -> complex:
        Z = RHO / A0 * (1j * OMEGA + 22.0 * np.pi * NU / A0)
        return complex(np.sqrt(Z * 1j * OMEGA / (K_H * (E + 1j * OMEGA * PHI0 * viscous) / (2.0 * A0))))

    assert abs(gamma - exact(modulus(SHARE, ORDER))) <= 3e-3 * abs(exact(1.0) - exact(modulus(SHARE, ORDER)))


def test_in_a_search(sheep: Network) -> None:
    """Two numbers, x = 0 where it is absent; its starts lie in their ranges, and everywhere it is one pair of them."""
    effect = BY_NAME["fractional_viscosity"]
    for place in ("CA", "all"):
        w, a = effect.coordinates(sheep, place)
        assert (w.nominal, w.low, a.nominal) == (0.0, 0.0, 0.3)
        assert all(
            c.low <= x <= c.high + 1e-9 for start in effect.search.starts for c, x in zip((w, a), start, strict=True)
        )
    elastic = sheep.with_parameters({"CA.phi0": 0.0})
    assert "CA" not in effect.where(elastic)
