"""FMUs run by FMPy: description, answers, two in one process, resets, every bad input, what the host needs.

The oracle is the solver itself, called directly with the same inflow and parameters.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy
import numpy as np
import pint
import pytest
from compare import elastic
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2Discard, fmi2Fatal
from fmpy.validation import validate_fmu

from build_fmu import build
from fmu_src.run import FMUError, run_fmu
from solver import (
    Network,
    NonPhysicalState,
    Pressure,
    Resistance,
    Settings,
    Windkessel,
    load,
    sampled_inflow,
    simulate,
)
from solver.outputs import output_variables, reporter
from solver.scheme.model import build as build_model
from solver.scheme.step import initial_state, step

Array = np.ndarray
MS = 1e-3
COARSE = Settings(dt=2e-3, element_length=0.1)


def mixed() -> Network:
    """The sheep network at physiological pressure, with every kind of outlet."""
    outlets = {o.segment: o for o in load("sheep").outlets} | {
        "CA": Windkessel("CA", R1=3e8, C=4e-10, R2=3e9, P_venous=500.0),
        "VA1": Resistance("VA1", R=3e9),
        "VA2": Pressure("VA2", P_venous=10e3),
        "VA3": Windkessel("VA3", R1=5e7, C=3e-9, R2=6e8),
    }
    return replace(load("sheep"), name="mixed", outlets=tuple(outlets.values()), P_ref=10e3, P_0=10e3)


@pytest.fixture(scope="session")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """FMUs by name; three of them are called sheep.fmu."""
    folder = tmp_path_factory.mktemp("fmus")
    sheep = load("sheep")
    return {
        "sheep": build(sheep, folder),
        "sheep_nonlinear": build(load("sheep_nonlinear"), folder),
        "mixed": build(mixed(), folder),
        "coarse sheep": build(sheep, folder / "coarse", COARSE),
        "stiff sheep": build(sheep.with_parameters({"CA.E": 8e6}), folder / "stiff"),
    }


class Instance:
    """An FMU extracted and instantiated, with variables by name and the log in ``messages``."""

    def __init__(self, fmu: Path, folder: Path, logging: bool = True) -> None:
        self.messages: list[str] = []
        description = fmpy.read_model_description(os.fspath(fmu))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        self.folder = Path(fmpy.extract(os.fspath(fmu), os.fspath(folder)))

        def log(_environment: Any, _instance: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        self.slave: FMU2Slave = fmpy.instantiate_fmu(
            os.fspath(folder), description, fmi_type="CoSimulation", logger=log, debug_logging=logging
        )

    def set(self, values: Mapping[str, float | str]) -> None:
        for name, value in values.items():
            call = self.slave.setString if isinstance(value, str) else self.slave.setReal
            call([self.references[name]], [value])

    def get(self, names: Sequence[str] | None = None) -> list[float]:
        return self.slave.getReal([self.references[name] for name in names or self.outputs])

    def initialize(self, values: Mapping[str, float | str] | None = None, start_time: float = 0.0) -> None:
        self.slave.setupExperiment(startTime=start_time)
        self.set(values or {})
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def step(self, i: int, Q: float, h: float = MS) -> list[float]:
        """Step number i, to the time (i + 1) h with inlet.Q = Q; the outputs there."""
        self.set({"inlet.Q": Q})
        self.slave.doStep(i * h, h)
        return self.get()


@pytest.fixture
def instantiate(fmus: dict[str, Path], tmp_path: Path) -> Iterator[Callable[..., Instance]]:
    """Makes instances of FMUs by name, and frees them after the test."""
    made: list[Instance] = []

    def make(name: str, **options: Any) -> Instance:
        made.append(Instance(fmus[name], tmp_path / f"{len(made)}", **options))
        return made[-1]

    yield make
    for instance in made:
        instance.slave.freeInstance()


def largest_error(value: Mapping[str, Array], expected: Mapping[str, Array]) -> float:
    """Largest difference of any output, relative to its largest magnitude."""
    names = [name for name in expected if name not in ("time", "inlet.Q")]
    return max(float(np.abs(value[n] - expected[n]).max() / np.abs(expected[n]).max()) for n in names)


# --- description --------------------------------------------------------------------------------------------------

NAMES = ["sheep", "sheep_nonlinear", "mixed"]


@pytest.mark.parametrize("name", NAMES)
def test_valid(fmus: dict[str, Path], name: str) -> None:
    """FMPy finds no problem: schema, names, structure, start values, units."""
    assert validate_fmu(os.fspath(fmus[name])) == []


def test_valid_on_the_command_line(fmus: dict[str, Path]) -> None:
    """``fmpy validate`` agrees."""
    done = subprocess.run(
        [sys.executable, "-m", "fmpy", "validate", os.fspath(fmus["mixed"])], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "No problems found" in done.stdout


def xml(fmu: Path) -> ElementTree.Element:
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        return ElementTree.fromstring(archive.read("modelDescription.xml"))


def find(parent: ElementTree.Element, path: str) -> ElementTree.Element:
    node = parent.find(path)
    assert node is not None
    return node


def test_head_of_the_description(fmus: dict[str, Path]) -> None:
    """Names, versions, licence, flags and default experiment; nothing that changes from build to build."""
    root = xml(fmus["sheep"])
    assert root.attrib["variableNamingConvention"] == "structured"
    assert root.attrib["generationTool"].startswith("arterial-fmu 0.")
    assert "with PythonFMU 0." in root.attrib["generationTool"]
    assert {"modelName": "sheep", "license": "MIT", "fmiVersion": "2.0"}.items() <= root.attrib.items()
    assert root.attrib["version"] and root.attrib["author"]
    assert "doi:10.1115/1.4034832" in root.attrib["description"]
    assert "generationDateAndTime" not in root.attrib
    slave = find(root, "CoSimulation").attrib
    assert slave["canHandleVariableCommunicationStepSize"] == slave["needsExecutionTool"] == "true"
    assert slave["canGetAndSetFMUstate"] == slave["canSerializeFMUstate"] == slave["canInterpolateInputs"] == "false"
    assert slave["canBeInstantiatedOnlyOncePerProcess"] == "false"
    experiment = {key: float(value) for key, value in find(root, "DefaultExperiment").attrib.items()}
    assert experiment == {"startTime": 0.0, "stopTime": 2.5, "stepSize": 1e-3, "tolerance": 3e-5}


# what the FMU promises: (causality, variability, unit, display unit) by the end of the name
KINDS = {
    ".L": ("parameter", "fixed", "m", "cm"),
    ".R0": ("parameter", "fixed", "m", "mm"),
    ".h": ("parameter", "fixed", "m", "mm"),
    ".E": ("parameter", "tunable", "Pa", "MPa"),
    ".ENL": ("parameter", "tunable", "Pa", "MPa"),
    ".phi0": ("parameter", "tunable", "Pa.s", "kPa.s"),
    ".phiNL": ("parameter", "tunable", "Pa.s^2", "kPa.s^2"),
    ".outlet.R_t": ("parameter", "tunable", "1", None),
    ".outlet.R1": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".outlet.C": ("parameter", "tunable", "m^3/Pa", "mL/mmHg"),
    ".outlet.R2": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".outlet.R": ("parameter", "tunable", "Pa.s/m^3", "mmHg.s/mL"),
    ".junction.k": ("parameter", "tunable", "1", None),
    ".outlet.P_venous": ("input", "continuous", "Pa", "mmHg"),
    "fluid.rho": ("parameter", "fixed", "kg/m^3", None),
    "fluid.nu": ("parameter", "fixed", "m^2/s", None),
    "fluid.alpha": ("parameter", "fixed", "1", None),
    "fluid.friction": ("parameter", "fixed", "1", None),
    "network.eta": ("parameter", "fixed", "1", None),
    "network.P_ref": ("parameter", "fixed", "Pa", "mmHg"),
    "network.P_0": ("parameter", "fixed", "Pa", "mmHg"),
    "solver.dt": ("parameter", "fixed", "s", "ms"),
    "solver.element_length": ("parameter", "fixed", "m", "cm"),
    "inlet.Q": ("input", "continuous", "m^3/s", "mL/s"),
    ".P": ("output", "continuous", "Pa", "mmHg"),
    ".Q": ("output", "continuous", "m^3/s", "mL/s"),
    ".R": ("output", "continuous", "m", "mm"),
}
TEXTS = {"network.elastic_law": "beta", "network.viscous_law": "quadratic", "inlet.interpolation": "hold"}


def expected_names(network: Network) -> list[str]:
    outlets = {"Reflection": ["R_t"], "Windkessel": ["R1", "C", "R2"], "Resistance": ["R"], "Pressure": []}
    names = ["inlet.Q", "inlet.P", "solver.dt", "solver.element_length", *TEXTS]
    names += [
        "network.eta",
        "network.P_ref",
        "network.P_0",
        *(f"fluid.{k}" for k in ("rho", "nu", "alpha", "friction")),
    ]
    names += [f"{s.name}.{k}" for s in network.segments for k in ("L", "R0", "h", "E", "ENL", "phi0", "phiNL")]
    names += [f"{o.segment}.outlet.{k}" for o in network.outlets for k in outlets[type(o).__name__]]
    names += [f"{o.segment}.outlet.{k}" for o in network.outlets for k in ("P_venous", "P", "Q")]
    names += [f"{j.name}.junction.k" for j in network.junctions]
    return names + [f"{site.name}.{k}" for site in network.sites for k in "PQR"]


def test_variables(fmus: dict[str, Path]) -> None:
    """Every variable of the network and no other, with unit, range, nominal, description and initial."""
    variables = {node.attrib["name"]: node for node in find(xml(fmus["mixed"]), "ModelVariables")}
    assert sorted(variables) == sorted(expected_names(mixed()))
    for name, node in variables.items():
        assert node.attrib["description"]
        if name in TEXTS:
            assert (node[0].tag, node[0].attrib) == ("String", {"start": TEXTS[name]})
            assert (node.attrib["causality"], node.attrib["variability"]) == ("parameter", "fixed")
            continue
        kind = next((KINDS[end] for end in sorted(KINDS, key=len, reverse=True) if name.endswith(end)), None)
        real = node[0].attrib
        found = node.attrib["causality"], node.attrib["variability"], real["unit"], real.get("displayUnit")
        assert found == kind, name
        initial = {"parameter": "exact", "output": "calculated", "input": None}[found[0]]
        assert node.attrib.get("initial") == initial
        assert float(real["nominal"]) > 0.0
        if found[0] == "output":
            assert "start" not in real
        else:
            assert float(real["min"]) <= float(real["start"]) <= float(real["max"])
    assert [int(node.attrib["valueReference"]) for node in variables.values()] == list(range(len(variables)))


@pytest.mark.parametrize("name", NAMES)
def test_start_values_are_exact(fmus: dict[str, Path], name: str) -> None:
    """Start values are the network's and the settings', bit for bit."""
    network = mixed() if name == "mixed" else load(name)
    starts = {n.attrib["name"]: n[0].attrib.get("start") for n in find(xml(fmus[name]), "ModelVariables")}
    for key, value in {**network.parameters(), "solver.dt": 1e-3, "solver.element_length": 0.05}.items():
        assert float(starts[key] or "nan").hex() == float(value).hex(), key
    assert starts["network.viscous_law"] == network.viscous_law


def test_units(fmus: dict[str, Path]) -> None:
    """Base units and display factors are pint's, to round-off (1e-12)."""
    registry: pint.UnitRegistry[Any] = pint.UnitRegistry()
    short = {"meter": "m", "kilogram": "kg", "second": "s"}
    definitions = find(xml(fmus["mixed"]), "UnitDefinitions")
    displays = 0
    for unit in definitions:
        parsed = registry.parse_expression(unit.attrib["name"].replace(".", "*")) * registry.dimensionless
        base = parsed.to_base_units()
        assert base.magnitude == pytest.approx(1.0, rel=1e-12)
        powers = {short[str(key)]: int(power) for key, power in base.unit_items()}
        assert powers == {key: int(power) for key, power in find(unit, "BaseUnit").attrib.items()}
        for display in unit.findall("DisplayUnit"):
            factor = parsed.to(display.attrib["name"].replace(".", "*")).magnitude
            assert float(display.attrib["factor"]) == pytest.approx(factor, rel=1e-12)
            assert "offset" not in display.attrib
            displays += 1
    assert displays == 10


