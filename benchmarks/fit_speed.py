"""Speed of the fits: one site, a cohort of 77 recordings, a network calibration, and a large record, with its memory.

    python benchmarks/fit_speed.py [--samples N] [--channels M] [--json FILE] [--small]

CPU time of one thread. All recordings are virtual (synthetic), 40 dB of noise. The large record is read, aligned
and fitted in a new process, in seconds of the clock. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import MACHINE, JsonFile, Row, Small, best, show, start
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.cohort.file import read_cohort
from fitting.cohort.fits import MODELS, fit_cohort
from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import Record, read_record, write_record
from fitting.records.virtual import measured
from fitting.wall.site_fit import bootstrap, fit
from fitting.wall.wall_model import model
from solver import load, simulate_periodic

SITES = ("AA", "PD", "MD", "DD", "BT", "CA", "FA")
UNKNOWNS = (
    "all.E",
    "all.phi0",
    "AA.E",
    "CA.E",
    "FA.E",
    "CA.phi0",
    "VA1+VA2+VA3.E",
    "all.outlet.R_t",
    "CA.outlet.R_t",
    "fluid.nu",
)
REPEATS = 9  # of a fit; a third and a sixth of it of the cohort
OFF = {"all.E": 1.1, "CA.phi0": 0.85, "fluid.nu": 1.1}  # truth over start


def site_rows(folder: Path, times: int) -> list[Row]:
    """Reading, aligning and fitting one recording; the cohort."""
    entries = read_cohort(write_cohort(virtual_cohort(1), folder))
    first = entries[0]
    record = read_record(first.record)
    beats = align(record)
    fitted, given = fit(beats, first.site, first.h), model("monotone", "regression")
    return [
        Row("one site: read", 1e3 * best(lambda: read_record(first.record), times), "ms"),
        Row("one site: period and beats", 1e3 * best(lambda: align(record), times), "ms"),
        Row("one site: fit with the γ-loop", 1e3 * best(lambda: fit(beats, first.site, first.h), times), "ms", 20.0),
        Row("one site: with the law given", 1e3 * best(lambda: fit(beats, first.site, first.h, given), times), "ms"),
        Row("one site: bootstrap, 200 replicates", best(lambda: bootstrap(fitted, beats), 1), "s"),
        Row("77 recordings, one model", best(lambda: fit_cohort(entries, ("monotone",)), -(-times // 3)), "s", 3.0),
        Row(f"77 recordings, {len(MODELS)} models", best(lambda: fit_cohort(entries), -(-times // 6)), "s"),
    ]


def network_beats() -> Beats:
    """15 noisy beats of P, Q and R at seven sites and of the inflow, from another network than the start."""
    sheep = load("sheep")
    truth = {f"{s.name}.E": OFF["all.E"] * s.E for s in sheep.segments} | {
        "CA.phi0": OFF["CA.phi0"] * sheep.segment("CA").phi0,
        "fluid.nu": OFF["fluid.nu"] * sheep.fluid.nu,
    }
    beat = simulate_periodic(sheep.with_parameters(truth))
    rng = np.random.default_rng(1)
    names = ["inlet.Q", *(f"{site}.{kind}" for site in SITES for kind in "PQR")]
    channels = {name: measured(np.append(np.tile(beat[name][:-1], 15), beat[name][-1]), rng, 40.0) for name in names}
    return align(Record("virtual", "", np.arange(15 * 500 + 1) * 1e-3, channels))


def calibration_row() -> Row:
    """Ten unknowns from seven sites."""
    beats, sheep = network_beats(), load("sheep")
    results: list[Calibration] = []
    seconds = best(lambda: results.append(calibrate(beats, sheep, UNKNOWNS)), 1)
    found = results[0]
    factor = found.values["PD.E"] / sheep.segment("PD").E / OFF["all.E"]
    note = f"χ²/dof {found.chi2 / found.dof:.2f}, PD.E off by {factor - 1.0:+.1e}, {found.simulations} simulations"
    return Row("network: 10 unknowns, P, Q, R at 7 sites", seconds, "s", 20.0, note)


PERIOD, STEP = 0.4724, 0.005
RELAXATION = 17e-3  # φ0/E [s]
KINDS = {"P": (11e3, 2e3, "mmHg"), "Q": (2e-5, 1e-5, "mL/s"), "R": (9e-3, 1e-4, "mm")}


def write_large(path: Path, samples: int, channels: int) -> None:
    """Write a synthetic record: sites of P, Q and R at 200 Hz with white noise, of a period that is no multiple of the
    sampling step."""
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


def large_rows(path: Path) -> list[Row]:
    """Load, align and fit in a fresh process, the best of three."""
    runs = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", _RUN, str(path)], capture_output=True, text=True, check=True)
        runs.append(json.loads(done.stdout))
    read, read_busy, read_peak, align, align_busy, align_peak, fit, fit_peak, T, n_beats = (
        min(column) for column in zip(*runs, strict=True)
    )
    return [
        Row("large record: read", read, "s", 5.0),
        Row("large record: read, CPU time of all threads", read_busy, "s"),
        Row("large record: peak memory, read", read_peak, "GB", 4.0),
        Row(f"large record: align {n_beats:.0f} beats", align, "s"),
        Row("large record: align, CPU time of all threads", align_busy, "s"),
        Row("large record: peak memory, aligned", align_peak, "GB", 4.0),
        Row("large record: fit one site", fit, "s"),
        Row("large record: peak memory, fitted", fit_peak, "GB", 4.0),
        Row("large record: error of the period", 1e9 * abs(T / PERIOD - 1.0), "ppb"),
    ]


def main(
    samples: Annotated[int, typer.Option(help="Samples of a channel of the large record.")] = 1_000_000,
    channels: Annotated[int, typer.Option(help="Its channels.")] = 30,
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    samples, channels = (20_000, 3) if small else (samples, channels)
    with tempfile.TemporaryDirectory() as folder:
        rows = [*site_rows(Path(folder), 1 if small else REPEATS), calibration_row()]
        path = Path(folder) / "record.csv"
        begun = time.perf_counter()
        write_large(path, samples, channels)
        written = time.perf_counter() - begun
        rows += [
            Row("large record: make and write", written, "s"),
            Row("large record: file", path.stat().st_size / 1e6, "MB"),
            *large_rows(path),
        ]
    show(rows, f"{samples} samples x {channels} channels; {MACHINE}", json_file)


if __name__ == "__main__":
    start(main)
