"""The frequency-domain network against closed formulas of transmission-line theory that do not use its code.

Every test states the equation, the case and the error that is left; most errors are round-off. In all closed formulas
c0 = √(2Eh/(3ρR0)) (η = 1/2), Z0 = ρc0/A0, k = ω/c0, τ = φ0/E.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import jv, jvp
from tubes import OMEGA, RHO, VISCOUS, area, artery, impedance, inlet_impedance, line, propagation, speed, tube

from solver import transmission
from solver.laws.outlets import Pressure, Reflection, Resistance, Windkessel
from solver.linear import solve, waveforms

# --- one tube -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("matched", ["reflection", "resistance"])
def test_travelling_wave_keeps_its_shape(matched: str) -> None:
    """P(x, t) = Z0 Q_in(t - x/c0), Q(x, t) = Q_in(t - x/c0) in an elastic inviscid tube with a matched end.

    Case: rough (random) inflow with a mean, x/c0 a whole number of samples, so that harmonics up to and with the
    Nyquist one are tested, and several of them fit half-waves into the tube. Error: round-off, 1e-15.
    """
    s = artery()
    n, delay = 64, np.array([0, 2, 4, 8])
    outlet = {"reflection": Reflection("A", R_t=0.0), "resistance": Resistance("A", R=impedance(s))}[matched]
    network = tube(s, outlet, positions=tuple(delay / 8.0))
    Q = 1e-5 * np.random.default_rng(1).random(n)
    w = waveforms(network, Q, T=n / 8.0 * s.L / speed(s))
    for i, samples in enumerate(delay):
        late = np.roll(Q, samples)
        np.testing.assert_allclose(w[f"x{i}.Q"], late, rtol=0.0, atol=1e-14 * Q.max())
        np.testing.assert_allclose(w[f"x{i}.P"], impedance(s) * late, rtol=0.0, atol=1e-14 * impedance(s) * Q.max())
    np.testing.assert_allclose(w["inlet.P"], w["x0.P"], rtol=1e-14)
    np.testing.assert_array_equal(w["A.outlet.P"], w["x3.P"])
    np.testing.assert_array_equal(w["A.outlet.Q"], w["x3.Q"])


def test_closed_tube() -> None:
    """P(x)/Q_in = -i Z0 cos(k(L - x))/sin kL with R_t = 1; at x = 0 it is -i Z0 cot kL, which is 0 at the quarter wave.

    Case: elastic, inviscid, kL from 0.01 to 10 and exactly π/2. Error: round-off of kL, 6e-15 of Z0/sin kL.
    """
    s = artery()
    kL = np.array([0.01, 0.3, 1.0, np.pi / 2.0, 2.0, 3.0, 4.0, 10.0])
    h = solve(tube(s, Reflection("A", R_t=1.0)), np.ones(len(kL)), kL * speed(s) / s.L)
    size = impedance(s) / np.abs(np.sin(kL))
    assert np.all(np.abs(h.P_node[0] + 1j * impedance(s) / np.tan(kL)) < 3e-14 * size)
    assert np.all(np.abs(h.P_site[0] + 1j * impedance(s) * np.cos(kL / 2) / np.sin(kL)) < 3e-14 * size)
    assert np.all(np.abs(h.Q_outlet[0]) < 3e-14 / np.abs(np.sin(kL)))


@pytest.mark.parametrize("R_t", [-0.5, 0.0, 0.3, 0.9])
def test_reflection_coefficient(R_t: float) -> None:
    """Backward over forward pressure wave at the outlet, (P - Z0 Q)/(P + Z0 Q) = R_t.

    Case: elastic tube with an inviscid fluid. Error: round-off, 2e-16.
    """
    s = artery()
    h = solve(tube(s, Reflection("A", R_t=R_t)), np.ones(len(OMEGA)), OMEGA)
    P, Q = h.P_node[1], h.Q_outlet[0]
    np.testing.assert_allclose((P - impedance(s) * Q) / (P + impedance(s) * Q), R_t, rtol=0.0, atol=3e-15)


def test_dispersion_relation() -> None:
    """γ = (iω/c0)/√(1 + iωτ): phase velocity c0/(1 - 3/8 ω²τ²), attenuation (ω²τ/2c0)(1 - 5/8 ω²τ²) for small ωτ.

    Case: Kelvin-Voigt wall with inviscid fluid. Errors: 4e-16 to the relation; 35/128 and 63/128 (ωτ)⁴ to the
    expansions, checked at ωτ = 0.1 and 0.05.
    """
    s = artery(phi0=1.2e4)
    tau = s.phi0 / s.E
    network = tube(s, Reflection("A", R_t=0.0))
    gamma, Z_c = propagation(network, OMEGA)
    np.testing.assert_allclose(gamma[0], 1j * OMEGA / speed(s) / np.sqrt(1.0 + 1j * OMEGA * tau), rtol=3e-15)
    np.testing.assert_allclose(Z_c[0], impedance(s) * np.sqrt(1.0 + 1j * OMEGA * tau), rtol=3e-15)

    x = np.array([0.1, 0.05])
    omega = x / tau
    gamma = propagation(network, omega)[0][0]
    velocity = omega / gamma.imag * (1.0 - 3.0 / 8.0 * x**2) / speed(s)
    attenuation = gamma.real / (omega**2 * tau / (2.0 * speed(s)) * (1.0 - 5.0 / 8.0 * x**2))
    np.testing.assert_allclose((velocity - 1.0) / x**4, -35.0 / 128.0, rtol=0.01)
    np.testing.assert_allclose((attenuation - 1.0) / x**4, 63.0 / 128.0, rtol=0.01)


def test_waves_decay_as_the_dispersion_relation_says() -> None:
    """P(x) = Z_c Q_in e^{-γx}, Q(x) = Q_in e^{-γx}: no wave returns from the end of a long damped tube.

    Case: 10 m of Kelvin-Voigt wall with friction, 10 Hz to 10 kHz, Re γL from 30 to 2000, where cosh γL overflows.
    Error: round-off times |γL|, 1.3e-13.
    """
    s = artery(L=10.0, phi0=1.2e4)
    omega = 2.0 * np.pi * np.array([10.0, 100.0, 1e3, 1e4])
    positions = (0.0, 0.002, 0.01)
    h = solve(tube(s, Reflection("A", R_t=0.3), VISCOUS, positions), np.ones(4), omega)
    gamma, Z_c = line(s, omega)
    assert gamma[0].real * s.L > 30.0 and gamma[-1].real * s.L > 1000.0
    for i, position in enumerate(positions):
        wave = np.exp(-gamma * position * s.L)
        np.testing.assert_allclose(h.Q_site[i], wave, rtol=2e-13)
        np.testing.assert_allclose(h.P_site[i], Z_c * wave, rtol=2e-13)


LOADS = {
    "windkessel": (Windkessel("A", R1=2e7, C=1e-9, R2=1e8), lambda w: 2e7 + 1e8 / (1.0 + 1j * w * 1e-9 * 1e8)),
    "resistance": (Resistance("A", R=3e7), lambda w: 3e7 + 0j * w),
    "pressure": (Pressure("A", P_venous=500.0), lambda w: 0j * w),
}


@pytest.mark.parametrize("load", LOADS)
def test_load_seen_through_a_tube(load: str) -> None:
    """Z_in = Z_c (Z_L + Z_c tanh γL)/(Z_c + Z_L tanh γL), with Z_L = R1 + R2/(1 + iωC R2) for the Windkessel.

    Case: viscous fluid, Kelvin-Voigt wall. Error: round-off, 6e-16.
    """
    s = artery(phi0=1.2e4)
    outlet, Z_load = LOADS[load]
    gamma, Z_c = line(s)
    t, Z_L = np.tanh(gamma * s.L), Z_load(OMEGA)
    expected = Z_c * (Z_L + Z_c * t) / (Z_c + Z_L * t)
    np.testing.assert_allclose(inlet_impedance(tube(s, outlet, VISCOUS)), expected, rtol=1e-14)


@pytest.mark.parametrize("load", LOADS)
def test_load_behind_almost_nothing(load: str) -> None:
    """Z_in -> Z_L as L -> 0. Case: 0.1 mm. Error: the tube's own impedance |γL| (|Z_c| + |Z_L|²/|Z_c|), below 0.2 %."""
    s = artery(L=1e-4)
    outlet, Z_load = LOADS[load]
    omega = OMEGA[:3]
    gamma, Z_c = line(s, omega)
    error = np.abs(inlet_impedance(tube(s, outlet, VISCOUS), omega) - Z_load(omega))
    bound = np.abs(gamma * s.L) * (np.abs(Z_c) + np.abs(Z_load(omega)) ** 2 / np.abs(Z_c))
    assert np.all(error < 1.01 * bound)
    assert np.all(bound < 2e-3 * np.maximum(np.abs(Z_load(omega)), np.abs(Z_c)))


