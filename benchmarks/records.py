"""Reading, aligning and fitting a large record: seconds and memory, in a new process.

    python benchmarks/records.py [--samples N] [--channels M] [--json FILE]

The record is synthetic: ten sites of P, Q and R at 200 Hz with white noise, of a period that is no multiple of the
sampling step. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import JsonFile, Row, show, start
from fitting.records.read.record import write_record

PERIOD, STEP = 0.4724, 0.005
RELAXATION = 17e-3  # φ0/E [s]
KINDS = {"P": (11e3, 2e3, "mmHg"), "Q": (2e-5, 1e-5, "mL/s"), "R": (9e-3, 1e-4, "mm")}


def make(path: Path, samples: int, channels: int) -> None:
    """Write the synthetic record."""
    rng = np.random.default_rng(0)
    time_ = np.arange(samples) * STEP
    k = np.arange(1, 9)
    values, units = {}, {}
    for i in range(channels):
        letter = "PQR"[i % 3]
        middle, size, units[name := f"S{i // 3}.{letter}"] = KINDS[letter]
        if letter == "P":
            phases = rng.uniform(0, 6, len(k))
        # the radius follows the pressure of its site as a Kelvin–Voigt wall does
        delay = np.arctan(2 * np.pi * k / PERIOD * RELAXATION) if letter == "R" else 0.0 * k
        terms = zip(k, phases, delay, strict=True)
        wave = sum(np.cos(d) * np.cos(2 * np.pi * n * time_ / PERIOD + p - d) / n for n, p, d in terms)
        values[name] = middle + size * (wave + 0.02 * rng.standard_normal(samples))
    write_record(path, time_, values, units)


_RUN = """
import json, resource, sys, time
from fitting.records.alignment.align import align
from fitting.records.read.record import read_record
from fitting.wall.site_fit import fit
unit = 1024**3 if sys.platform == "darwin" else 1024**2
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
start, busy = time.perf_counter(), time.process_time()
record = read_record(sys.argv[1])
times = [time.perf_counter() - start, time.process_time() - busy, peak()]
start, busy = time.perf_counter(), time.process_time()
beats = align(record)
times += [time.perf_counter() - start, time.process_time() - busy, peak()]
start = time.perf_counter()
fit(beats, "S0", 1e-3, "linear")
times += [time.perf_counter() - start, peak()]
print(json.dumps([*times, beats.T, beats.n_beats]))
"""


def rows(path: Path) -> list[Row]:
    """Load, align and fit in a fresh process, the best of three."""
    runs = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", _RUN, str(path)], capture_output=True, text=True, check=True)
        runs.append(json.loads(done.stdout))
    read, read_busy, read_peak, align, align_busy, align_peak, fit, fit_peak, T, n_beats = (
        min(column) for column in zip(*runs, strict=True)
    )
    return [
        Row("read", read, "s", 5.0),
        Row("read, CPU time of all threads", read_busy, "s"),
        Row("peak memory, read", read_peak, "GB", 4.0),
        Row(f"align {n_beats:.0f} beats", align, "s"),
        Row("align, CPU time of all threads", align_busy, "s"),
        Row("peak memory, aligned", align_peak, "GB", 4.0),
        Row("fit one site", fit, "s"),
        Row("peak memory, fitted", fit_peak, "GB", 4.0),
        Row("error of the period", 1e9 * abs(T / PERIOD - 1.0), "ppb"),
    ]


def main(
    samples: Annotated[int, typer.Option(help="Samples a channel.")] = 1_000_000,
    channels: Annotated[int, typer.Option(help="Channels.")] = 30,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        start = time.perf_counter()
        make(path, samples, channels)
        made, size = time.perf_counter() - start, path.stat().st_size
        measured = [Row("make and write", made, "s"), Row("file", size / 1e6, "MB"), *rows(path)]
    title = f"{samples} samples x {channels} channels; {platform.machine()}, NumPy {np.__version__}"
    show(measured, title, json_file)


if __name__ == "__main__":
    start(main)
