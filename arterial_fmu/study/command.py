"""The command ``arterial-fmu study``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from arterial_fmu.cli.terminal.console import conclude, right, sentences, show
from arterial_fmu.cli.terminal.options import Json, Quiet, networks_for
from arterial_fmu.cli.terminal.progress import PACE, bar
from arterial_fmu.cli.terminal.record_options import AsMeasured, Decimal, Mapped, Part, check_parts
from fitting.records.read.columns import Reading
from fitting.results.result_files import plain
from solver.errors import InputError
from solver.io.writing import check_destinations
from solver.quantities.legible import DASH, significant
from solver.quantities.units import readable

from .models import read_model
from .outcome import Study, summary
from .plan import Plan, plan_of
from .report import WRITTEN, write
from .store import Store, run
from .varied import parse_varied

SHOWN = 3  # parameters of a number in the table


def main(
    model: Annotated[
        str,
        typer.Argument(
            help="A bundled network, a network file (TOML), or an FMU.", metavar="NETWORK", autocompletion=networks_for
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results; finished batches in it are not repeated.")],
    vary: Annotated[
        list[str] | None,
        typer.Option(help='A range: "CA.phi0=10..120kPa*s", or factors of the file\'s values: "all.E=0.8..1.2x".'),
    ] = None,
    samples: Annotated[
        int, typer.Option(help="Maximum number of parameter sets, N (D + 2) with N a power of two.")
    ] = 1024,
    seed: Annotated[int, typer.Option(help="Seed of the sequence.")] = 1,
    sites: Annotated[str | None, typer.Option(help="Sites of the results: MD,CA. Default: all sites.")] = None,
    inflow: Annotated[
        str | None,
        typer.Option(help="Source of the inflow: a network, or a record with inlet.Q. An FMU needs it."),
    ] = None,
    mapped: Mapped = None,
    decimal: Decimal = None,
    part: Part = None,
    as_measured: AsMeasured = False,
    dt: Annotated[str, typer.Option(help="Time step; an FMU has its own.")] = "2.5 ms",
    element_length: Annotated[
        str | None,
        typer.Option(help="Maximum element length. Default: 5 cm, in viscous walls 10 cm in steps of 2.5 ms."),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Maximum relative change between beats of a periodic solution.")
    ] = 1e-4,
    jobs: Annotated[int | None, typer.Option(help="Parallel processes; default: one per available core.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask cluster, in place of --jobs: tcp://host:8786.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Vary parameters, and show which of them matter where, and by how much.

    Simulates thousands of parameter sets (a scrambled Sobol' sequence), each until its beat repeats. Writes first-order
    and total indices of pressures, flows and radii, percentiles of waveforms, and one HTML page.
    """
    with sentences(interrupted=f"finished batches are in {out}; the same command resumes there."):
        with bar(quiet, pace=PACE) as progress:
            progress(0.0, "reading")
            check_destinations(*(out / n for n in ("plan.json", *WRITTEN)), given=[model, inflow], folders=True)
            how = Reading.from_options(mapped, decimal, parts=part)
            if part and not inflow:
                raise InputError(f'--part "{part[0]}": is of the record of --inflow, and none is given; leave it out.')
            check_parts(how, [Path(inflow)] if inflow else [])
            studied = read_model(model, inflow, dt, element_length, tolerance, how, as_measured)
            varied = parse_varied(vary or [], studied.known, studied.nominal, studied.name)
            plan = plan_of(studied, varied, samples, seed, sites)
            if jobs is not None and jobs < 1:
                raise InputError(f"--jobs = {jobs}: must be a whole number of processes, at least 1.")
            store = Store(out, plan)
            run(plan, store, jobs=jobs, scheduler=scheduler, progress=progress, meanwhile=_imported)
            progress(1.0, "indices and figures")
            study = Study.of(store)
            paths = write(study, out)
    notes = (_size(plan, samples), *study.notes)
    conclude(as_json, quiet, lambda: plain(summary(study)), lambda: show(_table(study)), notes, paths)


def _imported() -> None:
    """Import the modules for indices and figures, a second on one core."""
    import SALib.analyze.sobol  # noqa: F401

    from . import figures  # noqa: F401


def _size(plan: Plan, samples: int) -> str:
    D = len(plan.varied)
    return f"{plan.size} parameter sets of the {samples} allowed: N (D + 2) with N = {plan.base} and D = {D}."


def _table(study: Study) -> Table:
    """The percentiles of every number, and its most important parameters."""
    title = f"{study.plan.model.name}: {study.plan.size} parameter sets"
    table = Table("number", *map(right, ("unit", "5 %", "median", "95 %")), "total indices ± half of 95 %", title=title)
    for name, unit in study.plan.measures.items():
        text, factor = readable(unit)
        low, _, middle, _, high = (significant(factor * value) for value in study.found.percentiles[name])
        most: list[Any] = sorted(study.indices(name), key=lambda each: -each.ST)[:SHOWN]
        contributions = (f"{each.varied} {each.total.replace(' ', '')}" for each in most)
        table.add_row(name, text, low, middle, high, ", ".join(contributions) or DASH)
    return table