def test_slope_of_pressure_and_flow_along_a_tube() -> None:
    """dP/dx = -(ρ/A0)(iω + C_f/A0) Q, dQ/dx = -iω P/(∂P/∂A + iω ∂P/∂A_t), P = K (√(A/A0) - 1) + ...: K = 4Eh/(3R0).

    Case: five sites 2 mm apart, fourth-order differences of the site values. Error: (dx|γ|)⁴/30 of the slope, 1e-7.
    """
    s = artery(phi0=1.2e4)
    dx = 2e-3
    positions = tuple(0.37 + dx / s.L * np.arange(-2, 3))
    h = solve(tube(s, Reflection("A", R_t=0.3), VISCOUS, positions), np.ones(len(OMEGA)), OMEGA)
    weights = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * dx)
    A0, K = area(s), 4.0 * s.E * s.h / (3.0 * s.R0)
    series = RHO / A0 * (1j * OMEGA + 22.0 * np.pi * VISCOUS.nu / A0)
    shunt = 1j * OMEGA * 2.0 * A0 / (K * (1.0 + 1j * OMEGA * s.phi0 / s.E))
    np.testing.assert_allclose(weights @ h.P_site, -series * h.Q_site[2], rtol=2e-7)
    np.testing.assert_allclose(weights @ h.Q_site, -shunt * h.P_site[2], rtol=2e-7)


