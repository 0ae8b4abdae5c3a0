"""``inlet.drive`` = network: what the network file gives at its inlets drives the FMU, as it drives the solver.

Errors are the largest difference of an output over the run, relative to that output's pulse (its range).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from c_host import CHost, unpack
from fmus import COARSE, MS, Instance, Store, mixed, venous_flows
from test_several_inlets import fork
from typer.testing import CliRunner

from arterial_fmu.cli.build import app
from build_fmu import build
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.importer.doctor import OK, examine
from fmu_src.importer.run import run_fmu
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Settings, load, simulate
from solver.network.curve import Curve
from solver.network.description import Inlet

Array = np.ndarray
Make = Callable[..., Instance]
OWN = {"inlet.drive": "network"}
STOP = 0.105


def component(network: Network, settings: Settings, **values: Any) -> tuple[CoSimulation, dict[str, Any]]:
    """A component that the network drives, and the values of its variables."""
    table = {v.name: v.start for v in variable_table(network, settings)} | {**OWN, **values}
    made = CoSimulation(network, settings)
    made.initialize(0.0, table)
    return made, table


def outputs(network: Network, settings: Settings, h: float, **values: Any) -> Array:
    """All outputs of the network at the communication points : (n + 1, n_outputs)."""
    made, table = component(network, settings, **values)
    n = len(network.output_units())
    rows = [made.outputs()[:n]]
    for i in range(round(STOP / h)):
        made.step(i * h, h, table)
        rows.append(made.outputs()[:n])
    return np.array(rows)


def direct(network: Network, settings: Settings) -> Array:
    found = simulate(network, None, STOP, settings=settings)
    return np.column_stack([found[name] for name in network.output_units()])


def error(value: Array, expected: Array) -> float:
    pulse = np.ptp(expected, axis=0)
    return float((np.abs(value - expected).max(axis=0)[pulse > 0.0] / pulse[pulse > 0.0]).max())


def curved(network: Network) -> Network:
    """The same, with a table for its inflow."""
    return replace(
        network, inlet=replace(network.inlet, curve=Curve("Q", (0.0, 0.1, 0.3, 0.5), (0.0, 4e-5, 1e-5, 0.0)))
    )


def by_pressure(inlet: Inlet, P_0: float) -> Inlet:
    """The same, where a pressure of two harmonics about P_0 [Pa] is given."""
    phase = np.arange(41) / 40.0
    P = P_0 + 1e3 * (np.sin(2 * np.pi * phase) + 0.4 * np.sin(4 * np.pi * phase))
    curve = Curve("P", tuple((0.5 * phase).tolist()), (*P[:-1].tolist(), float(P[0])))
    return replace(inlet, causality="pressure", curve=curve)


NETWORKS: dict[str, Callable[[], Network]] = {
    "half-sine": lambda: load("sheep"),
    "curve": lambda: curved(load("sheep")),
    "pressure": lambda: replace(mixed(), inlet=by_pressure(mixed().inlet, mixed().P_0)),
    "flow and pressure": lambda: replace(fork(), further_inlets=(by_pressure(fork().further_inlets[0], 0.0),)),
}


@pytest.mark.parametrize("h", [MS, 3 * MS, 7 * MS, 21 * MS])
@pytest.mark.parametrize("kind", NETWORKS)
def test_equals_the_direct_solver(kind: str, h: float) -> None:
    """Whatever multiple of the internal step the communication step is: what the solver gives, to 1e-9 (3e-13)."""
    network = NETWORKS[kind]()
    assert error(outputs(network, Settings(), h), direct(network, Settings())[:: round(h / MS)]) <= 1e-9


@pytest.mark.parametrize("h", [0.7 * MS, 1.5 * MS])
def test_off_the_grid(sheep: Network, h: float) -> None:
    """Other internal steps, so their error: 1e-4 of the pulse (measured 7e-6 and 2e-5) where both have a point."""
    value = outputs(sheep, Settings(), h)
    common = 10 if h < MS else 2
    assert error(value[::common], direct(sheep, Settings())[:: round(common * h / MS)][: len(value[::common])]) <= 1e-4


def test_mean_and_period(sheep: Network) -> None:
    """inlet.Q_mean and inlet.T scale what the network gives: the solver's answer to the scaled inflow, to 1e-9."""
    network = curved(sheep)
    value = outputs(network, COARSE, 2 * MS, **{"inlet.Q_mean": 3e-5, "inlet.T": 0.4})
    scaled = replace(network, inlet=network.inlet.with_mean(3e-5, 0.4))
    assert scaled.inlet.Q_mean == pytest.approx(3e-5, rel=1e-12)
    assert error(value, direct(scaled, COARSE)[: len(value)]) <= 1e-9


