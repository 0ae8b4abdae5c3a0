"""FMUs run by FMPy: description, answers, two in one process, resets, every bad input, what the host needs.

The oracle is the solver itself, called directly with the same inflow and parameters.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from compare import elastic
from fmpy.fmi1 import FMICallException
from fmus import COARSE, MS, TEXTS, TIGHT, Instance, mixed, run_python

from fmu_src.importer.run import run_fmu
from solver import Network, Settings, load, sampled_inflow, simulate
from solver.scheme.model import build as build_model
from solver.scheme.outputs import reporter
from solver.scheme.step import initial_state, step

Array = np.ndarray


def largest_error(value: Mapping[str, Array], expected: Mapping[str, Array]) -> float:
    """Largest difference of any output, relative to its largest magnitude."""
    names = [name for name in expected if name not in ("time", "inlet.Q")]
    return max(float(np.abs(value[n] - expected[n]).max() / np.abs(expected[n]).max()) for n in names)


# --- answers ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An FMU by name, its start values, and the network that the solver runs directly."""

    fmu: str
    starts: dict[str, float | str]
    network: Callable[[], Network]
    settings: Settings = Settings()
    end: float = 0.25  # s: past the peak of the inflow

    def parameters(self) -> dict[str, float]:
        return {name: float(value) for name, value in self.starts.items() if not isinstance(value, str)}


