"""An inlet that is driven by a pressure: against the flow-driven network, linear theory, and its own order in time."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compare import relative_error
from fmus import COARSE, mixed

from fitting.calibrate.network_calibration import calibrate
from fitting.inference.models.network_record import network_problem
from fitting.records.alignment.beats import Beats
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.importer.run import run_fmu
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Reflection, Settings, linear, load, sampled_inflow, simulate, simulate_periodic
from solver.network.curve import Curve
from solver.network.files import dumps, loads
from solver.periodic.start import periodic_state
from solver.scheme import terms
from solver.scheme.model import build
from solver.scheme.outputs import inlet_answers
from solver.scheme.stage import Stage, operators
from solver.scheme.step import initial_state

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


@pytest.mark.slow
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


@pytest.mark.parametrize("causality", ["flow", "pressure"])
def test_jacobian_of_the_nodes(causality: str) -> None:
    """The condensed Jacobian is the derivative of the nodes' conditions with respect to their pressures: to 1e-7.

    Case: every kind of outlet, at rest, with the flows that the momentum equation makes of the pressures.
    """
    network = replace(mixed(), inlet=replace(mixed().inlet, causality=causality))
    model = build(network, settings=COARSE)
    state, o = initial_state(model), operators(model, COARSE.dt)
    drive = {"flow": 0.0, "pressure": network.P_0}[causality]
    stage = Stage.of(model, o, state.y, model.inlets.gain * drive, model.coefficients.P_venous, 0.0)

    def conditions(H: Array) -> Array:
        R = terms.residual(stage.start, state.Q, H)
        return stage.node_residual(state.Q - np.einsum("beij,bej->bei", o.at_rest.K_inverse, R), H)[0]

    G = -np.linalg.inv(o.at_rest.nodal.inverse[0])  # so few nodes that all of them are inverted as a whole
    changes = 1e-2 * np.eye(model.mesh.n_nodes)  # Pa
    slopes = [(conditions(state.H + change) - conditions(state.H - change)) / 2e-2 for change in changes]
    np.testing.assert_allclose(np.transpose(slopes), G, rtol=0.0, atol=1e-7 * np.abs(G).max())


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
    with pytest.raises(ValueError, match=r"network sheep: nothing drives inlet.P; give it as inflow"):
        simulate(network)


def test_a_table_of_the_other_kind() -> None:
    """A table of P under causality = "flow": refused, not passed over for the default flow."""
    table = 'segment = "A"\ncausality = "flow"\nt = [0.0, 0.2, 0.4, 0.5]\nP = [1e4, 1.1e4, 1e4, 1e4]'
    text = (
        f"name = 'one'\n[inlet]\n{table}\n[segments.A]\nL = 0.1\nR0 = 4e-3\nh = 1e-3\nE = 4e5\n[outlets.A]\nR_t = 0.5\n"
    )
    with pytest.raises(ValueError, match='inlet.causality = "flow": P is given, which is a pressure; leave causality'):
        loads(text, "text")
    assert loads(text.replace('"flow"', '"pressure"'), "text").inlet.causality == "pressure"


def test_records_drive_by_flow(tmp_path: Path) -> None:
    """A fit, whose records hold inlet.Q, refuses a network that wants a pressure."""
    network, t = driven_by_pressure(load("sheep")), np.arange(50) / 100.0
    beats = Beats("r.csv", "", 0.5, {"inlet.Q": np.tile(1e-5 * np.sin(4 * np.pi * t) ** 2, (2, 1))}, np.zeros(2))
    with pytest.raises(ValueError, match=r"network sheep: its inlet is driven by a pressure, but records"):
        calibrate(beats, network, ["all.E"])
    with pytest.raises(ValueError, match=r"network sheep: its inlet is driven by a pressure, but records"):
        network_problem(beats, network)


# --- the FMU ------------------------------------------------------------------------------------------------------


def pulse(t: Array) -> Array:
    """A pressure of 0 to 800 Pa, smooth from 0 on."""
    return 400.0 * (1.0 - np.cos(8.0 * np.pi * np.asarray(t)))


def component(network: Network, **starts: float | str) -> tuple[CoSimulation, dict[str, float | str]]:
    made = CoSimulation(network, COARSE)
    values = {v.name: v.start for v in variable_table(network, COARSE)} | {"inlet.interpolation": "linear", **starts}
    made.initialize(0.0, values)
    return made, values


def test_a_host_that_sets_nothing_has_arteries_at_rest() -> None:
    """inlet.P starts at network.P_0: nothing flows where the pressures behind the outlets are that, too."""
    sheep = load("sheep")
    venous = {f"{outlet.segment}.outlet.P_venous": 5e3 for outlet in sheep.outlets}
    made, values = component(driven_by_pressure(sheep.with_parameters({"network.P_0": 5e3, **venous})))
    assert values["inlet.P"] == 5e3
    made.step(0.0, 0.01, values)
    flows = [value for name, value in zip(sheep.output_units(), made.outputs(), strict=False) if name.endswith(".Q")]
    assert np.abs(flows).max() <= 1e-16


def test_variables_of_a_pressure_inlet() -> None:
    """inlet.P_mean starts at what the file gives, and at network.P_0 where it gives nothing; flow per pressure of the
    port is in units of inlet.Q over those of inlet.P."""
    network = driven_by_pressure(load("human"))
    given = replace(network.inlet, curve=Curve.series("P", 13e3, np.array([1e3]), np.zeros(1), 0.8))
    for inlet, expected in ((given, 13e3), (network.inlet, network.P_0)):
        table = {v.name: v for v in variable_table(replace(network, inlet=inlet), Settings())}
        assert table["inlet.P_mean"].start == pytest.approx(expected, rel=1e-12) and "inlet.Q_mean" not in table
    units = {name: v.quantity.unit for name, v in table.items() if v.quantity is not None}
    assert units["inlet.Q_0"] == units["inlet.Q"] == "m^3/s" and units["inlet.P"] == "Pa"
    assert units["inlet.Y"] == units["inlet.Y_0"] == "m^3/(Pa.s)"


def test_component() -> None:
    """The FMU's component gives the solver's answer to straight lines between 21 pressures, to 1e-9 of each pulse."""
    network, t = driven_by_pressure(load("sheep")), np.linspace(0.0, 0.2, 21)
    made, values = component(network)
    rows = [made.outputs()]
    for start, end in zip(t[:-1].tolist(), t[1:].tolist(), strict=True):
        made.step(start, end - start, {**values, "inlet.P": float(pulse(end))})
        rows.append(made.outputs())
    expected = simulate(network, sampled_inflow(t, pulse(t)), t[-1], settings=COARSE)
    for name, found in zip(network.output_units(), np.array(rows).T, strict=False):
        assert np.abs(found - expected[name][::5]).max() <= 1e-9 * np.ptp(expected[name]), name


@pytest.mark.parametrize("interpolation", ["hold", "linear", "smooth"])
def test_volume(interpolation: str) -> None:
    """Nothing leaves a network with closed ends, so venous.V stays 0 to round-off: 1e-14 of the volume."""
    sheep = load("sheep")
    closed = replace(sheep, outlets=tuple(Reflection(o.segment, R_t=1.0) for o in sheep.outlets))
    made, values = component(driven_by_pressure(closed), **{"inlet.interpolation": interpolation})
    first = made.V
    for i in range(60):
        made.step(5e-3 * i, 5e-3, {**values, "inlet.P": float(pulse(5e-3 * i))})
        assert abs(made.V_venous) <= 1e-14 * made.V
    assert abs(made.V - first) > 1e-3 * first


@pytest.mark.parametrize("interpolation", ["hold", "linear", "smooth"])
def test_port(interpolation: str) -> None:
    """Q(t + h) = Q_0 + Y_0 P(t) + Y P(t + h) says what the next step brings: to 1 % of Y ΔP for ΔP of 100 Pa."""
    h, (made, values) = 2e-3, component(driven_by_pressure(mixed()), **{"inlet.interpolation": interpolation})
    for i in range(100):
        made.step(h * i, h, {**values, "inlet.P": 10e3 + float(pulse(h * i))})
    said, before = made.ports(), made.shown.drive
    assert list(said)[:3] == ["inlet.Q_0", "inlet.Y", "inlet.Y_0"]
    P = before + 100.0
    if interpolation == "smooth":  # P(t) as extrapolated, and then P(t + h)
        made.step(100 * h, h, {**values, "inlet.P": before})
    made.step((101 if interpolation == "smooth" else 100) * h, h, {**values, "inlet.P": P})
    Q = inlet_answers(made.model, made.known.state)[0, 0]
    expected = said["inlet.Q_0"] + said["inlet.Y_0"] * before + said["inlet.Y"] * P
    assert abs(Q - expected) <= 0.01 * abs(said["inlet.Y"]) * 100.0


def test_steady_start() -> None:
    """network.start = periodic starts in the steady state under inlet.P_mean: it stays there, to 1e-9."""
    starts = {"network.start": "periodic", "inlet.P_mean": 13e3, "inlet.P": 13e3}
    made, values = component(driven_by_pressure(load("human")), **starts)
    first = np.array(made.outputs()[:-2])
    for i in range(20):
        made.step(0.01 * i, 0.01, values)
    np.testing.assert_allclose(made.outputs()[:-2], first, rtol=1e-7)


def test_fmu(tmp_path: Path, one_process: None) -> None:
    """build_fmu.py --inlet pressure makes an FMU with inlet.P in and inlet.Q out; it equals the solver to 1e-9."""
    command = [sys.executable, "-m", "build_fmu", "sheep", "--inlet", "pressure", "--out", str(tmp_path)]
    assert subprocess.run(command, check=False).returncode == 0
    result = run_fmu(tmp_path / "sheep.fmu", pulse, 0.1)
    t = result["time"]
    expected = simulate(driven_by_pressure(load("sheep")), sampled_inflow(t, pulse(t)), 0.1)
    assert list(result)[:3] == ["time", "inlet.P", "inlet.Q"]
    for name in ("inlet.Q", "CA.P", "MD.Q"):
        assert np.abs(result[name] - expected[name]).max() <= 1e-9 * np.ptp(expected[name])