def test_radius() -> None:
    """R = R0 (1 + P/K), K = Eh/((1-η²) R0), for a static pressure: the β-law is linear in the radius, so this is exact.

    And (1 + iωτ) K R'/R0 = P' for the harmonics. Error: round-off, 4e-16.
    """
    s = artery(phi0=1.2e4)
    network = tube(s, Pressure("A", P_venous=3e3), positions=(0.0, 1.0))
    K = s.E * s.h / (0.75 * s.R0)
    np.testing.assert_allclose(waveforms(network, np.zeros(4), 1.0)["x1.R"], s.R0 * (1.0 + 3e3 / K), rtol=3e-15)
    h = solve(network, np.ones(len(OMEGA)), OMEGA)
    np.testing.assert_allclose((1.0 + 1j * OMEGA * s.phi0 / s.E) * K * h.R_site / s.R0, h.P_site, rtol=5e-15)


# --- walls that vary ----------------------------------------------------------------------------------------------


def narrowing(taper: float, R: float, x: float) -> tuple[np.ndarray, np.ndarray]:
    """P/Q_in and Q/Q_in at x/L of an elastic inviscid tube with u = R/R0 = 1 + taper (x/L - 1/2) before a resistance R.

    With h and E constant, (u² P')' + κ² u³ P = 0 for κ = ω L/(c0 |taper|): P = u^(-1/2) J_±1/3(2/3 κ u^(3/2)).
    """
    s = artery()
    kappa = OMEGA * s.L / (speed(s) * abs(taper))

    def waves(x: float) -> tuple[np.ndarray, np.ndarray]:
        u = 1.0 + taper * (x - 0.5)
        z = 2.0 / 3.0 * kappa * u**1.5
        P = np.array([jv(nu, z) for nu in (1 / 3, -1 / 3)]) / u**0.5
        slope = np.array([jvp(nu, z) for nu in (1 / 3, -1 / 3)]) * kappa - 0.5 * P / u
        return P, -area(s) * u**2 / (1j * OMEGA * RHO) * slope * taper / s.L

    (_, Q_start), (P_end, Q_end), (P, Q) = waves(0.0), waves(1.0), waves(x)
    M = np.moveaxis(np.array([Q_start, P_end - R * Q_end]), -1, 0)
    a = np.linalg.solve(M, np.tile([[1.0 + 0j], [0.0]], (len(OMEGA), 1, 1)))[..., 0].T
    return (a * P).sum(axis=0), (a * Q).sum(axis=0)


@pytest.mark.parametrize("taper", [-0.4, 0.5])
def test_a_tube_that_narrows_or_widens(taper: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """P and Q at both ends and a quarter along, by Bessel functions of order 1/3.

    Case: elastic, inviscid, 0.5 to 60 Hz, where the tube holds up to two wave lengths. Error of 4 pieces either way:
    6e-8, 3e-7, 1.3e-5, 4.4e-4 and 1.8e-2 of the local value; it falls with the fourth power of their length, to a
    sixteenth with 8.
    """
    places = (0.0, 0.25, 1.0)
    network = tube(replace(artery(), terms={"taper": taper}), Resistance("A", R=3e7), positions=places)
    exact = np.array([narrowing(taper, 3e7, x) for x in places])

    def errors() -> np.ndarray:
        found = solve(network, np.ones(len(OMEGA)), OMEGA)
        np.testing.assert_allclose(found.P_node[:2], found.P_site[[0, 2]], rtol=1e-14)
        return np.abs(np.stack([found.P_site, found.Q_site], axis=1) / exact - 1.0).max(axis=(0, 1))

    with_4 = errors()
    assert np.all(with_4 < [6e-8, 3.8e-7, 1.4e-5, 4.8e-4, 2e-2])
    monkeypatch.setattr(transmission, "_PIECES", 8)
    np.testing.assert_allclose(errors() / with_4, 1 / 16, rtol=0.2)