CASES = {
    "Table 1": Case("sheep", {}, lambda: load("sheep"), end=1.0),
    "elastic": Case("sheep", elastic(load("sheep").segments), lambda: load("sheep")),
    "regression law": Case(
        "sheep", {"network.elastic_law": "regression"}, lambda: replace(load("sheep"), elastic_law="regression")
    ),
    # iterated to the end: at the default tolerance the round-off of the inflow decides which iteration is the last
    "nonlinear": Case("tight", {}, lambda: load("sheep_nonlinear"), TIGHT),
    "all outlets": Case("mixed", {}, mixed),
    "other pressures": Case(
        "mixed", {"network.P_ref": 9e3, "network.P_0": 11e3, "VA2.outlet.P_venous": 11e3, "CA.ENL": 2e5}, mixed
    ),
    "other geometry": Case("stiff sheep", {"CA.L": 0.31, "CA.R0": 5e-3, "CA.E": 4.142e6}, lambda: load("sheep")),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_equals_the_solver(fmus: dict[str, Path], case: Case) -> None:
    """The half-sine, linear between samples, all outputs: 1e-9 of their largest value (measured 6e-15).

    Table 1 over two beats, what differs from it over half of one.
    """
    network = case.network()
    result = run_fmu(fmus[case.fmu], network.inlet.Q, case.end, start_values=case.starts)
    assert result["time"][-1] == case.end
    t = np.arange(round(case.end / MS) + 1) * MS
    inflow = sampled_inflow(t, network.inlet.Q(t))
    expected = simulate(network, inflow, case.end, parameters=case.parameters(), settings=case.settings)
    assert set(result) == {"time", *expected, "network.V", "venous.V", "venous.Q"}
    assert largest_error(result, expected) <= 1e-9


@pytest.mark.parametrize("case", ["Table 1", "all outlets"])
def test_held_inflow_equals_the_solver(instantiate: Callable[..., Instance], case: str) -> None:
    """Held samples over half a beat against the scheme stepped with constant inflow: 1e-9 (measured 0)."""
    network = CASES[case].network()
    instance = instantiate(CASES[case].fmu)
    instance.initialize()
    model = build_model(network)
    report, state = reporter(model), initial_state(model)
    value, expected = [], []
    for i, Q in enumerate(network.inlet.Q(np.arange(1, 251) * MS)):
        value.append(instance.step(i, Q))
        state = step(model, state, MS, np.full(4, Q))
        expected.append(report(state)[0])
    difference = np.abs(np.array(value) - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert difference.max() <= 1e-9
    assert tuple(instance.outputs) == tuple(network.output_units())


def test_settings_are_start_values(fmus: dict[str, Path], sheep: Network) -> None:
    """solver.dt and solver.element_length by start values give the answer of those settings: 1e-9."""
    starts = {"solver.dt": COARSE.dt, "solver.element_length": COARSE.element_length}
    t = np.arange(251) * COARSE.dt
    result = run_fmu(fmus["sheep"], sheep.inlet.Q, 0.5, step=COARSE.dt, start_values=starts)
    expected = simulate(sheep, sampled_inflow(t, sheep.inlet.Q(t)), 0.5, settings=COARSE)
    assert largest_error(result, expected) <= 1e-9


def test_venous_pressure_and_tuning(instantiate: Callable[..., Instance]) -> None:
    """P_venous driven at every step, CA.E and an outlet changed at 20 ms, against the scheme doing the same: 1e-9."""
    instance = instantiate("mixed")
    instance.initialize()
    names = [f"{o.segment}.outlet.P_venous" for o in mixed().outlets]
    tuned = {"CA.E": 3e6, "CA.outlet.R2": 1e9, "FA.outlet.R_t": 0.9}
    model = build_model(mixed())
    state = initial_state(model)
    for i in range(60):
        P_venous = 500.0 * np.sin(0.1 * i * np.arange(1, 6)) + [500.0, 0.0, 10e3, 0.0, 0.0]
        venous = dict(zip(names, P_venous.tolist(), strict=True))
        instance.set(venous)
        if i == 20:
            instance.set(tuned)
            model = model.with_parameters({**tuned, **venous})
        value = instance.step(i, 30e-6)
        state = step(model, state, MS, np.full(4, 30e-6), P_venous)
        assert value[1:] == pytest.approx(reporter(model)(state)[0, 1:].tolist(), rel=1e-9, abs=0.0)


@pytest.mark.slow
def test_plain_client(fmus: dict[str, Path], sheep: Network) -> None:
    """FMPy's simulate_fmu with default options reaches the stop time; its inflow is held: 1 % of the pulse (0.6 %)."""
    resting = fmpy.simulate_fmu(os.fspath(fmus["coarse sheep"]))
    assert resting["time"][-1] == pytest.approx(2.5)
    assert np.abs(resting["CA.P"]).max() < 3e-10  # Pa; 1.2e-10 measured, round-off
    t = np.arange(501) * MS
    signals = np.array(list(zip(t, sheep.inlet.Q(t), strict=True)), dtype=[("time", np.double), ("inlet.Q", np.double)])
    result = fmpy.simulate_fmu(
        os.fspath(fmus["sheep"]),
        stop_time=0.5,
        output_interval=MS,
        input=signals,
        start_values={"CA.E": 4.142e6, "network.elastic_law": 1},
        output=["CA.P", "MD.Q"],
    )
    assert result["time"][-1] == pytest.approx(0.5)
    expected = simulate(sheep)
    for name in ("CA.P", "MD.Q"):
        assert np.abs(result[name] - expected[name]).max() <= 0.01 * np.ptp(expected[name])


def test_driver_reaches_any_stop_time(fmus: dict[str, Path], sheep: Network) -> None:
    """A stop time between steps is met by a shorter last step; progress ends at 1."""
    parts: list[float] = []
    result = run_fmu(fmus["sheep"], sheep.inlet.Q, 0.0123, step=5 * MS, progress=parts.append)
    assert result["time"].tolist() == [0.0, 5 * MS, 10 * MS, 0.0123]
    assert parts[-1] == 1.0


# --- several in one process ---------------------------------------------------------------------------------------


def test_different_fmus_in_one_process(instantiate: Callable[..., Instance], sheep: Network) -> None:
    """Three FMUs of the same name, stepped in turns in a process that has imported solver and fmu_src as well.

    Each gives its own answer: the solver's with its network and settings, to 1e-9.
    """
    own = {
        "sheep": (sheep, Settings()),
        "coarse sheep": (sheep, COARSE),
        "stiff sheep": (sheep.with_parameters({"CA.E": 8e6}), Settings()),
    }
    instances = {name: instantiate(name) for name in own}
    for instance in instances.values():
        instance.initialize({"inlet.interpolation": "linear"})
    h = COARSE.dt
    t = np.arange(51) * h
    rows: dict[str, list[list[float]]] = {name: [] for name in own}
    for i, Q in enumerate(sheep.inlet.Q(t[1:])):
        for name, instance in instances.items():
            rows[name].append(instance.step(i, Q, h))
    peaks = []
    for name, (network, settings) in own.items():
        expected = simulate(network, sampled_inflow(t, sheep.inlet.Q(t)), t[-1], settings=settings)
        every = round(h / settings.dt)
        value = dict(zip(instances[name].outputs, np.array(rows[name]).T, strict=True))
        assert largest_error(value, {n: expected[n][every::every] for n in value}) <= 1e-9
        peaks.append(value["CA.P"].max())
    assert len(set(peaks)) == 3


def test_first_folder_deleted(instantiate: Callable[..., Instance]) -> None:
    """Two instances of one FMU in two folders: with the first folder gone, both step and reset, bit for bit alike."""
    first, second = instantiate("mixed"), instantiate("mixed")
    shutil.rmtree(first.folder / "resources")
    answers = []
    for instance in (first, second, first):
        instance.slave.reset()
        instance.initialize({"CA.E": 3e6})
        answers.append([instance.step(i, 20e-6) for i in range(5)])
    assert answers[0] == answers[1] == answers[2]


def test_module_path_is_left_alone(instantiate: Callable[..., Instance]) -> None:
    """After initialization no folder of an FMU is on the host's module path."""
    before = list(sys.path)
    for _ in range(3):
        instantiate("sheep").initialize()
    assert sys.path == before


# --- phases -------------------------------------------------------------------------------------------------------


def test_reset_equals_a_fresh_instance(instantiate: Callable[..., Instance]) -> None:
    """Changed parameters, steps, a failure, reset: then all variables and the next steps are a fresh one's, bitwise."""
    used, fresh = instantiate("mixed"), instantiate("mixed")
    used.initialize({"CA.E": 3e6, "network.P_0": 9e3, "network.elastic_law": "regression"}, start_time=0.0)
    for i in range(7):
        used.step(i, 20e-6)
    with pytest.raises(FMICallException):
        used.step(7, 0.9)
    used.slave.reset()
    numbers = [name for name in used.references if name not in TEXTS]
    assert used.get(numbers) == fresh.get(numbers)
    choices = [used.references[name] for name in TEXTS]
    assert used.slave.getInteger(choices) == fresh.slave.getInteger(choices) == [1] * len(TEXTS)
    used.initialize()
    fresh.initialize()
    assert [used.step(i, 10e-6) for i in range(5)] == [fresh.step(i, 10e-6) for i in range(5)]


def test_parameters_in_initialization_mode(instantiate: Callable[..., Instance], sheep: Network) -> None:
    """Set before or during initialization mode, parameters give the same; outputs follow them already there.

    At rest P = P_0, Q = 0 and, with the wall at its reference pressure, R = R0, to 1e-12.
    """
    starts = {"network.P_0": 5e3, "network.P_ref": 5e3, "CA.R0": 5e-3, "CA.E": 3e6}
    before, during = instantiate("sheep"), instantiate("sheep")
    before.initialize(starts)
    during.slave.setupExperiment(startTime=0.0)
    during.slave.enterInitializationMode()
    names = ["CA.P", "CA.R", "inlet.P", "CA.outlet.P", "CA.Q"]
    assert during.get(names) == pytest.approx([0.0, sheep.segment("CA").R0, 0.0, 0.0, 0.0], rel=1e-12, abs=1e-12)
    during.set(starts)
    assert during.get(names) == pytest.approx([5e3, 5e-3, 5e3, 5e3, 0.0], rel=1e-12)
    during.slave.exitInitializationMode()
    assert [before.step(i, 10e-6) for i in range(3)] == [during.step(i, 10e-6) for i in range(3)]


def test_start_time(instantiate: Callable[..., Instance]) -> None:
    """A run from 3 s is the run from 0: to 1e-9 (measured 1e-12)."""
    late, early = instantiate("sheep"), instantiate("sheep")
    late.initialize(start_time=3.0)
    early.initialize()
    for i in range(20):
        early.step(i, 10e-6)
        late.step(3000 + i, 10e-6)
    assert late.get() == pytest.approx(early.get(), rel=1e-9)


# --- what the host needs ------------------------------------------------------------------------------------------

COLD = r"""
import sys
import fmpy, fmpy.fmi2

description = fmpy.read_model_description(sys.argv[1])
BLOCKED = "scipy pint typer rich click matplotlib fmpy pytest solver fmu_src".split()

class Block:  # what the FMU must do without
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLOCKED:
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Block())
import time
before, began = set(sys.modules), time.perf_counter()
fmpy.extract(sys.argv[1], sys.argv[2])
slave = fmpy.instantiate_fmu(sys.argv[2], description, fmi_type="CoSimulation")
slave.setupExperiment(startTime=0.0)
slave.enterInitializationMode()
slave.exitInitializationMode()
slave.setReal([0], [1e-5])
slave.doStep(0.0, 1e-3)
ended = time.perf_counter()
slave.terminate()
slave.freeInstance()
new = {m.split(".")[0].lstrip("_") for m in set(sys.modules) - before}
known = sys.stdlib_module_names | {m.lstrip("_") for m in sys.stdlib_module_names}
print(ended - began, *sorted(m for m in new if m not in known))
"""


def test_needs_numpy_only(fmus: dict[str, Path], tmp_path: Path) -> None:
    """In a fresh process where everything else is blocked, the FMU steps; of other modules it brings its own.

    Prints the cold start: extract, instantiate, initialize, first step (measured 0.08 s; FMPy has imported numpy).
    """
    done = run_python(COLD, os.fspath(fmus["mixed"]), os.fspath(tmp_path / "fmu"), cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    seconds, *modules = done.stdout.split()
    print(f"cold start to the end of the first step: {float(seconds):.3f} s")
    assert {module.rstrip("0123456789abcdef") for module in modules} == {"arterial_", "numpy", "pythonfmu"}
