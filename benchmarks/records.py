"""Reading and aligning a large record: seconds and memory, each in a process of its own.

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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from fitting.records import write_record
from solver.files import write_whole

PERIOD, STEP = 0.4724, 0.005
KINDS = {"P": (11e3, 2e3, "mmHg"), "Q": (2e-5, 1e-5, "mL/s"), "R": (9e-3, 1e-4, "mm")}


@dataclass(frozen=True)
class Row:
    """One measurement: what, its value and unit, and the target where there is one."""

    what: str
    value: float
    unit: str
    target: float | None = None


def make(path: Path, samples: int, channels: int) -> None:
    """Write the synthetic record."""
    rng = np.random.default_rng(0)
    time_ = np.arange(samples) * STEP
    k = np.arange(1, 9)
    values, units = {}, {}
    for i in range(channels):
        letter = "PQR"[i % 3]
        middle, size, units[name := f"S{i // 3}.{letter}"] = KINDS[letter]
        wave = sum(np.cos(2 * np.pi * n * time_ / PERIOD + rng.uniform(0, 6)) / n for n in k)
        values[name] = middle + size * (wave + 0.02 * rng.standard_normal(samples))
    write_record(path, time_, values, units)


_RUN = """
import json, resource, sys, time
from fitting.beats import align
from fitting.records import read_record
unit = 1024**3 if sys.platform == "darwin" else 1024**2
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
start, busy = time.perf_counter(), time.process_time()
record = read_record(sys.argv[1])
times = [time.perf_counter() - start, time.process_time() - busy, peak()]
start, busy = time.perf_counter(), time.process_time()
beats = align(record)
times += [time.perf_counter() - start, time.process_time() - busy, peak()]
print(json.dumps([*times, beats.T, beats.n_beats]))
"""


def rows(path: Path) -> list[Row]:
    """Load and align in a fresh process, the best of three."""
    runs = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", _RUN, str(path)], capture_output=True, text=True, check=True)
        runs.append(json.loads(done.stdout))
    read, read_busy, read_peak, align, align_busy, align_peak, T, n_beats = (
        min(column) for column in zip(*runs, strict=True)
    )
    return [
        Row("read", read, "s", 5.0),
        Row("read, CPU time of all threads", read_busy, "s"),
        Row("peak memory, read", read_peak, "GB", 4.0),
        Row(f"align {n_beats:.0f} beats", align, "s"),
        Row("align, CPU time of all threads", align_busy, "s"),
        Row("peak memory, aligned", align_peak, "GB", 4.0),
        Row("error of the period", abs(T / PERIOD - 1.0), "-"),
    ]


def main(
    samples: Annotated[int, typer.Option(help="Samples a channel.")] = 1_000_000,
    channels: Annotated[int, typer.Option(help="Channels.")] = 30,
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the rows to this file.")] = None,
) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        start = time.perf_counter()
        make(path, samples, channels)
        made, size = time.perf_counter() - start, path.stat().st_size
        measured = [Row("make and write", made, "s"), Row("file", size / 1e6, "MB"), *rows(path)]
    table = Table(title=f"{samples} samples x {channels} channels; {platform.machine()}, NumPy {np.__version__}")
    for column in ("what", "measured", "target"):
        table.add_column(column, justify="left" if column == "what" else "right")
    for row in measured:
        table.add_row(
            row.what, f"{row.value:.3g} {row.unit}", "" if row.target is None else f"<= {row.target:g} {row.unit}"
        )
    Console(width=100).print(table)
    if json_file is not None:
        write_whole(json_file, json.dumps([asdict(row) for row in measured], indent=1) + "\n")


if __name__ == "__main__":
    typer.run(main)
