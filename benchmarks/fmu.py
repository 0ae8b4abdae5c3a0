"""Speed of the FMU of the paper's sheep network in a host: a table, and JSON on request.

    python benchmarks/fmu.py [--json FILE] [--small]

CPU time of one thread, the best of several beats of the half-sine; compared variants run alternately. A cold start is
that of a new process. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from benchmarks.speed import SHEEP, beats
from benchmarks.table import JsonFile, Row, Small, best, show, start
from build_fmu import build
from fmu_src.variables.arteries_variables import INTERPOLATIONS
from solver import Settings
from solver.scheme.model import build as built
from solver.scheme.outputs import reporter
from solver.scheme.step import initial_state

ROUNDS = 4
MS = 1e-3
READ = 40  # outputs
_COLD = """
import time
began = time.perf_counter()
import sys, fmpy
folder, description = fmpy.extract(sys.argv[1]), fmpy.read_model_description(sys.argv[1])
slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
slave.setupExperiment(startTime=0.0)
slave.enterInitializationMode()
slave.exitInitializationMode()
slave.doStep(0.0, 1e-3)
print(time.perf_counter() - began)
"""


class Host:
    """One instance of an FMU. of : its variables by name. outputs : the first of them, which are read."""

    def __init__(self, fmu: Path) -> None:
        folder, description = fmpy.extract(os.fspath(fmu)), fmpy.read_model_description(os.fspath(fmu))
        self.of = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"][:READ]
        self.slave: Any = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")

    def begin(self, interpolation: str = "") -> None:
        """To the first step; of arteries with this interpolation."""
        self.slave.setupExperiment(startTime=0.0)
        if interpolation:
            self.slave.setInteger([self.of["inlet.interpolation"]], [INTERPOLATIONS.index(interpolation) + 1])
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def step(self, t: float, h: float, Q: float) -> None:
        self.slave.setReal([self.of["inlet.Q"]], [Q])
        self.slave.doStep(t, h)

    def steps(self, Q: Sequence[float], h: float, read: Sequence[int] = (), skipped: int = 0) -> float:
        """CPU seconds of a step, after those that are skipped."""
        began = time.process_time()
        for i, q in enumerate(Q):
            if i == skipped:
                began = time.process_time()
            self.step(i * h, h, q)
            if read:
                self.slave.getReal(read)
        return (time.process_time() - began) / (len(Q) - skipped)

    def beat(self, interpolation: str, h: float, read: Sequence[int] = ()) -> float:
        """CPU seconds per simulated second, over the second beat of the sheep."""
        self.slave.reset()
        self.begin(interpolation)
        n, first = round(SHEEP.inlet.T / h), 0 if interpolation == "smooth" else 1
        return self.steps(SHEEP.inlet.Q(np.arange(first, 2 * n + first) * h).tolist(), h, read, n) / h

    def around(self, steps: int) -> float:
        """Seconds of setReal, doStep and getReal of the outputs, least of many, with the scheme's step and its report
        left out: what FMPy, the wrapper and the slave add, which a difference of two long runs cannot tell on a busy
        machine."""
        self.slave.reset()
        self.begin("linear")
        model = built(SHEEP)
        report, state = reporter(model), initial_state(model)
        inside: Any = next(
            module for name, module in sys.modules.items()
            if name.startswith("_arterial_") and name.endswith("fmu_src.cosimulation.communication_step")
        )  # fmt: skip
        taken, inside.parts = inside.parts, lambda model, state, *_: (state,)
        times = np.empty((steps, 3))
        for i in range(steps):
            times[i, 0] = time.perf_counter()
            self.step(i * MS, MS, 1e-6)
            self.slave.getReal(self.outputs)
            times[i, 1] = time.perf_counter()
            report(state)[0].tolist()
            times[i, 2] = time.perf_counter()
        inside.parts = taken
        calls, reports = np.quantile(np.diff(times), 0.1, axis=0)
        return float(calls - reports)

    def save(self) -> None:
        """Save a state, restore it, free it."""
        state = self.slave.getFMUState()
        self.slave.setFMUState(state)
        self.slave.freeFMUState(state)


def rows(rounds: int) -> list[Row]:
    """The cost for a host: start, step, reading of outputs, steps off the grid, saved states."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        fmu = build(SHEEP, folder)
        seconds = time.perf_counter() - began
        line = [sys.executable, "-c", _COLD, str(fmu)]
        cold = float(subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()[-1])
        host = Host(fmu)
    host.begin("linear")
    ports = [host.of[f"{end}.{key}"] for end in ("inlet", "CA.outlet") for key in ("P_0", "Z")]
    cases: dict[str, Callable[[], float]] = {
        "direct": lambda: beats(None, Settings(), 2)[0][1] / SHEEP.inlet.T,
        "grid": lambda: host.beat("linear", MS),
        "read": lambda: host.beat("linear", MS, host.outputs),
        "ports": lambda: host.beat("linear", MS, ports),
        "smooth": lambda: host.beat("smooth", MS),
        "0.7": lambda: host.beat("linear", 0.7 * MS),
        "1.414": lambda: host.beat("linear", 1.414 * MS),
        "2.7": lambda: host.beat("linear", 2.7 * MS),
        "0.3": lambda: host.beat("linear", 0.3 * MS),
    }
    turns = [[case() for case in cases.values()] for _ in range(rounds)]
    found = dict(zip(cases, np.min(turns, axis=0).tolist(), strict=True))
    overhead, grid, saved = found["read"] - found["direct"], found["grid"], host.slave.getFMUState()
    around = host.around(2500 * rounds)
    get = best(lambda: host.slave.getReal(host.outputs), 1000)
    to_bytes = best(lambda: host.slave.deSerializeFMUstate(host.slave.serializeFMUState(saved)), 100)
    return [
        Row("build", 1e3 * seconds, "ms"),
        Row("fresh process, import of fmpy to first step done", 1e3 * cold, "ms", 1000.0, "wall time"),
        Row("doStep of 1 ms", grid, "ms", 0.5),
        Row("doStep and getReal of 40 outputs, over the solver itself", 1e3 * overhead, "us", 30.0),
        Row("setReal, doStep and getReal of 40 outputs without the solver's part", 1e6 * around, "us", 30.0),
        Row("getReal of 40 outputs", 1e6 * get, "us"),
        Row("doStep of 1 ms where ports are read", found["ports"], "ms"),
        Row("doStep of 1 ms, smooth", found["smooth"], "ms"),
        *(Row(f"steps of {h} ms, per second against 1 ms", found[h] / grid, "x", 1.5) for h in ("0.7", "1.414", "2.7")),
        Row("steps of 0.3 ms, per second against 1 ms", found["0.3"] / grid, "x"),
        Row("state: save and restore", 1e6 * best(host.save, 1000), "us", 100.0),
        Row("state: to bytes and back", 1e6 * to_bytes, "us"),
    ]


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    title = f"FMU of sheep: {platform.machine()}, Python {platform.python_version()}, one thread"
    show(rows(1 if small else ROUNDS), title, json_file)


if __name__ == "__main__":
    start(main)
