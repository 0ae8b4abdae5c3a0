"""From measurements to a checked FMU: virtual animals, fits, their mean parameter set, the FMU run with it.

    python examples/fit_and_check.py [--out dist]

1. Eleven virtual animals (synthetic data; no public recording of the paper's sheep exists), seven arteries each, on the
   bench: pressure and radius with noise, drift and quantisation. Their means are those of Table 1.
2. The wall of each recording is fitted; the means over the animals are a parameter set.
3. ``sheep_nonlinear.fmu`` runs through FMPy with that set as start values, in the elastic law that was fitted, and is
   compared with what the network gives with Table 1 itself under the same law.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from arterial_fmu.cli.terminal.console import sentences
from arterial_fmu.cli.terminal.progress import bar
from build_fmu import build
from fitting.check.fmu_check import CheckReport, check
from fitting.cohort.fits import fit_cohort, read_cohort
from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.pages.check_page import write_check
from fitting.records.read.record import read_record, write_record
from fitting.results.parameter_set import write_set
from solver import Network, load, simulate_periodic

SEED = 1
BEATS = 4  # of the synthetic network record
CHANNELS = ("P", "Q", "R")


@sentences(ValueError, OSError)
def main(
    out: Annotated[Path, typer.Option(file_okay=False, help="Directory for everything that is written.")] = Path(
        "dist"
    ),
) -> None:
    """Fit, build, run, compare."""
    out.mkdir(parents=True, exist_ok=True)
    with bar(False, "virtual animals") as tell:
        cohort_file = write_cohort(virtual_cohort(SEED, exact_means=True), out / "virtual_cohort")
        cohort = fit_cohort(read_cohort(cohort_file), models=("monotone",), progress=tell)
        means = cohort.mean_set()
        write_set(means, out / "means.json")
        write_set(means, out / "means.ssv")

        tell(0.0, "building and running the FMU")
        network = load("sheep_nonlinear")
        fmu = build(network, out)
        law = means.texts["network.elastic_law"]
        record = table1_record(replace(network, elastic_law=law), out / "table1.csv")
        report = check(means, fmu, read_record(record), progress=lambda what: tell(0.5, what))
        page = write_check(report, out / "fit_and_check")
    show(report)
    print(f"{len(cohort.recordings)} virtual recordings fitted; {law} law; wrote {out / 'means.json'} and {page}")


def table1_record(network: Network, path: Path) -> Path:
    """The periodic beat of the network as a synthetic record: inflow, and P, Q, R at every site."""
    beat = simulate_periodic(network)
    names = ["inlet.Q", *(f"{site.name}.{kind}" for site in network.sites for kind in CHANNELS)]
    samples = {name: np.append(np.tile(beat[name][:-1], BEATS), beat[name][-1]) for name in names}
    time = np.arange(len(samples["inlet.Q"])) * (beat.time[1] - beat.time[0])
    write_record(path, time, samples)
    return path


def show(report: CheckReport) -> None:
    """The largest difference of each channel, in per cent of its pulse."""
    table = Table(title="FMU with the fitted means against Table 1: largest difference, % of the pulse")
    table.add_column("site")
    for kind in CHANNELS:
        table.add_column(kind, justify="right")
    largest = {channel.name: channel.largest for channel in report.channels}
    for site in dict.fromkeys(name.rpartition(".")[0] for name in largest):
        table.add_row(site, *(f"{100 * largest[f'{site}.{kind}']:.3f}" for kind in CHANNELS))
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
