"""The bundled human network: the published numbers that it rests on, and that it is at 120/80 mmHg."""

from __future__ import annotations

import numpy as np
import pytest

from solver import Windkessel, load, simulate_periodic
from solver.laws.effect import small_wave_impedance
from solver.quantities.units import MMHG

# Wang, Fullana & Lagrée (2015), of the 55 arteries: L [cm], A0 [cm²], beta [Pa/cm], C_v [cm²/s]
TABLE = {
    "AsA": (4.0, 6.789, 23e3, 3520),
    "Ar1": (2.0, 5.011, 24e3, 3170),
    "BT": (3.4, 1.535, 49e3, 3630),
    "Ar2": (3.9, 4.486, 24e3, 3060),
    "LC": (20.8, 0.536, 111e3, 4840),
    "LS": (3.4, 0.706, 88e3, 4420),
    "TA1": (5.2, 3.941, 26e3, 3120),
    "TA2": (10.4, 3.604, 26e3, 2960),
    "CeA": (2.0, 1.086, 56e3, 3460),
    "AB1": (5.3, 2.659, 32e3, 3110),
    "SMA": (5.9, 0.782, 83e3, 4390),
    "RR": (3.2, 0.385, 130e3, 4810),
    "LR": (3.2, 0.385, 130e3, 4810),
    "AB2": (10.6, 1.389, 51e3, 3580),
    "RI": (5.8, 0.694, 82e3, 4050),
    "LI": (5.9, 0.694, 82e3, 4050),
}
SHARES = {"BT": 16, "LC": 8, "LS": 8, "CeA": 13, "SMA": 14, "RR": 10, "LR": 10, "RI": 10.5, "LI": 10.5}  # %


def test_published_numbers() -> None:
    """β = √π E h/((1-η²) A0), C_v = √π φ0 h/(2 (1-η²) √A0 ρ): L exact, A0 to 0.03 %, β to 1.5 %, C_v to 0.2 %."""
    human = load("human")
    assert [s.name for s in human.segments] == list(TABLE)
    plate = 1.0 - human.eta**2
    for s in human.segments:
        L, A0, beta, C_v = TABLE[s.name]
        area = np.pi * s.R0**2
        assert pytest.approx(L * 1e-2, rel=1e-15) == s.L
        assert area == pytest.approx(A0 * 1e-4, rel=3e-4)
        assert np.sqrt(np.pi) * s.E * s.h / (plate * area) == pytest.approx(beta * 1e2, rel=0.015)
        viscosity = np.sqrt(np.pi) * s.phi0 * s.h / (2.0 * plate * np.sqrt(area) * human.fluid.rho)
        assert viscosity == pytest.approx(C_v * 1e-4, rel=2e-3)
    assert "10.1080/10255842.2014.948428" in human.reference


def test_resistances_that_reflect_little() -> None:
    """R1 is the characteristic impedance ρ c0/A0 of the artery, to its two digits: 4 %."""
    human = load("human")
    for outlet in human.outlets:
        assert isinstance(outlet, Windkessel)
        assert outlet.R1 == pytest.approx(small_wave_impedance(human, human.segment(outlet.segment)), rel=0.04)


def test_pressure_and_flows() -> None:
    """118.7/82.5 mmHg in the ascending aorta, a larger pulse downstream; the flow splits as it should, to 0.1 %.

    Case: half-sine of 5 L/min at 67 beats a minute, beats to 1e-3.
    """
    human = load("human")
    beat = simulate_periodic(human, tolerance=1e-3)
    P = beat["AsA.P"] / MMHG
    assert (P.max(), P.min()) == pytest.approx((118.7, 82.5), abs=0.3)
    assert np.ptp(beat["LI.P"]) > 1.15 * np.ptp(beat["AsA.P"])
    mean = beat["inlet.Q"][:-1].mean()
    assert mean * 6e4 == pytest.approx(5.0, rel=2e-3)  # L/min
    for name, share in SHARES.items():
        assert 100.0 * beat[f"{name}.outlet.Q"][:-1].mean() / mean == pytest.approx(share, abs=0.1)