def test_a_pressure_is_raised() -> None:
    """with_mean of a pressure inlet: the curve, raised, over another period."""
    inlet = by_pressure(mixed().inlet, 10e3)
    other = inlet.with_mean(12e3, 0.8)
    assert (other.T, other.P_mean) == (0.8, pytest.approx(12e3, rel=1e-12))
    assert inlet.given is not None and other.given is not None
    np.testing.assert_allclose(other.given(np.array([0.16])), inlet.given(np.array([0.1])) + 2e3, rtol=1e-12)
    assert inlet.with_mean(inlet.P_mean, inlet.T) is inlet


def test_inputs_are_ignored_and_that_is_said(sheep: Network) -> None:
    """Whatever is set at the inlet and however it is interpolated: the same bits, and one remark, once."""
    expected = outputs(sheep, COARSE, 2 * MS)
    for interpolation in ("hold", "linear", "smooth"):
        made, values = component(sheep, COARSE, **{"inlet.interpolation": interpolation})
        remarks = []
        for i in range(10):
            made.step(2 * MS * i, 2 * MS, {**values, "inlet.Q": 1e-5 * i})
            remarks.append(made.remark)
        assert made.outputs()[: expected.shape[1]] == expected[10].tolist()
        assert remarks[1].startswith("inlet.Q is ignored: inlet.drive = network")
        assert [remark for remark in remarks if remark] == [remarks[1]]


def test_outlet_ports(sheep: Network) -> None:
    """P_venous(t + h) = P_0 - Z Q_venous(t + h) of an outlet, exact where P_venous stays as it is: to 1e-9."""
    network = mixed()
    network = replace(network, inlet=replace(network.inlet, curve=curved(sheep).inlet.curve))
    made, values = component(network, COARSE)
    for i in range(20):
        made.step(4 * MS * i, 4 * MS, values)
    said, P_venous = made.ports(), values["CA.outlet.P_venous"]
    made.step(4 * MS * 20, 4 * MS, values)
    i = [outlet.segment for outlet in network.outlets].index("CA")
    expected = said["CA.outlet.P_0"] - said["CA.outlet.Z"] * venous_flows(made)[i]
    assert expected == pytest.approx(P_venous, abs=1e-9 * said["CA.outlet.P_0"])


def test_volumes(sheep: Network) -> None:
    """What came in, by the inflow's mean, is in the arteries or has left to the veins: to 1e-4 of it."""
    made, values = component(sheep, COARSE)
    for i in range(25):
        made.step(0.02 * i, 0.02, values)
    assert made.V - made.V_0 + made.V_venous == pytest.approx(sheep.inlet.Q_mean * sheep.inlet.T, rel=1e-4)


# --- in a host ----------------------------------------------------------------------------------------------------


def host(instance: Instance, n: int, first: int = 0, h: float = 2 * MS) -> list[list[float]]:
    rows = []
    for i in range(first, first + n):
        instance.slave.doStep(i * h, h)
        rows.append(instance.get())
    return rows


def test_saved_states(instantiate: Make, fmus: dict[str, Path]) -> None:
    """A state, also from bytes in an instance that another drive has, and a reset: what follows is the same bits."""
    instance, other = instantiate("coarse sheep"), instantiate("coarse sheep")
    instance.initialize(OWN)
    first = host(instance, 10)
    state = instance.slave.getFMUState()
    expected = host(instance, 10, 10)
    instance.slave.setFMUState(state)
    assert host(instance, 10, 10) == expected
    other.initialize()
    other.slave.setFMUState(other.slave.deSerializeFMUstate(instance.slave.serializeFMUState(state)))
    assert host(other, 10, 10) == expected
    instance.slave.freeFMUState(state)
    instance.slave.reset()
    instance.initialize(OWN)
    assert host(instance, 10) == first
    instance.slave.reset()
    instance.initialize()
    assert host(instance, 10)[-1] != first[-1]


