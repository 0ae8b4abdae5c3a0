"""The commands ``virtual`` and ``cohort``: synthetic records of many animals, and the fits of many subjects."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.table import Table

from arterial_fmu.cli.terminal.console import conclude, put, right, say, say_written, sentences, show
from arterial_fmu.cli.terminal.options import Json, Quiet
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.cohort.file import read_cohort
from solver import NonPhysicalState, NotPeriodic
from solver.io.writing import check_destinations
from solver.quantities.legible import DASH, number, plus_minus

from .terminal import record_options as options

if TYPE_CHECKING:
    from fitting.cohort.fits import Cohort, Summary

# heading, quantity, factor from SI
_SHOWN = (
    ("E_inc, MPa", "E_inc", 1e-6),
    ("E, MPa", "E", 1e-6),
    ("φ0, kPa·s", "phi0", 1e-3),
    ("φ0/E, ms", "phi0/E", 1e3),
    ("φNL/φ0, s", "phiNL/phi0", 1.0),
    ("R0, mm", "R0", 1e3),
    ("R0 measured,\nmm", "R0 measured", 1e3),
)


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

    with sentences(NonPhysicalState, NotPeriodic), bar(quiet, pace=PACE) as progress:
        found = fit_cohort(
            entries, elastic=law, reading=how, as_measured=as_measured, jobs=jobs, scheduler=scheduler,
            progress=progress,
        )  # fmt: skip
        written = report.write(found, out)
    conclude(as_json, quiet, lambda: report.to_json(found), lambda: show(*tables(found)), written=written)


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(cohort: Cohort) -> list[RenderableType]:
    """Means ± standard deviations of the main model by site, the claims, and the failures."""
    from fitting.cohort.report import evidence_sentence

    cohorts = [cohort] if cohort.evidence is None or cohort.evidence.decided else [cohort, *cohort.others]
    means = [_means(each) for each in cohorts]
    means[-1].caption = evidence_sentence(cohort)
    claims = Table("claim", "verdict", "why", title=f"Claims of the paper; {cohort.label}", show_lines=True)
    for claim in cohort.claims():
        claims.add_row(claim.name, claim.verdict, claim.text)
    if not cohort.failures:
        return [*means, claims]
    unused = Table(cohort.noun, "site", "why", title="Not used", show_lines=True)
    for failure in cohort.failures:
        unused.add_row(failure.entry.animal, failure.entry.site, failure.sentence)
    return [*means, claims, unused]


def _means(cohort: Cohort) -> Table:
    """The numbers of ``_SHOWN`` by site."""
    numbers = [right(heading) for heading in ("n", *(heading for heading, _, _ in _SHOWN))]
    spread = f" ± standard deviation between {cohort.noun}s" if len(cohort.animals) > 1 else ""
    title = f"{cohort.label}; {cohort.main} model, {cohort.elastic} law{': mean' if spread else ''}{spread}"
    table = Table("site", *numbers, title=title, padding=0)  # eight quantities fit 80 columns
    for site, row in cohort.table().items():
        n = str(row["E"].n) if "E" in row else "0"
        table.add_row(site, n, *(_cell(row.get(quantity), factor) for _, quantity, factor in _SHOWN))
    return table


def _cell(summary: Summary | None, factor: float) -> str:
    """Mean ± standard deviation, one below the other: seven numbers fit 80 columns."""
    if summary is None:
        return DASH
    mean, sd = factor * summary.mean, factor * summary.sd
    return plus_minus(mean, sd).replace(" ± ", "\n±") if sd > 0.0 else number(mean, 4)
