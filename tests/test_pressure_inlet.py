"""An inlet that is driven by a pressure: against the flow-driven network, linear theory, and its own order in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from compare import relative_error
from fmus import COARSE, mixed

from solver import Network, Reflection, Settings, linear, load, simulate, simulate_periodic
from solver.files import dumps, loads
from solver.scheme.model import build
from solver.start import periodic_state

Array = np.ndarray


def driven_by_pressure(network: Network) -> Network:
    return replace(network, inlet=replace(network.inlet, causality="pressure"))


def periodic(samples: Array, T: float) -> Callable[[Array], Array]:
    """The trigonometric interpolant of samples evenly spaced over a period."""
    c, omega = np.fft.rfft(samples, norm="forward"), 2.0 * np.pi / T * np.arange(len(samples) // 2 + 1)
    c[1:] *= 2.0
    return lambda t: (c * np.exp(1j * np.multiply.outer(t, omega))).real.sum(axis=-1)


def recovered(network: Network, dt: float) -> dict[str, float]:
    """The errors of all outputs where the inlet pressure of a smooth periodic flow drives the network in its place."""
    T, mean = network.inlet.T, network.inlet.Q_mean
    settings = Settings(dt=dt, element_length=0.1, tolerance=1e-7)

    def inflow(t: Array) -> Array:
        return mean * (1.0 - np.cos(2 * np.pi * t / T) + 0.5 * np.sin(4 * np.pi * t / T))

    by_flow = simulate_periodic(network, inflow, settings=settings, tolerance=1e-7, start="periodic")
    P = periodic(by_flow["inlet.P"][:-1], T)
    by_pressure = simulate_periodic(driven_by_pressure(network), P, settings=settings, tolerance=1e-7, start="periodic")
    assert by_pressure.units.keys() == by_flow.units.keys()
    assert list(by_pressure)[:2] == ["inlet.P", "inlet.Q"]
    pulsing = [name for name in by_flow if np.ptp(by_flow[name]) > 0.0]
    return {name: relative_error(name, by_pressure[name], by_flow[name]) for name in pulsing}


@pytest.mark.parametrize(
    "network", [lambda: load("sheep"), lambda: load("human"), mixed], ids=["sheep", "human", "mixed"]
)
def test_gives_the_flow_back(network: Callable[[], Network]) -> None:
    """Driven by the inlet.P of a flow-driven run it gives inlet.Q and everything else back: 1e-5 at steps of 2 ms."""
    errors = recovered(network(), 2e-3)
    assert errors["inlet.Q"] <= 8e-6
    assert max(errors.values()) <= 2e-5, errors


def test_order() -> None:
    """The error of inlet.Q falls by 8 or a little less at half the step (5.6 measured)."""
    coarse, fine = (recovered(load("sheep"), dt)["inlet.Q"] for dt in (2e-3, 1e-3))
    assert 5.0 <= coarse / fine <= 9.0


def test_small_amplitude() -> None:
    """P' of 1e-4 mmHg about P_0: inlet.Q and the sites are those of :mod:`solver.linear`, <= 1e-5 (6e-6 measured)."""
    sheep = driven_by_pressure(load("sheep"))
    T, w = 0.5, 4.0 * np.pi

    def pressure(t: Array) -> Array:
        return 1e-2 * (1.0 - np.cos(w * t) + 0.5 * np.sin(2 * w * t) + 0.2 * np.cos(5 * w * t))

    beat = simulate_periodic(sheep, pressure, T, settings=Settings(tolerance=1e-7), tolerance=1e-7, start="periodic")
    exact = linear.waveforms(sheep, pressure(beat.time[:-1]), T)
    assert "inlet.P" not in exact
    errors = {name: relative_error(name, beat[name][:-1], exact[name]) for name in exact}
    assert max(errors.values()) <= 1e-5, errors


def test_steady_pressure() -> None:
    """After a jump to 12 kPa the mixed network comes to rest: what flows in flows out, as in the steady state: 1e-6."""
    network = driven_by_pressure(mixed())
    run = simulate(network, lambda t: np.where(t < 0.1, 10e3, 12e3), 8.0, settings=COARSE)
    out = sum(run[f"{o.segment}.outlet.Q"][-1] for o in network.outlets)
    assert run["inlet.Q"][-1] == pytest.approx(out, rel=1e-6)
    model = build(network, settings=COARSE)
    steady = periodic_state(model, lambda t: 12e3 + 0.0 * t, 1.0)
    assert steady.Q[0, model.mesh.inlet_element, 0] == pytest.approx(run["inlet.Q"][-1], rel=1e-6)


def test_closed_network() -> None:
    """Between a given pressure and closed ends the mean is known: no mean flow, the pressure everywhere."""
    sheep = load("sheep")
    closed = tuple(Reflection(o.segment, R_t=1.0) for o in sheep.outlets)
    network = driven_by_pressure(replace(sheep, outlets=closed))
    h = linear.solve(network, np.array([500.0]), np.zeros(1))
    np.testing.assert_allclose(h.P_node[:, 0].real, 500.0, rtol=1e-12)
    assert abs(h.Q_inlet[0]) <= 1e-20


def test_file() -> None:
    """The key of the network file, there and back; another word is refused, and so is a run without a pressure."""
    network = driven_by_pressure(load("sheep"))
    assert loads(dumps(network), "pressure") == network
    assert network.channel_names()[:2] == ("inlet.P", "inlet.Q")
    text = dumps(network).replace('causality = "pressure"', 'causality = "level"')
    with pytest.raises(ValueError, match=r"text: inlet\.causality = 'level': must be one of flow, pressure\."):
        loads(text, "text")
    with pytest.raises(ValueError, match=r"network sheep: its inlet is driven by a pressure; give it as inflow"):
        simulate(network)
