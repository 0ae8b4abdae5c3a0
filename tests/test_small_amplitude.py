"""The nonlinear solver at small amplitude against the analytic frequency-domain network."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from compare import relative_error

from solver import Network, Pressure, Reflection, Resistance, Settings, Windkessel, simulate_periodic
from solver.linear import waveforms

T = 0.5


def inflow(t: np.ndarray) -> np.ndarray:
    """A smooth inflow of 1e-9 m³/s: U/c and strain are 1e-6."""
    w = 2.0 * np.pi / T
    return 1e-9 * (1.0 - np.cos(2 * w * t) + 0.5 * np.sin(4 * w * t) + 0.2 * np.cos(10 * w * t))


def _errors(network: Network, settings: Settings, P_0: float = 0.0) -> dict[str, float]:
    beat = simulate_periodic(network, inflow, T, settings=settings, tolerance=1e-7, start="periodic")
    exact = waveforms(network, inflow(beat.time[:-1]), T)
    return {name: relative_error(name, beat[name][:-1], exact[name]) for name in exact}


def test_sheep(sheep: Network) -> None:
    """Inlet, ten sites and five outlets, P, Q, R, viscoelastic: <= 2e-5 at the default step (1.6e-5 measured)."""
    errors = _errors(sheep, Settings(tolerance=1e-7))
    assert max(errors.values()) <= 2e-5, errors


def test_error_falls_with_the_step(sheep: Network) -> None:
    """At half the step the error is smaller by 4 or more where the pressure is a multiplier (order 2), else by 8."""
    coarse, fine = (_errors(sheep, Settings(dt=dt, tolerance=1e-8)) for dt in (2e-3, 1e-3))
    assert 3.0 <= coarse["inlet.P"] / fine["inlet.P"] <= 9.0
    assert 5.0 <= coarse["AA.P"] / fine["AA.P"] <= 11.0


OUTLETS = {
    "windkessel": lambda segment: Windkessel(segment, 1e8, 2e-10, 1e9),
    "resistance": lambda segment: Resistance(segment, 3e8),
    "closed end": lambda segment: Reflection(segment, 1.0) if segment == "CA" else Reflection(segment, 0.3),
    "prescribed pressure": lambda segment: Pressure(segment) if segment == "CA" else Reflection(segment, 0.3),
}


@pytest.mark.parametrize(
    "kind",
    [
        "windkessel",
        "closed end",
        *(pytest.param(k, marks=pytest.mark.slow) for k in ("resistance", "prescribed pressure")),
    ],
)
def test_outlets(sheep: Network, kind: str) -> None:
    """Every kind of outlet against its impedance: <= 3e-5 at the default step."""
    errors = _errors(
        replace(sheep, outlets=tuple(OUTLETS[kind](o.segment) for o in sheep.outlets)), Settings(tolerance=1e-7)
    )
    silent = {"closed end": "CA.outlet.Q", "prescribed pressure": "CA.outlet.P"}.get(kind)
    assert max(error for name, error in errors.items() if name != silent) <= 3e-5, errors


def test_total_pressure_at_junctions(sheep: Network) -> None:
    """P + ρU²/2 equals P to first order: k = 1 has the same linear limit, <= 3e-5."""
    errors = _errors(
        replace(sheep, junctions=tuple(replace(j, k=1.0) for j in sheep.junctions)), Settings(tolerance=1e-7)
    )
    assert max(errors.values()) <= 3e-5, errors


def test_physiological_mean_pressure(sheep: Network) -> None:
    """R0 at P_ref = 11 kPa, rest at P_0 = 12 kPa above P_venous: linearised about the stretched wall, <= 3e-5."""
    outlets = tuple(Windkessel(o.segment, 1e8, 2e-10, 1e9, P_venous=12e3) for o in sheep.outlets)
    errors = _errors(replace(sheep, outlets=outlets, P_ref=11e3, P_0=12e3), Settings(tolerance=1e-7))
    assert max(errors.values()) <= 3e-5, errors
