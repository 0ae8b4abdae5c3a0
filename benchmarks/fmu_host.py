"""The measurements of benchmarks/fmu.py on an FMU of the sheep network, in a new process; JSON on standard output."""

from __future__ import annotations

import time

BEGAN = time.perf_counter()

import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

import fmpy

T, MS = 0.5, 1e-3
KINDS = {"hold": 1, "linear": 2, "smooth": 3}


class Host:
    """One instance of the FMU."""

    def __init__(self, fmu: str) -> None:
        folder, description = fmpy.extract(fmu), fmpy.read_model_description(fmu)
        self.of = {v.name: v.valueReference for v in description.modelVariables}
        self.slave: Any = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
        self.begin("linear")

    def begin(self, interpolation: str) -> None:
        self.slave.setupExperiment(startTime=0.0)
        self.slave.setInteger([self.of["inlet.interpolation"]], [KINDS[interpolation]])
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def step(self, t: float, h: float, Q: float) -> None:
        self.slave.setReal([self.of["inlet.Q"]], [Q])
        self.slave.doStep(t, h)


HOST, ROUNDS = Host(sys.argv[1]), int(sys.argv[2])
HOST.step(0.0, MS, 1e-6)
COLD = time.perf_counter() - BEGAN

import numpy as np

from solver import load
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import initial_state, step

SHEEP = load("sheep")
SIGNALS = [HOST.of[name] for name in SHEEP.output_units()][1:]  # 40
PORTS = [HOST.of[f"{end}.{key}"] for end in ("inlet", "CA.outlet") for key in ("P_0", "Z")]


def beat(interpolation: str, h: float, read: Sequence[int] = ()) -> float:
    """CPU seconds of the FMU per simulated second, over the second beat."""
    HOST.slave.reset()
    HOST.begin(interpolation)
    n, start = round(T / h), 0.0
    Q = SHEEP.inlet.Q(np.arange(2 * n + 2) * h).tolist()
    for i in range(2 * n):
        if i == n:
            start = time.process_time()
        HOST.step(i * h, h, Q[i if interpolation == "smooth" else i + 1])
        if read:
            HOST.slave.getReal(read)
    return (time.process_time() - start) / (n * h)


def direct() -> float:
    """The same of the solver, at 1 ms, all outputs reported."""
    model = build(SHEEP)
    report, state, start = reporter(model), initial_state(model), 0.0
    inflow = SHEEP.inlet.Q((np.arange(1000)[:, None] + INFLOW_TIMES) * MS)
    for i in range(1000):
        if i == 500:
            start = time.process_time()
        state = step(model, state, MS, inflow[i])
        report(state)
    return (time.process_time() - start) / T


def around() -> float:
    """CPU seconds of setReal, doStep and getReal of 40 outputs, least of many, with the scheme's step and its report
    left out: what FMPy, the wrapper and the slave add, which a difference of two long runs cannot tell on a busy
    machine."""
    HOST.slave.reset()
    HOST.begin("linear")
    model = build(SHEEP)
    report, state = reporter(model), initial_state(model)
    inside: Any = next(m for name, m in sys.modules.items() if name.endswith("fmu_src.cosimulation.stretch"))
    taken, inside.parts = inside.parts, lambda model, state, *_: (state,)
    times: dict[str, list[float]] = {"calls": [], "report": []}
    for i in range(2500 * ROUNDS):
        start = time.perf_counter()
        HOST.step(i * MS, MS, 1e-6)
        HOST.slave.getReal(SIGNALS)
        times["calls"].append(time.perf_counter() - start)
        start = time.perf_counter()
        report(state)[0].tolist()
        times["report"].append(time.perf_counter() - start)
    inside.parts = taken
    return float(np.quantile(times["calls"], 0.1) - np.quantile(times["report"], 0.1))


def save() -> None:
    """Save a state, restore it, free it."""
    state = HOST.slave.getFMUState()
    HOST.slave.setFMUState(state)
    HOST.slave.freeFMUState(state)


def per_call(call: Callable[[], object], n: int) -> float:
    """CPU seconds."""
    start = time.process_time()
    for _ in range(n):
        call()
    return (time.process_time() - start) / n


CASES: dict[str, Callable[[], float]] = {
    "direct": direct,
    "grid": lambda: beat("linear", MS),
    "read": lambda: beat("linear", MS, SIGNALS),
    "ports": lambda: beat("linear", MS, PORTS),
    "smooth": lambda: beat("smooth", MS),
    "0.7": lambda: beat("linear", 0.7 * MS),
    "1.414": lambda: beat("linear", 1.414 * MS),
    "2.7": lambda: beat("linear", 2.7 * MS),
    "0.3": lambda: beat("linear", 0.3 * MS),
}
found: dict[str, float] = {}
for _ in range(ROUNDS):
    for name, case in CASES.items():
        found[name] = min(case(), found.get(name, np.inf))
saved = HOST.slave.getFMUState()
found |= {
    "cold": COLD,
    "around": around(),
    "getReal": per_call(lambda: HOST.slave.getReal(SIGNALS), 1000),
    "save": per_call(save, 1000),
    "bytes": per_call(lambda: HOST.slave.deSerializeFMUstate(HOST.slave.serializeFMUState(saved)), 100),
}
print(json.dumps(found))
