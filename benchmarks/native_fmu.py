"""The FMU that needs no Python, from a host in C (native_fmu.c): CPU time of a step, cold start, memory, size.

    python benchmarks/native_fmu.py [--json FILE] [--small]

Steps of 1 ms with the inflow set and 40 outputs read, and a cold start from loading the library to the end of the first
step; beside it the pythonfmu FMU from a host in Python, in the same run. Then steps of heart and body, both kinds of
FMU alternating in a host in Python. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import fmpy
import numpy as np

from benchmarks.fmu import MS, READ, Host
from benchmarks.table import JsonFile, Row, Small, show, start
from build_fmu import build, build_model, build_native, build_native_model
from fmu_src.contents.models import body_model, heart_model
from solver import load
from solver.errors import InputError

HOST = Path(__file__).with_suffix(".c")
INFLOW = (55e-6 * np.maximum(0.0, np.sin(2 * np.pi * np.arange(1, 501) * MS / 0.5))).tolist()  # of steps [m³/s]


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        print("Nothing to measure: no C compiler for the host.")
        return
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as folder:
        host = Path(folder) / "host"
        subprocess.run([compiler, "-O2", "-D_GNU_SOURCE", HOST, "-o", host, "-ldl", "-lm"], check=True)
        for name in ("sheep",) if small else ("sheep", "human", "adan56"):
            try:
                fmu = build_native(load(name), Path(folder) / "native")
            except InputError as reason:
                print(f"Nothing to measure: {reason}")
                return
            cold, step, memory = measured(fmu, host, 200 if small else 20_000, 1 if small else 5)
            beside = Host(build(load(name), Path(folder) / "python"))
            beside.begin("linear")
            other = beside.steps(INFLOW[: 20 if small else None], MS, beside.outputs)
            note = f"pythonfmu FMU from a host in Python {1e6 * other:.0f} us, x {other / step:.0f}"
            rows += [
                Row(f"{name}: doStep of 1 ms, {READ} outputs read", 1e6 * step, "us", 30.0, note),
                Row(f"{name}: cold start to the first step", 1e3 * cold, "ms", 20.0),
                Row(f"{name}: memory of an instance", 1e-6 * memory, "MB", 5.0),
                Row(f"{name}: file, one platform", 1e-6 * fmu.stat().st_size, "MB", 0.4),
            ]
        for kind, make in (("heart", heart_model), ("body", body_model)):
            fmu = build_native_model(make("human", None, 2), Path(folder) / "native")
            python, native = turns([build_model(make(), Path(folder) / "python"), fmu], 20 if small else 3000)
            note = f"pythonfmu FMU from the same host {1e6 * python:.1f} us, x {python / native:.0f}"
            rows += [
                Row(f"human {kind}: doStep of 1 ms, host in Python", 1e6 * native, "us", None, note),
                Row(f"human {kind}: file, one platform", 1e-6 * fmu.stat().st_size, "MB", 0.4),
            ]
    show(rows, "FMU without Python, from a host in C, one thread", json_file)


def measured(fmu: Path, host: Path, steps: int, times: int) -> tuple[float, float, float]:
    """CPU seconds of a cold start and of a step, and bytes of an instance: the least of some runs."""
    folder, description = Path(fmpy.extract(os.fspath(fmu))), fmpy.read_model_description(os.fspath(fmu))
    vr = {v.name: v.valueReference for v in description.modelVariables}
    outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"][:READ]
    library = next((folder / "binaries").rglob("*.so"))
    numbers = [steps, vr["inlet.Q"], vr["inlet.interpolation"], *outputs]
    line = [host, library, description.guid, folder / "resources", *map(str, numbers)]
    found = [subprocess.run(line, check=True, capture_output=True, text=True).stdout.split() for _ in range(times)]
    shutil.rmtree(folder)
    cold, step, memory = np.array(found, float).min(axis=0)
    return float(cold), float(step), float(memory)


def turns(fmus: Sequence[Path], steps: int) -> list[float]:
    """CPU seconds of a step of each heart or body: the least of ten blocks of steps, by turns."""
    hosts = [Host(fmu) for fmu in fmus]
    for host in hosts:
        host.begin()
    found = np.empty((10, len(fmus)))
    for block in range(len(found)):
        for k, host in enumerate(hosts):
            start = time.process_time()
            for i in range(block * steps // 10, (block + 1) * steps // 10):
                host.slave.doStep(i * MS, MS)
            found[block, k] = (time.process_time() - start) / (steps // 10)
    return [float(x) for x in found.min(axis=0)]


if __name__ == "__main__":
    start(main)
