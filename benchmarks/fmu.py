"""Speed of the FMU of the paper's sheep network in a host: a table, and JSON on request.

    python benchmarks/fmu.py [--json FILE]

CPU time of one thread in a fresh process, the best of several beats of the half-sine; what is compared runs in turns in
one process. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.table import Row, show
from build_fmu import build
from solver import load

_HOST = """
import time
start = time.perf_counter()
import json, sys
import fmpy
folder, description = fmpy.extract(sys.argv[1]), fmpy.read_model_description(sys.argv[1])
of = {v.name: v.valueReference for v in description.modelVariables}
slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")

def begin(interpolation):
    slave.setupExperiment(startTime=0.0)
    slave.setInteger([of["inlet.interpolation"]], [{"hold": 1, "linear": 2, "smooth": 3}[interpolation]])
    slave.enterInitializationMode()
    slave.exitInitializationMode()

begin("linear")
slave.setReal([of["inlet.Q"]], [1e-6])
slave.doStep(0.0, 1e-3)
cold = time.perf_counter() - start

import numpy as np
from solver import load
from solver.outputs import reporter
from solver.scheme.model import build
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import initial_state, step

sheep = load("sheep")
outputs = [of[name] for name in sheep.output_units()][1:]
ports = [value for name, value in of.items() if name.endswith((".P_0", ".Z", ".Z_0")) and name != "network.P_0"]

def beat(interpolation, h, read):
    "CPU seconds of a beat, the second one"
    slave.reset()
    begin(interpolation)
    n = round(0.5 / h)
    Q = [float(q) for q in sheep.inlet.Q(np.arange(2 * n + 2) * h)]
    for i in range(2 * n):
        if i == n:
            start = time.process_time()
        slave.setReal([of["inlet.Q"]], [Q[i + (interpolation != "smooth")]])
        slave.doStep(i * h, h)
        if read:
            slave.getReal(read)
    return (time.process_time() - start) / (n * h)

def direct():
    model = build(sheep)
    report, state = reporter(model), initial_state(model)
    Q = sheep.inlet.Q((np.arange(1000)[:, None] + INFLOW_TIMES) * 1e-3)
    for i in range(1000):
        if i == 500:
            start = time.process_time()
        state = step(model, state, 1e-3, Q[i])
        report(state)
    return (time.process_time() - start) / 0.5

cases = {
    "direct": direct,
    "grid": lambda: beat("linear", 1e-3, None),
    "read": lambda: beat("linear", 1e-3, outputs),
    "ports": lambda: beat("linear", 1e-3, ports),
    "smooth": lambda: beat("smooth", 1e-3, None),
    "0.7": lambda: beat("linear", 0.7e-3, None),
    "1.414": lambda: beat("linear", 1.414e-3, None),
    "2.7": lambda: beat("linear", 2.7e-3, None),
    "0.3": lambda: beat("linear", 0.3e-3, None),
}
seconds = {}
for _ in range(4):
    for name, case in cases.items():
        seconds[name] = min(case(), seconds.get(name, 9e9))

def per_call(call, n=1000):
    start = time.process_time()
    for _ in range(n):
        call()
    return (time.process_time() - start) / n

def save():
    state = slave.getFMUState()
    slave.setFMUState(state)
    slave.freeFMUState(state)

state = slave.getFMUState()
calls = {
    "getReal": per_call(lambda: slave.getReal(outputs)),
    "save": per_call(save),
    "serialize": per_call(lambda: slave.deSerializeFMUstate(slave.serializeFMUState(state)), 100),
}
print(json.dumps({"cold": cold, "outputs": len(outputs), "port variables": len(ports)} | seconds | calls))
"""


def rows() -> list[Row]:
    """What a host pays: at the start, per step, for what it reads, off the grid, for a saved state."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        fmu = build(load("sheep"), folder)
        built = time.perf_counter() - start
        threads = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
        host = [sys.executable, "-c", _HOST, str(fmu)]
        done = subprocess.run(host, capture_output=True, text=True, check=True, env={**os.environ, **threads})
    found = json.loads(done.stdout.splitlines()[-1])
    overhead, grid = found["read"] - found["direct"], found["grid"]
    return [
        Row("build", 1e3 * built, "ms"),
        Row("fresh process, import of fmpy to first step done", 1e3 * found["cold"], "ms", 1000.0, "wall time"),
        Row("doStep of 1 ms", grid, "ms", 0.5),
        Row(f"{found['outputs']} outputs read: over the solver itself, a step", 1e3 * overhead, "us", 30.0),
        Row(f"getReal of {found['outputs']} outputs", 1e6 * found["getReal"], "us"),
        Row(f"{found['port variables']} port variables read, a step", found["ports"], "ms"),
        Row("inlet.interpolation smooth, a step", found["smooth"], "ms"),
        *(Row(f"steps of {h} ms, per second against 1 ms", found[h] / grid, "x", 1.5) for h in ("0.7", "1.414", "2.7")),
        Row("steps of 0.3 ms, per second against 1 ms", found["0.3"] / grid, "x"),
        Row("state: save and restore", 1e6 * found["save"], "us", 100.0),
        Row("state: to bytes and back", 1e6 * found["serialize"], "us"),
    ]


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the rows to this file.")] = None,
) -> None:
    """Measure and print."""
    show(rows(), f"FMU of sheep: {platform.machine()}, Python {platform.python_version()}, one thread", json_file)


if __name__ == "__main__":
    typer.run(main)
