"""Speed of the FMU of the paper's sheep network in a host: a table, and JSON on request.

    python benchmarks/fmu.py [--json FILE] [--small]

CPU time of one thread in a new process, the best of several beats of the half-sine; compared variants run alternately
in one process. Nothing here is asserted: see the tests.
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

from benchmarks.table import JsonFile, Row, Small, show, start
from build_fmu import build
from solver import load

ROUNDS = 4


def rows(rounds: int) -> list[Row]:
    """The cost for a host: start, step, reading of outputs, steps off the grid, saved states."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        fmu = build(load("sheep"), folder)
        built = time.perf_counter() - start
        threads = {f"{name}_NUM_THREADS": "1" for name in ("OPENBLAS", "MKL", "OMP")}
        host = [sys.executable, os.fspath(Path(__file__).with_name("fmu_host.py")), str(fmu), str(rounds)]
        done = subprocess.run(host, capture_output=True, text=True, check=True, env={**os.environ, **threads})
    found = json.loads(done.stdout.splitlines()[-1])
    overhead, grid = found["read"] - found["direct"], found["grid"]
    return [
        Row("build", 1e3 * built, "ms"),
        Row("fresh process, import of fmpy to first step done", 1e3 * found["cold"], "ms", 1000.0, "wall time"),
        Row("doStep of 1 ms", grid, "ms", 0.5),
        Row("doStep and getReal of 40 outputs, over the solver itself", 1e3 * overhead, "us", 30.0),
        Row("setReal, doStep and getReal of 40 outputs without the solver's part", 1e6 * found["around"], "us", 30.0),
        Row("getReal of 40 outputs", 1e6 * found["getReal"], "us"),
        Row("doStep of 1 ms where ports are read", found["ports"], "ms"),
        Row("doStep of 1 ms, smooth", found["smooth"], "ms"),
        *(Row(f"steps of {h} ms, per second against 1 ms", found[h] / grid, "x", 1.5) for h in ("0.7", "1.414", "2.7")),
        Row("steps of 0.3 ms, per second against 1 ms", found["0.3"] / grid, "x"),
        Row("state: save and restore", 1e6 * found["save"], "us", 100.0),
        Row("state: to bytes and back", 1e6 * found["bytes"], "us"),
    ]


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    show(
        rows(1 if small else ROUNDS),
        f"FMU of sheep: {platform.machine()}, Python {platform.python_version()}, one thread",
        json_file,
    )


if __name__ == "__main__":
    start(main)
