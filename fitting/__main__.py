"""Command line of the fits: ``python -m fitting fit|virtual|cohort|calibrate|check``."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import RenderableType

from solver import NonPhysicalState, NotPeriodic
from solver.console import faults, put, say, say_notes, say_written, sentences, show
from solver.files import find_network, parse_quantity, read_network, write_network, write_whole
from solver.host_died import HostDied
from solver.options import Json, NetworkName, Quiet, files_for
from solver.progress import PACE, bar

from .bench import bench_network
from .estimate import Estimate
from .fmu_run import RunFailed
from .indices import indices, plain
from .inference.loop import NoFit
from .parameter_set import ParameterSet, read_set, set_format, set_json, write_set
from .record_options import Columns, Decimal, Mapped
from .records.align import align
from .records.beats import Beats
from .records.columns import Reading
from .records.record import read_record
from .wall import bootstrap, fit
from .wall_fit import WallFit
from .wall_model import model

app = typer.Typer(add_completion=False, help=__doc__, no_args_is_help=True, rich_markup_mode=None)

_ERRORS = (NonPhysicalState, NotPeriodic, RunFailed, HostDied)  # what a user can put right, too

Period = Annotated[str | None, typer.Option(help='Period of the beat, e.g. "0.5 s"; default: found.')]
Law = Annotated[str, typer.Option(help="Elastic law: regression (the paper's fit) or beta (the paper's network).")]


@app.command("fit")
def fit_command(
    record: Annotated[Path, typer.Argument(is_eager=True, help="File with `time [s]`, `<site>.P` and `<site>.R`.")],
    site: Annotated[str, typer.Option(help="Name of the site: AA for AA.P and AA.R.")],
    h: Annotated[str, typer.Option("--h", help='Wall thickness, measured: "0.38 mm".')],
    R0: Annotated[
        str | None, typer.Option("--R0", help='Unstressed radius if measured: "0.936 cm"; else fitted.')
    ] = None,
    wall: Annotated[
        str, typer.Option("--model", help="linear, nonlinear, extended, monotone or 'extended monotone'.")
    ] = "monotone",
    law: Law = "regression",
    eta: Annotated[float, typer.Option(help="Poisson's ratio.")] = 0.5,
    period: Period = None,
    lag: Annotated[bool, typer.Option("--lag", help="Fit a time lag between P and R, too.")] = False,
    replicates: Annotated[int, typer.Option("--bootstrap", help="Bootstrap replicates; 0: none.")] = 200,
    out: Annotated[Path | None, typer.Option(help="Write the parameter set: .json or .ssv.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the loop, measured against linear and chosen model.")
    ] = None,
    mapped: Mapped = None,
    decimal: Decimal = None,
    columns: Columns = False,
    bench: Annotated[Path | None, typer.Option(help="Write a network file of this site's bench, for build.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit the wall of one site from its pressure and radius."""
    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        progress(0.0, "reading")
        _check_destinations(out, figure, bench, parameters=out)
        if figure is not None and figure.suffix.lower() != ".png":
            raise ValueError(f"{figure}: a figure is a .png file; rename it.")
        if replicates < 0:
            raise ValueError(f"--bootstrap = {replicates}: must be 0 (none) or a number of replicates, such as 200.")
        beats = align(read_record(record, Reading.asked(mapped, decimal)), _seconds(period, "--period"))
        chosen = model(wall, law)
        options: dict[str, Any] = {
            "R0": None if R0 is None else parse_quantity(R0, "m", "--R0"),
            "eta": eta,
            "lag_free": lag,
        }
        thickness = parse_quantity(h, "m", "--h")
        kept = fit(beats, site, thickness, chosen, **options)
        fits = [*_beside(kept, beats, options), kept]
        checked = (
            bootstrap(kept, beats, replicates, progress=lambda f: progress(f, "bootstrap")) if replicates > 0 else {}
        )
        found = indices(kept, beats)
        parameters = _with_indices(kept.parameter_set(), plain(found))
        drawn = _drawn(fits, beats) if figure is not None else b""
        # all that can fail has been made: now it is written
        if bench is not None:
            write_network(bench_network(site, parameters, beats.T), bench)
        if out is not None:
            write_set(parameters, out)
        if figure is not None:
            write_whole(figure, drawn)
    if as_json:
        put(set_json(parameters))
    elif not quiet:
        show(*_fit_tables(fits, kept, found, checked))
    if not quiet:
        say_notes(_fit_notes(kept), aside=as_json)
        say_written(out, figure, bench, aside=as_json)


