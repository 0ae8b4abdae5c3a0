"""Speed of the fits: one site, a cohort of 77 recordings, a network calibration; a table, and JSON on request.

    python benchmarks/fit_speed.py [--json FILE] [--small]

CPU time of one thread. All recordings are virtual (synthetic), 40 dB of noise. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.table import MACHINE, JsonFile, Row, Small, best, show, start
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.cohort.file import read_cohort
from fitting.cohort.fits import MODELS, fit_cohort
from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import Record, read_record
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


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [*site_rows(Path(folder), 1 if small else REPEATS), calibration_row()]
    show(rows, MACHINE, json_file)


if __name__ == "__main__":
    start(main)