@pytest.mark.parametrize("name", NAMES)
def test_structure(fmus: dict[str, Path], name: str) -> None:
    """Outputs depend on no input directly, so no master sees an algebraic loop; all outputs are initial unknowns."""
    root = xml(fmus[name])
    kinds = [node.attrib["causality"] for node in find(root, "ModelVariables")]
    outputs = [str(i) for i, kind in enumerate(kinds, start=1) if kind == "output"]
    unknowns = find(root, "ModelStructure/Outputs")
    assert [node.attrib for node in unknowns] == [
        {"index": i, "dependencies": "", "dependenciesKind": ""} for i in outputs
    ]
    initial = find(root, "ModelStructure/InitialUnknowns")
    assert [node.attrib["index"] for node in initial] == outputs
    for node in initial:
        assert {kinds[int(i) - 1] for i in node.attrib["dependencies"].split()} <= {"parameter"}


def test_initial_dependencies_are_complete(instantiate: Callable[..., Instance], fmus: dict[str, Path]) -> None:
    """An initial output changes with a parameter or input if and only if the description lists it, walls apart.

    (R is declared to depend on the walls of all segments.) Each one is changed by 1 %, in initialization mode.
    """
    root = xml(fmus["mixed"])
    names = [node.attrib["name"] for node in find(root, "ModelVariables")]
    declared = {
        names[int(node.attrib["index"]) - 1]: {names[int(i) - 1] for i in node.attrib["dependencies"].split()}
        for node in find(root, "ModelStructure/InitialUnknowns")
    }
    instance = instantiate("mixed")
    instance.slave.setupExperiment(startTime=0.0)
    instance.set({"network.P_0": 12e3})
    instance.slave.enterInitializationMode()
    before = dict(zip(instance.outputs, instance.get(), strict=True))
    changed: dict[str, set[str]] = {name: set() for name in instance.outputs}
    for name in names:
        if name in TEXTS or name in instance.outputs:
            continue
        (value,) = instance.get([name])
        instance.set({name: value * 0.99 if value else 1e-3})
        for output, now in zip(instance.outputs, instance.get(), strict=True):
            if abs(now - before[output]) > 1e-9 * abs(before[output]):
                changed[output].add(name)
        instance.set({name: value})
    for output, sources in changed.items():
        assert sources <= declared[output], output
        assert (declared[output] == set()) == (sources == set())


