"""Walls of the generator that no catalogue has, against an integrator of others and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from truth.anatomy import anatomy
from truth.beat import Beat, at_phase
from truth.bench import bench_wall, long_radius, radius
from truth.detect import detect
from truth.hide import ALL, Effect, hide
from truth.network import Balance
from truth.records import Case, make
from truth.shapes import arterial_pressure, ejection

from solver import Network

T = 0.5


@pytest.mark.parametrize(("name", "size"), [("strain_viscosity", 8.0), ("coulomb", 2e-3)])
def test_against_an_ode_solver(sheep: Network, name: str, size: float) -> None:
    """ε̇ of P(t) from the law by a root finder, integrated by Radau over a beat: <= 3e-4 of R's pulse with Coulomb's
    friction, whose corners 60 harmonics round off, and <= 1e-6 else."""
    beat = Beat(T, 60, 192)
    model = hide(anatomy(sheep), Effect(name, ALL, size))
    P = arterial_pressure(np.random.default_rng(2), beat)
    v = model.vessel("AA")
    K_h = v.h / (0.75 * v.R0)
    R = radius(bench_wall(model, "AA", beat), beat.values(P))

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        strain = s[0] - 1.0
        stress = (at_phase(P, np.array([t / T]))[0] - v.E * K_h * strain) * s[0] / K_h
        phi0 = v.phi0 * (1.0 + v.c * strain)
        return np.array([brentq(lambda x: phi0 * x + v.coulomb * np.tanh(x / 0.05) - stress, -50.0, 50.0, xtol=1e-13)])

    times = beat.phase[::8] * T
    run = solve_ivp(rate, (0.0, T), [R[0] / v.R0], "Radau", times, first_step=1e-5, rtol=1e-8, atol=1e-11)
    error = np.abs(run.y[0] * v.R0 - R[::8]).max() / np.ptp(R)
    assert error <= (3e-4 if name == "coulomb" else 1e-6)


@pytest.mark.parametrize(("name", "size", "most"), [("strain_viscosity", 8.0, 1e-8), ("coulomb", 3e-4, 2e-4)])
def test_networks_refine(sheep: Network, name: str, size: float, most: float) -> None:
    """110 harmonics in place of 80 change sites by a little of the pulse."""
    model = hide(anatomy(sheep), Effect(name, ALL, size))
    once, fine = Beat(T), Beat(T, 110, 352)
    flow = ejection(np.random.default_rng(4), once, sheep.inlet.Q_max)
    more = np.zeros(111, complex)
    more[:81] = flow
    a, b = Balance(model, once).solve(flow).channels, Balance(model, fine).solve(more).channels
    for site in ("AA.P", "CA.Q", "FA.R"):
        change = np.abs(at_phase(a[site], once.phase) - at_phase(b[site], once.phase)).max()
        assert change <= most * np.ptp(once.values(a[site])), site


def test_tone_of_an_elastic_wall(sheep: Network) -> None:
    """Without viscosity R at every moment is that of E then: to 1e-6 of the pulse."""
    model = anatomy(sheep)
    v = replace(model.vessel("CA"), phi0=0.0)
    model = hide(model.with_vessels(v), Effect("varying_tone", ALL, 0.05, 0.2))
    long = Beat(4 * T, 240, 768, T)
    P = arterial_pressure(np.random.default_rng(2), Beat(T, 60, 192))
    c = np.zeros(241, complex)
    c[::4] = P
    E = v.E * (1.0 + 0.05 * np.sin(2.0 * np.pi * (2.0 * long.phase + 0.2)))
    expected = v.R0 * (1.0 + long.values(c) * 0.75 * v.R0 / (E * v.h))
    R = long.values(long_radius(bench_wall(model, "CA", long), long.values(c)))
    assert np.abs(R - expected).max() <= 1e-6 * np.ptp(expected)


def test_a_record_whose_tone_wanders() -> None:
    """Nothing in a single beat, and seen over the record: in proportion to its size."""
    case = Case("bench", "CA", 40.0, (Effect("varying_tone", ("CA",), 0.02, 0.3),))
    made = make(case, 5)
    steady = make(replace(case, effects=()), 5)
    assert np.array_equal(made.clean["CA.R"], steady.clean["CA.R"])
    small, large = (detect(make(replace(case, effects=(Effect("varying_tone", ("CA",), x, 0.3),)), 5)).d_prime[0]
                    for x in (0.005, 0.02))  # fmt: skip
    assert large / small == pytest.approx(4.0, rel=0.05) and small > 10.0
