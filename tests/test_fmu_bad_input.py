"""Every bad input to an FMU: a failed status, one sentence in the log, and a host that lives on."""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import fmi2Discard, fmi2Fatal
from fmus import MS, run_python

from fmu_src.importer.run import FMUError, run_fmu
from solver import Network, NonPhysicalState, load, simulate
from solver.scheme.model import build
from solver.scheme.step import initial_state, step

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
    "fixed choice": (
        "now",
        [["choose", "network.elastic_law", 1]],
        "network.elastic_law is fixed: set it before initialization ends, or reset the component.",
    ),
    "output": ("now", [["set", "CA.P", 1.0]], "CA.P is an output and cannot be set."),
    "output before": ("before", [["set", "CA.P", 1.0]], "CA.P is an output and cannot be set."),
    "bad choice": (
        "before",
        [["choose", "network.elastic_law", 3]],
        "network.elastic_law = 3: must be 1 (beta) or 2 (regression).",
    ),
    "choice of 0": (
        "before",
        [["choose", "network.viscous_law", 0]],
        "network.viscous_law = 0: must be 1 (quadratic) or 2 (monotone).",
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
        [["choose", "network.elastic_law", 2], ["set", "network.P_0", 1e6], ["initialize"]],
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
    "choice as number": (
        "now",
        [["get", "network.elastic_law"]],
        "network.elastic_law is an Enumeration (Integer); read and set it as such.",
    ),
    "choice as text": (
        "now",
        [["get_text", "network.elastic_law"]],
        "network.elastic_law is an Enumeration (Integer); read and set it as such.",
    ),
    "text for a choice": (
        "now",
        [["write", "inlet.interpolation", "%s %n 100 %"]],
        "inlet.interpolation is an Enumeration (Integer); read and set it as such.",
    ),
    "number as text": ("now", [["get_text", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "integer": ("now", [["get_integer", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "set integer": ("now", [["set_integer", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "boolean": ("now", [["get_boolean", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
    "set boolean": ("now", [["set_boolean", "CA.E"]], "CA.E is a Real variable; read and set it as such."),
}

HOST = r"""
import gc, json, os, sys, tempfile
import fmpy
from fmpy.fmi1 import FMICallException

fmu, cases = sys.argv[1], json.loads(sys.stdin.read())
description = fmpy.read_model_description(fmu)
references = {v.name: v.valueReference for v in description.modelVariables}
unpacked = fmpy.extract(fmu, tempfile.mkdtemp(dir=sys.argv[2]))

class Instance:
    def __init__(self, logging=True):
        self.messages = []
        self.slave = fmpy.instantiate_fmu(
            unpacked, description, fmi_type="CoSimulation", debug_logging=logging,
            logger=lambda e, i, status, c, message: self.messages.append(message.decode()))
    def initialize(self):
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()
    def step(self, t=0.0, h=0.001):
        self.slave.doStep(t, h)
    def set(self, name, value):
        self.slave.setReal([references[name]], [value])
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
            "choose": lambda: s.setInteger(r, [rest[1]]),
            "write": lambda: s.setString(r, [rest[1]]),
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
    )
    reports = {report["case"]: report for report in map(json.loads, done.stdout.splitlines())}
    return Host(done.returncode, done.stderr, reports)


def sentence_of_the_solver(case: str, sheep: Network) -> str:
    """What the solver says to the same mistake."""
    with pytest.raises((ValueError, NonPhysicalState)) as error:
        if case == "large inflow":
            model = build(sheep)
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
        (
            {"start_values": {"network.elastic_law": "it's"}},
            r"network\.elastic_law = \"it's\": must be one of beta, reg",
        ),
        ({"start_values": {"network.elastic_law": 3}}, r"network\.elastic_law = 3: must be one of beta, regression\."),
        ({"stop_time": float("nan")}, r"stop_time = nan s: must be a positive, finite number\."),
        ({"step": 0.0}, r"step = 0\.0 s: must be a positive, finite number\."),
        (
            {"inflow": lambda t: np.zeros(3)},
            r"inflow: for 11 times it gave shape \(3,\); it must give one value",
        ),
        ({"fmu": "nowhere.fmu"}, r"nowhere\.fmu: cannot be read \(No such file or directory\); check the path\."),
        ({"fmu": __file__}, r".*test_fmu_bad_input\.py: not an FMU; build one with arterial-fmu build\."),
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
        "import gc, sys; from fmu_src.importer.run import *\n"
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