# --- answers ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """An FMU by name, its start values, and the network that the solver runs directly."""

    fmu: str
    starts: dict[str, float | str]
    network: Callable[[], Network]

    def parameters(self) -> dict[str, float]:
        return {name: float(value) for name, value in self.starts.items() if not isinstance(value, str)}


CASES = {
    "Table 1": Case("sheep", {}, lambda: load("sheep")),
    "elastic": Case("sheep", elastic(load("sheep").segments), lambda: load("sheep")),
    "regression law": Case(
        "sheep", {"network.elastic_law": "regression"}, lambda: replace(load("sheep"), elastic_law="regression")
    ),
    "nonlinear": Case("sheep_nonlinear", {}, lambda: load("sheep_nonlinear")),
    "all outlets": Case("mixed", {}, mixed),
    "other pressures": Case(
        "mixed", {"network.P_ref": 9e3, "network.P_0": 11e3, "VA2.outlet.P_venous": 11e3, "CA.ENL": 2e5}, mixed
    ),
    "other geometry": Case("stiff sheep", {"CA.L": 0.31, "CA.R0": 5e-3, "CA.E": 4.142e6}, lambda: load("sheep")),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_equals_the_solver(fmus: dict[str, Path], case: Case) -> None:
    """Two beats of the half-sine, linear between samples, all outputs: 1e-9 of their largest value (measured 6e-15)."""
    network = case.network()
    result = run_fmu(fmus[case.fmu], network.inlet.Q, 1.0, start_values=case.starts)
    assert result["time"][-1] == 1.0
    t = np.arange(1001) * MS
    inflow = sampled_inflow(t, network.inlet.Q(t))
    expected = simulate(network, inflow, 1.0, parameters=case.parameters())
    assert set(result) == {"time", *expected}
    assert largest_error(result, expected) <= 1e-9


@pytest.mark.parametrize("case", ["Table 1", "all outlets"])
def test_held_inflow_equals_the_solver(instantiate: Callable[..., Instance], case: str) -> None:
    """Held samples over two beats against the scheme stepped with constant inflow: 1e-9 (measured 0)."""
    network = CASES[case].network()
    instance = instantiate(CASES[case].fmu)
    instance.initialize()
    model = build_model(network)
    report, state = reporter(model), initial_state(model)
    value, expected = [], []
    for i, Q in enumerate(network.inlet.Q(np.arange(1, 1001) * MS)):
        value.append(instance.step(i, Q))
        state = step(model, state, MS, np.full(4, Q))
        expected.append(report(state)[0])
    difference = np.abs(np.array(value) - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert difference.max() <= 1e-9
    assert tuple(instance.outputs) == output_variables(network)[0]


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


def test_plain_client(fmus: dict[str, Path], sheep: Network) -> None:
    """FMPy's simulate_fmu with default options reaches the stop time; its inflow is held: 1 % of the pulse (0.6 %)."""
    resting = fmpy.simulate_fmu(os.fspath(fmus["sheep"]))
    assert resting["time"][-1] == pytest.approx(2.5)
    assert np.abs(resting["CA.P"]).max() == 0.0
    t = np.arange(501) * MS
    signals = np.array(list(zip(t, sheep.inlet.Q(t), strict=True)), dtype=[("time", np.double), ("inlet.Q", np.double)])
    result = fmpy.simulate_fmu(
        os.fspath(fmus["sheep"]),
        stop_time=0.5,
        output_interval=MS,
        input=signals,
        start_values={"CA.E": 4.142e6, "network.elastic_law": "beta"},
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
    texts = [used.references[name] for name in TEXTS]
    assert used.slave.getString(texts) == fresh.slave.getString(texts) == [b"beta", b"quadratic", b"hold"]
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


# --- bad input ----------------------------------------------------------------------------------------------------

# Each case: what is done to an instance that has taken one step, and the sentence in the log. The first word of a case
# is the moment: "before" initialization (after a reset), "now", or "init" in initialization mode.
RANGE = "Young's modulus E must lie in [100, 1e+10] Pa; check the value and its unit."
BAD: dict[str, tuple[str, list[list[Any]], str]] = {
    "out of range": ("now", [["set", "CA.E", -1.0]], f"CA.E = -1 Pa is not allowed: {RANGE}"),
    "NaN parameter": ("now", [["set", "CA.E", float("nan")]], f"CA.E = nan Pa is not allowed: {RANGE}"),
    "infinite parameter": ("before", [["set", "CA.E", float("inf")]], f"CA.E = inf Pa is not allowed: {RANGE}"),
    "out of range before": ("before", [["set", "CA.E", 1e11]], f"CA.E = 1e+11 Pa is not allowed: {RANGE}"),
    "setting before": (
        "before",
        [["set", "solver.dt", 1.0]],
        "solver.dt = 1 s is not allowed: internal time step must lie in [1e-07, 0.1] s; check the value and its unit.",
    ),
    "NaN inflow": (
        "now",
        [["set", "inlet.Q", float("nan")]],
        "inlet.Q = nan m^3/s is not allowed: flow into the network must lie in [-1, 1] m^3/s; "
        "check the value and its unit.",
    ),
    "NaN inflow before": (
        "init",
        [["set", "inlet.Q", float("nan")]],
        "inlet.Q = nan m^3/s is not allowed: flow into the network must lie in [-1, 1] m^3/s; "
        "check the value and its unit.",
    ),
    "fixed": (
        "now",
        [["set", "CA.L", 0.2]],
        "CA.L is fixed: set it before initialization ends, or reset the component.",
    ),
    "fixed text": (
        "now",
        [["set", "network.elastic_law", "beta"]],
        "network.elastic_law is fixed: set it before initialization ends, or reset the component.",
    ),
    "output": ("now", [["set", "CA.P", 1.0]], "CA.P is an output and cannot be set."),
    "output before": ("before", [["set", "CA.P", 1.0]], "CA.P is an output and cannot be set."),
    "bad text": (
        "before",
        [["set", "network.elastic_law", "linear"]],
        "network.elastic_law = 'linear': must be one of beta, regression.",
    ),
    "format characters": (
        "before",
        [["set", "inlet.interpolation", "%s %n 100 %"]],
        "inlet.interpolation = '%s %n 100 %': must be one of hold, linear.",
    ),
    "nonlinear elastic wall": (
        "before",
        [["set", "CA.phi0", 0.0], ["set", "CA.phiNL", 1e4], ["initialize"]],
        "CA.phiNL",  # the solver's own sentence, see below
    ),
    "nonlinear elastic wall, outputs": (
        "init",
        [["set", "CA.phi0", 0.0], ["set", "CA.phiNL", 1e4], ["get", "CA.P"]],
        "CA.phiNL",
    ),
    "nonlinear elastic wall, tuned": (
        "now",
        [["set", "CA.phi0", 0.0], ["set", "CA.phiNL", 1e4], ["step", 0.001, 0.001]],
        "CA.phiNL",
    ),
    "unreachable pressure": (
        "before",
        [["set", "network.elastic_law", "regression"], ["set", "network.P_0", 1e6], ["initialize"]],
        "network.P_0",
    ),
    "large inflow": ("now", [["set", "inlet.Q", 0.5], ["step", 0.001, 0.001]], "large inflow"),
    "wrong communication point": (
        "now",
        [["step", 0.5, 0.001]],
        "step from t = 0.5 s, but the component stands at 0.001 s; step on from there or reset.",
    ),
    "step of 0": ("now", [["step", 0.001, 0.0]], "communication step of 0 s: must be positive."),
    "step backwards": ("now", [["step", 0.001, -0.001]], "communication step of -0.001 s: must be positive."),
    "step of NaN": ("now", [["step", 0.001, float("nan")]], "communication step of nan s: must be positive."),
    "step before": (
        "before",
        [["step", 0.0, 0.001]],
        "do_step in phase 'instantiated': it belongs to phase 'stepping'; reset the component.",
    ),
    "step after": (
        "now",
        [["terminate"], ["step", 0.001, 0.001]],
        "do_step in phase 'terminated': it belongs to phase 'stepping'; reset the component.",
    ),
    "initialization again": (
        "now",
        [["enter"]],
        "enter_initialization_mode in phase 'stepping': it belongs to phase 'instantiated'; reset the component.",
    ),
    "start time": ("before", [["setup", float("nan")]], "start time of nan s: must be finite."),
    "unknown reference": ("now", [["set_reference", 9999, 1.0]], "value reference 9999: there is no such variable."),
    "negative reference": (
        "now",
        [["get_reference", 2**32 - 1]],
        "value reference -1: there is no such variable.",
    ),
    "text as number": (
        "now",
        [["get", "network.elastic_law"]],
        "network.elastic_law is a String variable; read and set it as such.",
    ),
    "number as text": ("now", [["get_text", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "integer": ("now", [["get_integer", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "set integer": ("now", [["set_integer", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "boolean": ("now", [["get_boolean", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "set boolean": ("now", [["set_boolean", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "save state": (
        "now",
        [["save"]],
        "the state cannot be saved or restored (canGetAndSetFMUstate is false).",
    ),
}

HOST = r"""
import gc, json, os, sys, tempfile
import fmpy
from fmpy.fmi1 import FMICallException

fmu, cases = sys.argv[1], json.loads(sys.stdin.read())
description = fmpy.read_model_description(fmu)
references = {v.name: v.valueReference for v in description.modelVariables}

class Instance:
    def __init__(self, logging=True):
        self.messages = []
        self.folder = tempfile.mkdtemp(dir=sys.argv[2])
        fmpy.extract(fmu, self.folder)
        self.slave = fmpy.instantiate_fmu(
            self.folder, description, fmi_type="CoSimulation", debug_logging=logging,
            logger=lambda e, i, status, c, message: self.messages.append(message.decode()))
    def initialize(self):
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
    def step(self, t=0.0, h=0.001):
        self.slave.doStep(t, h)
    def set(self, name, value):
        call = self.slave.setString if isinstance(value, str) else self.slave.setReal
        call([references[name]], [value])
    def act(self, what, *rest):
        s, r = self.slave, [references[rest[0]]] if rest and rest[0] in references else []
        {
            "set": lambda: self.set(*rest),
            "get": lambda: s.getReal(r),
            "initialize": self.initialize,
            "step": lambda: self.step(*rest),
            "terminate": s.terminate,
            "enter": s.enterInitializationMode,
            "setup": lambda: s.setupExperiment(startTime=rest[0]),
            "set_reference": lambda: s.setReal([rest[0]], [rest[1]]),
            "get_reference": lambda: s.getReal([rest[0]]),
            "get_text": lambda: s.getString(r),
            "get_integer": lambda: s.getInteger(r),
            "set_integer": lambda: s.setInteger(r, [1]),
            "get_boolean": lambda: s.getBoolean(r),
            "set_boolean": lambda: s.setBoolean(r, [True]),
            "save": s.getFMUState,
        }[what]()

def answer(instance):
    instance.set("inlet.Q", 1e-5)
    for i in range(3):
        instance.step(i * 0.001)
    return instance.slave.getReal([references["CA.outlet.P"], references["inlet.P"]])

for name, moment, actions in cases:
    print(json.dumps({"case": name}), flush=True)
    report = {"case": name, "status": None}
    instance = Instance(logging=name != "without logging")
    if moment == "now":
        instance.initialize()
        instance.step()
    if moment == "init":
        instance.slave.setupExperiment(startTime=0.0)
        instance.slave.enterInitializationMode()
    for action in actions[:-1]:
        instance.act(*action)
    report["early"] = list(instance.messages)
    try:
        instance.act(*actions[-1])
    except FMICallException as error:
        report["status"] = error.status
    report["log"] = instance.messages
    gc.collect()
    # the instance that failed can still be read, reset and used
    instance.slave.getReal([references["CA.E"]])
    instance.slave.reset()
    instance.initialize()
    report["reset"] = answer(instance)
    instance.slave.freeInstance()
    gc.collect()
    other = Instance()
    other.initialize()
    report["next"] = answer(other)
    other.slave.terminate()
    other.slave.freeInstance()
    gc.collect()
    print(json.dumps(report), flush=True)
print(json.dumps({"case": "end", "fresh": sorted(m for m in sys.modules if m.split(".")[0] in ("solver", "fmu_src"))}))
"""


@dataclass(frozen=True)
class Host:
    """What a host process said of each case, and how it ended."""

    code: int
    errors: str
    reports: dict[str, dict[str, Any]]


@pytest.fixture(scope="module")
def host(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Host:
    """One process, in which neither solver nor fmu_src is imported, goes through all bad inputs."""
    folder = tmp_path_factory.mktemp("host")
    (folder / "host.py").write_text(HOST)
    cases = [[name, moment, actions] for name, (moment, actions, _) in BAD.items()]
    cases.append(["without logging", *BAD["out of range"][:2]])
    done = subprocess.run(
        [sys.executable, "host.py", os.fspath(fmus["sheep"]), os.fspath(folder)],
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=100,
    )
    reports = {report["case"]: report for report in map(json.loads, done.stdout.splitlines())}
    return Host(done.returncode, done.stderr, reports)


def sentence_of_the_solver(case: str, sheep: Network) -> str:
    """What the solver says to the same mistake."""
    with pytest.raises((ValueError, NonPhysicalState)) as error:
        if case == "large inflow":
            model = build_model(sheep)
            step(model, step(model, initial_state(model), MS, np.zeros(4)), MS, np.full(4, 0.5))
        elif case == "unreachable pressure":
            simulate(replace(sheep, elastic_law="regression"), parameters={"network.P_0": 1e6})
        else:
            simulate(sheep, parameters={"CA.phi0": 0.0, "CA.phiNL": 1e4})
    return str(error.value)


def test_host_survives_all_bad_input(host: Host) -> None:
    """The process that met every bad input, with collections of garbage in between, ends with code 0."""
    assert host.errors == ""
    assert host.code == 0, f"died at {list(host.reports)[-1]}"
    assert host.reports["end"]["fresh"] == []


@pytest.mark.parametrize("case", BAD)
def test_bad_input(host: Host, sheep: Network, case: str) -> None:
    """A failed status, and one sentence in the log: the solver's own where it is its affair. Nothing is broken.

    The instance can be reset, and it and the next one give the answer of an undisturbed one, bit for bit.
    """
    report = host.reports[case]
    assert report["early"] == []
    stepping = BAD[case][1][-1][0] == "step"
    assert report["status"] == (fmi2Discard if stepping else fmi2Fatal)
    sentence = BAD[case][2]
    if not sentence.endswith("."):
        sentence = sentence_of_the_solver(case, sheep)
    (message,) = report["log"]
    if stepping:
        assert message == f"sheep: {sentence}"
    else:
        head, _, said = message.partition("\n")
        assert head.startswith("Fatal py exception encountered")
        assert said in (f"ValueError({text!r})" for text in (f"sheep: {sentence}",))
    assert report["reset"] == report["next"] == host.reports["out of range"]["next"]
    assert report["next"][1] > 100.0


def test_without_logging(host: Host) -> None:
    """With logging off the status is the same, and what comes through says the same or nothing."""
    report = host.reports["without logging"]
    assert report["status"] == fmi2Fatal
    assert all(BAD["out of range"][2].split(":")[0] in message for message in report["log"])


@pytest.mark.parametrize(
    ("starts", "Q", "sentence"),
    [
        ({"CA.E": -1.0}, 1.0, BAD["out of range"][2]),
        ({"network.elastic_law": 'it\'s 100 % "linear"'}, 1.0, "network.elastic_law = 'it\\'s 100 % \"linear\"': must"),
        ({"CA.phi0": 0.0, "CA.phiNL": 1e4}, 1.0, "CA.phiNL"),
        ({"CA.P": 1.0}, 1.0, BAD["output"][2]),
        ({}, float("nan"), BAD["NaN inflow"][2]),
        ({}, 1e4, "segment AA at x = "),
    ],
)
def test_bad_input_through_the_driver(
    fmus: dict[str, Path], starts: dict[str, float | str], Q: float, sentence: str
) -> None:
    """run_fmu raises FMUError with the sentence that the FMU logged, and the next run is right."""
    network = load("sheep")
    with pytest.raises(FMUError) as error:
        run_fmu(fmus["sheep"], lambda t: Q * network.inlet.Q(t), 0.02, start_values=starts)
    assert str(error.value).startswith(f"{fmus['sheep']}: sheep: {sentence}")
    assert "\n" not in str(error.value)
    gc.collect()
    assert run_fmu(fmus["sheep"], network.inlet.Q, 0.005)["inlet.P"][-1] > 0.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"start_values": {"CA.X": 1.0}}, r"CA\.X: .*sheep\.fmu has no such variable; see its modelDescription"),
        ({"start_values": {"CA.E": "stiff"}}, r"CA\.E = 'stiff': must be a number\."),
        ({"start_values": {"network.elastic_law": 1.0}}, r"network\.elastic_law = 1\.0: must be a text\."),
        ({"stop_time": float("nan")}, r"stop_time = nan s: must be a positive, finite number\."),
        ({"step": 0.0}, r"step = 0\.0 s: must be a positive, finite number\."),
        ({"inflow": lambda t: np.zeros(3)}, r"inflow: for 11 times it gave shape \(3,\); it must give one value"),
        ({"fmu": "nowhere.fmu"}, r"nowhere\.fmu: cannot be read \(No such file or directory\); check the path\."),
        ({"fmu": __file__}, r".*test_fmu\.py: not an FMU; build one with build_fmu\.py\."),
    ],
)
def test_driver_refuses(fmus: dict[str, Path], change: dict[str, Any], sentence: str) -> None:
    """Mistakes in the call of run_fmu are ValueErrors with one sentence."""
    call = {"fmu": fmus["sheep"], "inflow": np.zeros_like, "stop_time": 0.01, **change}
    with pytest.raises(ValueError, match=sentence):
        run_fmu(call.pop("fmu"), call.pop("inflow"), call.pop("stop_time"), **call)


def test_failed_instantiation(fmus: dict[str, Path], tmp_path: Path) -> None:
    """An FMU whose network.json is damaged: FMUError with the reason, in a process that lives on."""
    import zipfile

    broken = tmp_path / "sheep.fmu"
    with zipfile.ZipFile(fmus["coarse sheep"]) as source, zipfile.ZipFile(broken, "w") as target:
        for item in source.namelist():
            # other names, or the process would run the intact code that it has seen
            content = source.read(item).replace(b"arterial_", b"broken_00")
            target.writestr(item.replace("arterial_", "broken_00"), b"{" if item.endswith("network.json") else content)
    code = (
        "import gc, sys; from fmu_src.run import *\n"
        "try: run_fmu(sys.argv[1], np.zeros_like, 0.01)\n"
        "except FMUError as error: print(error)\n"
        "gc.collect(); print(run_fmu(sys.argv[2], np.zeros_like, 0.01)['CA.P'][-1])"
    )
    done = run_python(code, os.fspath(broken), os.fspath(fmus["sheep"]), cwd=Path(__file__).parent.parent)
    assert (done.returncode, done.stderr) == (0, "")
    reason, answer = done.stdout.splitlines()
    assert "network.json: not the one of this FMU (Expecting property name" in reason
    assert reason.endswith("build the FMU anew.")
    assert float(answer) == 0.0


def run_python(code: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=cwd)


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
