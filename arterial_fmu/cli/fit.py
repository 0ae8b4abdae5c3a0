"""Command line of the fits: ``python -m fitting fit|virtual|cohort|first|calibrate|check``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from arterial_fmu.cli.terminal.console import faults, put, say, say_notes, say_written, sentences, show
from arterial_fmu.cli.terminal.options import Force, Json, Quiet, networks_for
from arterial_fmu.cli.terminal.progress import PACE, bar
from fitting.check.fmu_run import RunFailed
from fitting.inference.models.bench_network import bench_network
from fitting.inference.models.loop import NoFit
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.plausible import Artery, check_plausible
from fitting.records.read.columns import Reading
from fitting.records.read.record import read_record
from fitting.results.estimate import Estimate
from fitting.results.parameter_set import ParameterSet, read_set, set_content, set_format, set_json
from fitting.wall.indices import indices, plain
from fitting.wall.site_fit import bootstrap, fit
from fitting.wall.wall_fit import WallFit
from fitting.wall.wall_model import model
from solver import NonPhysicalState, NotPeriodic
from solver.errors import InputError
from solver.io.host_died import HostDied
from solver.io.writing import check_destinations, check_new, write_all
from solver.network.files import dumps
from solver.quantities.text import typed_quantity

from .calibrate import calibrate_command
from .first import first_command
from .tables.cohort import tables as cohort_tables
from .terminal.record_options import (
    AsMeasured,
    Beside,
    Columns,
    Decimal,
    Filters,
    FMUBackend,
    Mapped,
    Period,
    seconds,
)

app = typer.Typer(add_completion=False, help=__doc__, no_args_is_help=True, rich_markup_mode=None)

_ERRORS = (NonPhysicalState, NotPeriodic, RunFailed, HostDied)  # further errors that a user can correct

Law = Annotated[
    str | None,
    typer.Option(
        help="Elastic law: beta (the paper's network) or regression (the paper's fit); default: both, by evidence."
    ),
]


@app.command("fit")
def fit_command(
    record: Annotated[Path, typer.Argument(is_eager=True, help="Record with `time [s]`, `<site>.P` and `<site>.R`.")],
    site: Annotated[str, typer.Option(help="Name of the site: AA for AA.P and AA.R.")],
    h: Annotated[str, typer.Option("--h", help='Measured wall thickness, e.g. "0.38 mm".')],
    R0: Annotated[
        str | None, typer.Option("--R0", help='Measured unstressed radius, e.g. "0.936 cm"; default: fitted.')
    ] = None,
    wall: Annotated[
        str, typer.Option("--model", help="Wall model: linear, nonlinear, extended, monotone or 'extended monotone'.")
    ] = "monotone",
    law: Law = None,
    eta: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.5,
    period: Period = None,
    lag: Annotated[bool, typer.Option("--lag", help="Also fit a time lag between P and R.")] = False,
    replicates: Annotated[int, typer.Option("--bootstrap", help="Bootstrap replicates; 0: none.")] = 200,
    out: Annotated[Path | None, typer.Option(help="Write the parameter set: .json or .ssv.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the measured loop with the linear and the chosen model.")
    ] = None,
    mapped: Mapped = None,
    beside: Beside = None,
    decimal: Decimal = None,
    columns: Columns = False,
    as_measured: AsMeasured = False,
    bench: Annotated[
        Path | None, typer.Option(help="Write the network file of this site's bench, for build and discover.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit the wall of one site from its pressure and radius."""
    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        progress(0.0, "reading")
        how = Reading.asked(mapped, decimal, beside)
        _check_destinations(out, figure, bench, parameters=out, given=[record, *how.beside])
        if figure is not None and figure.suffix.lower() != ".png":
            raise InputError(f"{figure}: a figure is a .png file; rename it.")
        if replicates < 0:
            raise InputError(f"--bootstrap = {replicates}: must be 0 (none) or a number of replicates, such as 200.")
        chosen = wall if law is None else model(wall, law)
        options: dict[str, Any] = {
            "R0": None if R0 is None else typed_quantity(R0, "m", "--R0"),
            "eta": eta,
            "lag_free": lag,
        }
        thickness = typed_quantity(h, "m", "--h")
        measured = read_record(record, how)
        if not as_measured:
            check_plausible(measured, {site: Artery(options["R0"], thickness)})
        beats = align(measured, seconds(period, "--period"))
        kept = fit(beats, site, thickness, chosen, **options)
        fits = [*_beside(kept, beats, options), kept]
        checked = (
            bootstrap(kept, beats, replicates, progress=lambda f: progress(f, "bootstrap")) if replicates > 0 else {}
        )
        found = indices(kept, beats)
        notes = [*_fit_notes(kept), *_objection(kept, beats, options)]
        parameters = _with_indices(kept.parameter_set(), plain(found))
        files: dict[Any, str | bytes] = {}
        if bench is not None:
            files[bench] = dumps(bench_network(site, parameters, beats.T))
            check_new({bench: files[bench]}, force)
        if out is not None:
            files[out] = set_content(parameters, out)
        if figure is not None:
            files[figure] = _drawn(fits, beats)
        write_all(files)
    if as_json:
        put(set_json(parameters))
    elif not quiet:
        show(*_fit_tables(fits, kept, found, checked))
    if not quiet:
        say_notes(notes, aside=as_json)
        say_written(out, figure, bench, aside=as_json)


@app.command("virtual")
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
    from fitting.cohort.virtual import virtual_cohort, write_cohort

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        check_destinations(out / "cohort.csv", folders=True)
        progress(0.0, "making virtual animals")
        made = virtual_cohort(seed, animals=animals, dB=dB, exact_means=exact_means)
        write_cohort(made, out, progress)
    if as_json:
        put({"written": [str(out / "cohort.csv"), *map(str, sorted(out.glob("virtual-*.csv")))]})
    elif not quiet:
        say_written(out / "cohort.csv")
        say(f"and the recordings that it lists, {len(list(out.glob('virtual-*.csv')))} files")