def test_with_fmpy(fmus: dict[str, Path], sheep: Network) -> None:
    """fmpy.simulate_fmu with nothing but inlet.drive: the solver's answer to 1e-9."""
    names = ["AA.P", "CA.P", "CA.Q"]
    result = fmpy.simulate_fmu(
        os.fspath(fmus["coarse sheep"]), stop_time=STOP, output_interval=5 * MS, start_values={"inlet.drive": 2},
        output=names,
    )  # fmt: skip
    expected = simulate(sheep, None, 0.11, settings=COARSE)
    for name in names:  # at 10, 20, … ms, where the internal steps of 2 ms and those within 5 ms end alike
        even = np.round(result["time"][::2] / COARSE.dt).astype(int)
        assert np.abs(result[name][::2] - expected[name][even]).max() <= 1e-4 * np.ptp(expected[name])
    assert result["time"][-1] == pytest.approx(STOP)


def test_in_c(c_host: CHost, fmus: dict[str, Path], instantiate: Make, tmp_path: Path) -> None:
    """A host in C sets the Enumeration by number and steps: the same digits as FMPy."""
    whole = unpack(fmus["coarse sheep"], tmp_path / "c")
    of = whole.references
    commands = [f"library 0 {whole.library}", whole.instantiate(0), f"setInteger 0 {of['inlet.drive']} 2"]
    commands += ["setup 0 0 1", "enter 0", "exit 0", "step 0 0 0.002", f"getReal 0 {of['AA.P']}", "free 0"]
    run = c_host.run(commands)
    instance = instantiate("coarse sheep")
    instance.initialize(OWN)
    instance.slave.doStep(0.0, 2 * MS)
    assert run[-2].values == instance.get(["AA.P"])


def test_run_without_inputs(fmus: dict[str, Path], sheep: Network) -> None:
    """run_fmu with no inflow: the network's own; given both, it is refused, since one would be ignored."""
    found = run_fmu(fmus["coarse sheep"], None, 0.1, step=4 * MS)
    expected = {name: values[::2] for name, values in simulate(sheep, None, 0.1, settings=COARSE).items()}
    assert "inlet.Q" not in found
    assert np.abs(found["CA.P"] - expected["CA.P"]).max() <= 1e-9 * np.ptp(expected["CA.P"])
    with pytest.raises(ValueError, match=r"inlet\.Q: ignored with inlet\.drive = network; leave one of them out"):
        run_fmu(fmus["coarse sheep"], np.zeros_like, STOP, start_values=OWN)


def test_built_in(sheep: Network, stored: Store, tmp_path: Path) -> None:
    """Hosts without Enumerations: built with it, FMPy needs nothing; a pressure that is not known is refused."""
    fmu = stored(build, sheep, settings=COARSE, starts=OWN)
    result = fmpy.simulate_fmu(os.fspath(fmu), stop_time=0.1, output_interval=0.01, output=["AA.P"])
    assert np.ptp(result["AA.P"]) > 1000.0
    line = ["sheep", "--inlet", "pressure", "--set", "inlet.drive=network", "--out", os.fspath(tmp_path / "P")]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 2
    assert "network sheep gives no curve of inlet.P" in done.stderr and not (tmp_path / "P").exists()


def test_the_doctor_tells(fmus: dict[str, Path], sheep: Network, stored: Store) -> None:
    """The doctor says what an FMU does that nobody drives; nothing where the FMU is no network of arteries."""

    def said(fmu: Path) -> str:
        return next(f"{f.state}: {f.found}; {f.remedy}" for f in examine(fmu) if f.what == "inflow")

    driven = said(fmus["coarse sheep"])
    assert driven.startswith(f"{OK}: an input: a host that never sets inlet.Q")
    assert "inlet.drive = network" in driven
    assert said(stored(build, sheep, settings=COARSE, starts=OWN)).startswith(f"{OK}: the network's own")