@app.command("virtual")
def virtual_command(
    out: Annotated[Path, typer.Option(help="Folder for the records and cohort.csv.")],
    animals: Annotated[int, typer.Option(help="How many.")] = 11,
    seed: Annotated[int, typer.Option(help="Same seed, same animals.")] = 1,
    dB: Annotated[float, typer.Option("--dB", help="Noise: 40 dB is 1 % of the pulsatile standard deviation.")] = 40.0,
    exact_means: Annotated[
        bool, typer.Option("--exact-means", help="Scale the animals so that their means are the paper's.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a cohort of virtual animals: synthetic records with the paper's mean walls and a stated spread."""
    from .cohort.virtual import virtual_cohort, write_cohort

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
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
    law: Law = "regression",
    jobs: Annotated[int, typer.Option(help="Processes that fit at the same time.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Of a dask cluster that fits, tcp://…:8786.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fit many subjects, animals or patients, at many sites; means, spread, and the paper's claims tested."""
    from .cohort import report
    from .cohort.fits import fit_cohort, read_cohort

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        entries, how = read_cohort(cohort), Reading.asked(mapped, decimal)
        found = fit_cohort(entries, elastic=law, reading=how, jobs=jobs, scheduler=scheduler, progress=progress)
        written = report.write(found, out)
    if as_json:
        put(report.to_json(found))
    elif not quiet:
        show(*report.tables(found))
    if not quiet:
        say_written(*written, aside=as_json)


@app.command("calibrate")
def calibrate_command(
    record: Annotated[
        Path, typer.Argument(is_eager=True, help="File with `time [s]`, `inlet.Q` and P, Q or R at some sites.")
    ],
    network: NetworkName,
    free: Annotated[
        list[str],
        typer.Option(
            help='What to find, repeatable: "all.E", "CA.phi0:0.1" (prior sd), "CA+FA.E:none", "all.outlet.R_t".'
        ),
    ],
    out: Annotated[Path | None, typer.Option(help="Write the parameter set: .json or .ssv.")] = None,
    start: Annotated[
        Path | None, typer.Option(help="Parameter set to start from; default: the network's values.")
    ] = None,
    starts: Annotated[
        int, typer.Option(help="Searches: the first from the network's values, others from its priors, twice as wide.")
    ] = 1,
    seed: Annotated[int, typer.Option(help="Same seed, same starts.")] = 1,
    jobs: Annotated[int, typer.Option(help="Processes that search at the same time.")] = 1,
    scheduler: Annotated[str | None, typer.Option(help="Of a dask cluster that searches, tcp://…:8786.")] = None,
    mapped: Mapped = None,
    decimal: Decimal = None,
    columns: Columns = False,
    period: Period = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find parameters of a network from a record of it."""
    from .network_indices import network_indices
    from .pages.tables import calibration_table, network_indices_table
    from .starts import calibrate_from

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        progress(0.0, "reading")
        _check_destinations(out, parameters=out)
        described = read_network(find_network(network))
        if start is not None:
            described = read_set(start).apply(described)
        beats = align(read_record(record, Reading.asked(mapped, decimal)), _seconds(period, "--period"))
        tried = calibrate_from(
            beats, described, free, starts, seed=seed, jobs=jobs, scheduler=scheduler, progress=progress
        )
        result = tried.best
        progress(1.0, "indices of the sites")
        found = network_indices(result, described, beats)
        parameters = result.parameter_set(complete=start is not None)
        parameters = _with_indices(parameters, {site: plain(each) for site, each in found.items()})
        if starts > 1:
            parameters = replace(parameters, provenance={**parameters.provenance, "starts": tried.plain()})
        if out is not None:
            write_set(parameters, out)
    if as_json:
        put(set_json(parameters))
    elif not quiet:
        show(calibration_table(result), network_indices_table(result.network, found))
    if not quiet:
        say_notes(result.report, aside=as_json)
        say_written(out, aside=as_json)


@app.command("check")
def check_command(
    parameters: Annotated[Path, typer.Argument(help="Parameter set: .json, .ssv or the name of a bundled one.")],
    fmu: Annotated[Path, typer.Argument(help="The FMU, of a network or of a bench.", autocompletion=files_for)],
    record: Annotated[
        Path, typer.Argument(is_eager=True, help="File: a network record, or P and R of the bench's site.")
    ],
    mapped: Mapped = None,
    decimal: Decimal = None,
    columns: Columns = False,
    out: Annotated[Path, typer.Option(help="Folder for check.html and check.json.")] = Path("check"),
    period: Period = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Run an FMU with a parameter set in a fresh process and compare it with a record."""
    from .check import check
    from .pages.check_page import write_check  # matplotlib takes a second

    with sentences(*_ERRORS), bar(quiet, pace=PACE) as progress:
        report = check(
            read_set(parameters),
            fmu,
            read_record(record, Reading.asked(mapped, decimal)),
            period=_seconds(period, "--period"),
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


def _seconds(text: str | None, name: str) -> float | None:
    return None if text is None else parse_quantity(text, "s", name)


def _beside(kept: WallFit, beats: Beats, options: dict[str, Any]) -> list[WallFit]:
    """The linear model beside another one, where it has a fit."""
    if kept.model.name == "linear":
        return []
    try:
        return [fit(beats, kept.site, kept.h, model("linear", kept.model.elastic), **options)]
    except NoFit:
        return []


def _drawn(fits: list[WallFit], beats: Beats) -> bytes:
    from solver.notebook.style import png

    from .pages.figures import loop_figure  # matplotlib takes a second

    return png(loop_figure(fits, beats))


def _with_indices(parameters: ParameterSet, found: dict[str, Any]) -> ParameterSet:
    """The set with what a physiologist reads among its provenance."""
    return replace(parameters, provenance={**parameters.provenance, "indices": found})


def _check_destinations(*paths: Path | None, parameters: Path | None = None) -> None:
    """Raise ValueError before hours of work if a file cannot be written at the end."""
    for path in paths:
        if path is not None and not path.parent.is_dir():
            raise ValueError(f"{path}: cannot be written (no folder {path.parent}); make the folder or give another.")
        if path is not None and path.exists() and not path.is_file():
            raise ValueError(f"{path}: cannot be written (not a regular file); give the name of a file.")
    if parameters is not None:
        set_format(parameters)


def _fit_tables(
    fits: list[WallFit], kept: WallFit, found: dict[str, Estimate], checked: dict[str, tuple[float, float]]
) -> list[RenderableType]:
    from .pages.tables import fits_table, indices_table, sensitivity_table

    return [fits_table(fits, kept), sensitivity_table(kept, checked), indices_table(kept.site, found)]


def _fit_notes(kept: WallFit) -> list[str]:
    """What is to be known of a fit, in sentences."""
    if math.isnan(kept.lag[1]):
        return list(kept.warnings)
    lag, half = 1e3 * kept.lag[0], 1.96e3 * kept.lag[1]
    which = "late" if lag > 0.0 else "early"
    said = f"{kept.site}: P is {which} by {abs(lag):.3g} ± {half:.2g} ms (95 %); what is shown is without the lag, "
    return [f"{said}but the record that a check reads still has it.", *kept.warnings]


if __name__ == "__main__":
    with faults():
        app()