@app.command("cohort")
def cohort_command(
    cohort: Annotated[
        Path,
        typer.Argument(is_eager=True, help="CSV with animal (or subject, patient), site, record, h [mm], R0 [mm]."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")],
    mapped: Mapped = None,
    decimal: Decimal = None,
    columns: Columns = False,
    as_measured: AsMeasured = False,
    law: Law = None,
    jobs: Annotated[int, typer.Option(help="Parallel processes.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Address of a dask cluster: tcp://host:8786.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit many subjects at many sites; report means and spread, and test the paper's claims."""
    from fitting.cohort import report
    from fitting.cohort.fits import fit_cohort, read_cohort

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        check_destinations(out / "cohort.json", given=[cohort], folders=True)
        entries, how = read_cohort(cohort), Reading.asked(mapped, decimal)
        found = fit_cohort(
            entries,
            elastic=law,
            reading=how,
            as_measured=as_measured,
            jobs=jobs,
            scheduler=scheduler,
            progress=progress,
        )
        written = report.write(found, out)
    if as_json:
        put(report.to_json(found))
    elif not quiet:
        show(*cohort_tables(found))
    if not quiet:
        say_written(*written, aside=as_json)


app.command("first")(first_command)


app.command("calibrate")(calibrate_command)


@app.command("check")
def check_command(
    parameters: Annotated[Path, typer.Argument(help="Parameter set: .json, .ssv or the name of a bundled one.")],
    fmu: Annotated[
        Path,
        typer.Argument(
            help="The FMU of a network or of a bench; or a network, of which an FMU is then built.",
            autocompletion=networks_for,
        ),
    ],
    record: Annotated[
        Path, typer.Argument(is_eager=True, help="Record of the network, or P and R of the bench's site.")
    ],
    mapped: Mapped = None,
    beside: Beside = None,
    decimal: Decimal = None,
    columns: Columns = False,
    as_measured: AsMeasured = False,
    out: Annotated[Path, typer.Option(help="Folder for check.html and check.json.")] = Path("check"),
    period: Period = None,
    filters: Filters = None,
    backend: FMUBackend = "auto",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run an FMU with a parameter set in a fresh process and compare it with a record."""
    from fitting.check.fmu_check import check
    from fitting.pages.check_page import FILES, write_check  # matplotlib takes a second

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        how = Reading.asked(mapped, decimal, beside)
        check_destinations(*(out / file for file in FILES), given=[parameters, fmu, record, *how.beside], folders=True)
        report = check(
            read_set(parameters),
            fmu,
            read_record(record, how),
            period=seconds(period, "--period"),
            filters=filters or (),
            as_measured=as_measured,
            backend=backend,
            progress=lambda what: progress(0.0, what),
        )
        page = write_check(report, out)
    if as_json:
        put(report.to_json())
    elif not quiet:
        say(report.title)
    if not quiet:
        say_notes(report.warnings, aside=as_json)
        say_written(page, aside=as_json)


# --- what the commands share --------------------------------------------------------------------------------------


def _beside(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[WallFit]:
    """The linear model for comparison with another one, if it has a fit."""
    with suppress(NoFit):
        if kept.model.name != "linear":
            return [fit(beats, kept.site, kept.h, model("linear", kept.model.elastic), **options)]
    return []


def _objection(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[str]:
    """A sentence if the record favours a law other than the given one."""
    with suppress(NoFit):
        if kept.evidence is None:
            best = fit(beats, kept.site, kept.h, kept.model.name, **options)
            if best.evidence is not None and best.evidence.decided and best.model.elastic != kept.model.elastic:
                return [f"{kept.site}: --law {kept.model.elastic} was given, but the record favours {best.law}."]
    return []


def _drawn(fits: list[WallFit], beats: Beats) -> bytes:
    from fitting.pages.figures import loop_figure  # matplotlib takes a second
    from fitting.pages.style import png

    return png(loop_figure(fits, beats))


def _with_indices(parameters: ParameterSet, found: dict[str, Any]) -> ParameterSet:
    """The set with the physiological indices in its provenance."""
    return replace(parameters, provenance={**parameters.provenance, "indices": found})


def _check_destinations(
    *paths: Path | None, parameters: Path | None = None, given: Iterable[str | Path | None] = ()
) -> None:
    """Raise ValueError before the work if a file cannot be written."""
    check_destinations(*paths, given=given)
    if parameters is not None:
        set_format(parameters)


def _fit_tables(
    fits: list[WallFit], kept: WallFit, found: dict[str, Estimate], checked: dict[str, tuple[float, float]]
) -> list[RenderableType]:
    from .tables.fits import fits_table, headline, indices_table, sensitivity_table

    columns = [*fits, *kept.others]
    return [
        headline(kept, found["E_inc"]),
        fits_table(columns, kept),
        sensitivity_table(kept, checked),
        indices_table(kept.site, found),
    ]


def _fit_notes(kept: WallFit) -> list[str]:
    """Notes on a fit, in sentences."""
    if math.isnan(kept.lag[1]):
        return list(kept.warnings)
    lag, half = 1e3 * kept.lag[0], 1.96e3 * kept.lag[1]
    which = "late" if lag > 0.0 else "early"
    said = f"{kept.site}: P is {which} by {abs(lag):.3g} ± {half:.2g} ms (95 %); the results are corrected for it, "
    return [f"{said}but check uses the record without this correction.", *kept.warnings]


if __name__ == "__main__":
    with faults():
        app()
