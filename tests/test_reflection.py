"""Pulses against impedances: reflection and transmission at a junction, reflection at an outlet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from solver import Fluid, Inlet, Junction, Network, Reflection, Segment, Settings, Site, simulate

RHO = 1060.0
WIDTH = 0.05  # duration of the pulse [s]
LONG = 1.5  # [m], five pulses
FINE = Settings(dt=5e-4, element_length=0.05, degree=4, tolerance=1e-8)


def pulse(t: np.ndarray) -> np.ndarray:
    """A smooth pulse of 1e-9 m³/s: linear, so that impedances are exact."""
    return 1e-9 * np.where((t > 0) & (t < WIDTH), np.sin(np.pi * t / WIDTH) ** 4, 0.0)


def speed(s: Segment) -> float:
    return float(np.sqrt(2.0 * s.E * s.h / (3.0 * RHO * s.R0)))


def admittance(s: Segment) -> float:
    return float(np.pi * s.R0**2 / (RHO * speed(s)))


def _network(segments: tuple[Segment, ...], junctions: tuple[Junction, ...], R_t: dict[str, float]) -> Network:
    outlets = tuple(Reflection(name, value) for name, value in R_t.items())
    sites = tuple(Site(f"{s.name}_mid", s.name) for s in segments)
    return Network("pulse", segments, Inlet(segments[0].name), junctions, outlets, sites, Fluid(RHO, nu=0.0))


def _peak(time: np.ndarray, P: np.ndarray, around: Callable[[np.ndarray], np.ndarray]) -> float:
    """Amplitude of the pulse shape in P where it is expected: a least-squares fit of one coefficient."""
    shape = around(time)
    return float(P @ shape / (shape @ shape))


@pytest.mark.parametrize(("R_1", "R_2"), [pytest.param(5e-3, 4e-3, marks=pytest.mark.slow), (9e-3, 3e-3), (2e-3, 2e-3)])
def test_junction(R_1: float, R_2: float) -> None:
    """Γ = (Y0 - Y1 - Y2)/(Y0 + Y1 + Y2), transmission 1 + Γ into both: to 2e-3, elastic and inviscid."""
    parent = Segment("parent", LONG, 8e-3, 1e-3, 5e5)
    one, two = Segment("one", LONG, R_1, 8e-4, 6e5), Segment("two", LONG, R_2, 7e-4, 7e5)
    network = _network((parent, one, two), (Junction(("parent",), ("one", "two")),), {"one": 0.0, "two": 0.0})
    Y = [admittance(s) for s in (parent, one, two)]
    expected = (Y[0] - Y[1] - Y[2]) / sum(Y)
    half = LONG / 2.0 / speed(parent)
    result = simulate(network, pulse, 3.6 * half, settings=FINE)
    P_in = 1e-9 / Y[0]
    back = _peak(result.time, result["parent_mid.P"], lambda t: pulse(t - 3.0 * half) / 1e-9)
    forth = _peak(result.time, result["one_mid.P"], lambda t: pulse(t - 2.0 * half - LONG / 2.0 / speed(one)) / 1e-9)
    assert back / P_in == pytest.approx(expected, abs=2e-3)
    assert forth / P_in == pytest.approx(1.0 + expected, abs=2e-3)


def test_outlet() -> None:
    """An elastic pulse comes back from the outlet with R_t times its pressure: to 2e-3, for four R_t in a batch."""
    tube = Segment("tube", LONG, 8e-3, 1e-3, 5e5)
    half, R_t = LONG / 2.0 / speed(tube), np.array([-0.5, 0.0, 0.3, 0.9])
    network = _network((tube,), (), {"tube": 0.0})
    result = simulate(network, pulse, 3.6 * half, parameters={"tube.outlet.R_t": R_t}, settings=FINE)
    for P, ratio in zip(result["tube_mid.P"], R_t, strict=True):
        back = _peak(result.time, P, lambda t: pulse(t - 3.0 * half) / 1e-9)
        assert back * admittance(tube) / 1e-9 == pytest.approx(ratio, abs=2e-3)


@pytest.mark.parametrize("law", ["beta", "regression"])
def test_no_reflection_of_a_large_simple_wave(law: str) -> None:
    """R_t = 0 lets a simple wave of finite amplitude (U/c = 0.03) leave: less than 1e-3 of it comes back."""
    tube = Segment("tube", 0.5, 8e-3, 1e-3, 5e5)
    network = replace(_network((tube,), (), {"tube": 0.0}), elastic_law=law)
    amplitude = 0.03 * speed(tube) * np.pi * tube.R0**2
    result = simulate(network, lambda t: amplitude * pulse(t) / 1e-9, 0.25, settings=FINE)
    late = result.time > 0.25 / speed(tube) + 1.5 * WIDTH
    assert np.abs(result["tube_mid.P"][late]).max() <= 1e-3 * result["tube_mid.P"].max()
