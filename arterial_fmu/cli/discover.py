"""Command line of the workflow: ``python -m discrepancy RECORD.csv`` and ``python -m discrepancy isolability``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import discrepancy
from arterial_fmu.cli.terminal.console import complain, faults, put, say, say_notes, say_written, sentences, show
from arterial_fmu.cli.terminal.options import DefaultGroup, Json, Quiet, networks_for
from arterial_fmu.cli.terminal.progress import bar
from arterial_fmu.cli.terminal.record_options import (
    AsMeasured,
    Beside,
    Columns,
    Decimal,
    Filters,
    Further,
    HeldOutFiles,
    Mapped,
)
from fitting.records.read.columns import Reading
from solver import NonPhysicalState, NotPeriodic
from solver.io.exit_codes import ExitCode
from solver.io.host_died import HostDied
from solver.io.writing import check_destinations, write_whole
from solver.network.files import parse_quantity

if TYPE_CHECKING:
    from discrepancy.findings.outcome import Outcome
    from discrepancy.plan.sensor_plan import SensorPlan

_ERRORS = (NonPhysicalState, NotPeriodic, HostDied)  # what a user can put right, too
_PACE = 600.0  # s over which the time left is judged: stages differ in pace


app = typer.Typer(
    cls=DefaultGroup,
    add_completion=False,
    help=discrepancy.__doc__,
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command("discover")
def discover_command(
    record: Annotated[
        Path,
        typer.Argument(is_eager=True, help="File with `time [s]`, then `inlet.Q` and P, Q, R, or P and R of one site."),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the report, the verdict and the extended model.")],
    model: Annotated[
        str | None,
        typer.Option(
            help="A network file (TOML), a bundled network, or an FMU; default: a first model, made of the record.",
            autocompletion=networks_for,
        ),
    ] = None,
    further: Further = None,
    varies: Annotated[
        list[str] | None,
        typer.Option(help='Numbers that each recording has of its own, repeatable: "*.outlet.R2", "*.E".'),
    ] = None,
    hold_out: HeldOutFiles = None,
    period: Annotated[str | None, typer.Option(help='Period of the beat, e.g. "0.5 s"; default: found.')] = None,
    walls: Annotated[
        str | None,
        typer.Option(help="common (all arteries differ from the file together) or individual; default: by evidence."),
    ] = None,
    prior: Annotated[
        Path | None, typer.Option(help="Result of `calibrate`: values, and how uncertain they are.")
    ] = None,
    time_limit: Annotated[
        str,
        typer.Option(
            help='Of naming, e.g. "10 min"; a bare number is seconds. Then the best answer so far is given; '
            "the runs of the FMUs after it come on top."
        ),
    ] = "5 min",
    filters: Filters = None,
    mapped: Mapped = None,
    beside: Beside = None,
    decimal: Decimal = None,
    columns: Columns = False,
    as_measured: AsMeasured = False,
    jobs: Annotated[
        int | None, typer.Option(help="Processes that simulate; default: one for each core that may be used.")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find, name and add what a model lacks.

    Exit code 0 with a verdict, 3 if the record is unusable, 2 if something given is wrong, 130 if interrupted: the same
    command goes on where it was.
    """
    from discrepancy.findings.outcome import verdict_json
    from discrepancy.report.learned_text import FILES
    from discrepancy.workflow import discover  # takes a second
    from fitting.parallel.workers import cores
    from fitting.results.result_files import json_text

    kept = "finished stages are kept, the one under way begins anew; run again to go on."
    with sentences(*_ERRORS, interrupted=kept), bar(quiet, pace=_PACE) as progress:
        seconds = None if period is None else parse_quantity(period, "s", "--period")
        limit = parse_quantity(time_limit, "s", "--time-limit")
        progress(0.0, "reading")
        outcome = discover(
            record, model, out, further=further or (), varies=varies or (), hold_out=hold_out or (), period=seconds,
            walls=walls, prior=prior, time_limit=limit, jobs=cores() if jobs is None else jobs,
            reading=Reading.asked(mapped, decimal, beside), filters=filters or (), as_measured=as_measured,
            progress=progress,
        )  # fmt: skip
    if as_json:
        put(json_text(verdict_json(outcome)))
    elif not quiet:
        _show(outcome)
    if not quiet:
        say_notes((*outcome.notes, *outcome.warnings), aside=as_json)
        files = (out / name for name in ("report.html", "verdict.json", "model.toml", "model.fmu", *FILES))
        if outcome.written:
            say_written(*files, aside=as_json)
    if outcome.verdict == "unusable":
        if quiet or as_json:
            complain(f"Unusable: {outcome.reason}")
        raise typer.Exit(ExitCode.UNUSABLE)


@app.command("isolability")
def isolability_command(
    network: Annotated[
        str,
        typer.Argument(
            help="A network file (TOML), the name of a bundled network, or an FMU.", autocompletion=networks_for
        ),
    ],
    channels: Annotated[str, typer.Option(help="The sensors beside inlet.Q, e.g. AA.P,CA.P,FA.P.")],
    dB: Annotated[float, typer.Option("--dB", help="Noise: 40 dB is 1 % of the pulsatile standard deviation.")] = 40.0,
    beats: Annotated[int, typer.Option(help="Beats of the experiment.")] = 15,
    out: Annotated[Path | None, typer.Option(help="Write the plan as .json.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Before any experiment: what these sensors could tell apart, what they cannot see, which sensor to add."""
    from discrepancy.find.model_source import read_model
    from discrepancy.plan.sensor_plan import plan_json, plan_sensors
    from fitting.results.result_files import json_text

    with sentences(*_ERRORS), bar(quiet, pace=_PACE) as progress:
        check_destinations(out, given=[network])
        names = channels.replace(",", " ").split()
        plan = plan_sensors(read_model(network), names, dB, beats, progress)
        text = json_text(plan_json(plan))
        if out is not None:
            write_whole(out, text)
    if as_json:
        put(text)
    elif not quiet:
        _show_plan(plan)
    if not quiet:
        say_written(out, aside=as_json)


# --- what is shown ------------------------------------------------------------------------------------------------


def _show(outcome: Outcome) -> None:
    from discrepancy.report.verdict_text import more_time

    from .tables.study import effects_table, recordings_table, statements

    say(outcome.sentence)
    if not outcome.complete:
        say(more_time(outcome))
    if outcome.effects:
        show(effects_table(outcome))
    if outcome.recordings:
        show(recordings_table(outcome))
    for text in filter(None, statements(outcome)):
        say(text)


def _show_plan(plan: SensorPlan) -> None:
    from .tables.study import plan_statements, plan_table

    show(plan_table(plan))
    for text in plan_statements(plan):
        say(text)


if __name__ == "__main__":
    with faults():
        app(prog_name="python -m arterial_fmu.cli.discover")
