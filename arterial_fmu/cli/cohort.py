"""The commands ``virtual`` and ``cohort``: synthetic records of many animals, and the fits of many subjects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from arterial_fmu.cli.terminal.console import conclude, put, say, say_written, sentences, show
from arterial_fmu.cli.terminal.options import Json, Quiet
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.cohort.file import read_cohort
from solver import NonPhysicalState, NotPeriodic
from solver.io.writing import check_destinations

from .terminal import record_options as options


def virtual_command(
    out: Annotated[Path, typer.Option(help="Folder for the records and cohort.csv.")],
    animals: Annotated[int, typer.Option(help="Number of animals.")] = 11,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 1,
    dB: Annotated[float, typer.Option("--dB", help="Noise: 40 dB is 1 % of the pulsatile standard deviation.")] = 40.0,
    exact_means: Annotated[
        bool, typer.Option("--exact-means", help="Scale the animals so that their means are the paper's.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a cohort of virtual animals: synthetic records with the paper's mean walls and a stated spread."""
    with sentences():
        check_destinations(out / "cohort.csv", folders=True)
    from fitting.cohort.virtual import virtual_cohort, write_cohort

    with sentences(), bar(quiet, pace=PACE) as progress:
        progress(0.0, "making virtual animals")
        made = virtual_cohort(seed, animals=animals, dB=dB, exact_means=exact_means)
        write_cohort(made, out, progress)
    if as_json:
        put({"written": [str(out / "cohort.csv"), *map(str, sorted(out.glob("virtual-*.csv")))]})
    elif not quiet:
        say_written(out / "cohort.csv")
        say(f"and the recordings that it lists, {len(list(out.glob('virtual-*.csv')))} files")


def cohort_command(
    cohort: Annotated[
        Path,
        typer.Argument(is_eager=True, help="CSV with animal (or subject, patient), site, record, h [mm], R0 [mm]."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    mapped: options.Mapped = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    law: options.Law = None,
    jobs: Annotated[int, typer.Option(help="Parallel processes.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask cluster: tcp://host:8786.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit many subjects at many sites; report means and spread, and test the paper's claims."""
    with sentences():
        check_destinations(out / "cohort.json", given=[cohort], folders=True)
        entries, how = read_cohort(cohort), options.reading([], mapped, decimal)
    from fitting.cohort import report
    from fitting.cohort.fits import fit_cohort

    from .tables.cohort import tables

    with sentences(NonPhysicalState, NotPeriodic), bar(quiet, pace=PACE) as progress:
        found = fit_cohort(
            entries, elastic=law, reading=how, as_measured=as_measured, jobs=jobs, scheduler=scheduler,
            progress=progress,
        )  # fmt: skip
        written = report.write(found, out)
    conclude(as_json, quiet, lambda: report.to_json(found), lambda: show(*tables(found)), written=written)
