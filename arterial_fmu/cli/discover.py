"""The commands ``discover`` and ``isolability``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from arterial_fmu.cli.terminal.console import complain, conclude, say, sentences, show
from arterial_fmu.cli.terminal.options import Json, Quiet, networks_for
from arterial_fmu.cli.terminal.progress import bar
from discrepancy.options import Asked
from fitting.parallel.workers import cores
from solver import NonPhysicalState, NotPeriodic
from solver.io.exit_codes import ExitCode, HostDied
from solver.io.writing import check_destinations, write_whole
from solver.network.files import find_network, parse_quantity

from .terminal import record_options as options

if TYPE_CHECKING:
    from discrepancy.findings.outcome import Outcome
    from discrepancy.plan.sensor_plan import SensorPlan

_ERRORS = (NonPhysicalState, NotPeriodic, HostDied)  # errors that a user can correct, like input errors
_PACE = 600.0  # s over which the remaining time is estimated: stages differ in pace


def discover_command(
    record: Annotated[
        Path,
        typer.Argument(
            is_eager=True, help="Record with `time [s]` and either `inlet.Q` with P, Q or R, or P and R of one site."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the report, the verdict and the extended model.")],
    model: Annotated[
        str | None,
        typer.Option(
            help="A network file (TOML), a bundled network, or an FMU; default: a first model from the record.",
            autocompletion=networks_for,
        ),
    ] = None,
    further: options.Further = None,
    varies: Annotated[
        list[str] | None,
        typer.Option(help='Parameters with a separate value for each recording, repeatable: "*.outlet.R2", "*.E".'),
    ] = None,
    hold_out: options.HeldOutFiles = None,
    period: options.Period = None,
    part: options.Part = None,
    walls: Annotated[
        str | None,
        typer.Option(help="common (one change for all arteries) or individual (one for each); default: by evidence."),
    ] = None,
    prior: Annotated[Path | None, typer.Option(help="Result of `calibrate`: values with their uncertainty.")] = None,
    time_limit: Annotated[
        str,
        typer.Option(
            help='Limit of the search, e.g. "10 min"; a bare number is seconds. At the limit the best result so far '
            "is reported. The runs of the FMUs take additional time."
        ),
    ] = "5 min",
    like: options.Like = None,
    mass: options.Mass = None,
    venous: options.Venous = None,
    distance: options.Distances = None,
    path: options.Paths = None,
    filters: options.Filters = None,
    mapped: options.Mapped = None,
    beside: options.Beside = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    backend: options.FMUBackend = "auto",
    jobs: Annotated[int | None, typer.Option(help="Parallel processes; default: one per available core.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find, name and add the physics that a model lacks.

    Exit codes: 0 verdict, 3 unusable record, 2 wrong input, 130 interrupted. After an interruption the same command
    continues the study.
    """
    with sentences():
        how = options.reading([record, *(further or ()), *(hold_out or ())], mapped, decimal, beside, part)
        asked = Asked(
            options.seconds(period), walls, prior, parse_quantity(time_limit, "s", "--time-limit"),
            cores() if jobs is None else jobs, tuple(filters or ()), tuple(further or ()), tuple(varies or ()),
            tuple(hold_out or ()), backend, options.first_options(like, mass, venous, distance, path),
        )  # fmt: skip
        asked.check()
        if model is not None:
            find_network(model)
    from discrepancy.findings.outcome import verdict_json
    from discrepancy.report.page import FILES
    from discrepancy.workflow import discover
    from fitting.results.result_files import json_text

    kept = "finished stages are kept; run the same command to continue from the stage that was interrupted."
    with sentences(*_ERRORS, interrupted=kept), bar(quiet, pace=_PACE) as progress:
        progress(0.0, "reading")
        outcome = discover(record, model, out, reading=how, as_measured=as_measured, progress=progress, **vars(asked))
    files = [out / name for name in ("report.html", "verdict.json", "model.toml", "model.fmu", *FILES)]
    notes, written = (*outcome.notes, *outcome.warnings), files if outcome.written else []
    conclude(as_json, quiet, lambda: json_text(verdict_json(outcome)), lambda: _show(outcome), notes, written)
    if outcome.verdict == "unusable":
        if quiet or as_json:
            complain(f"Unusable: {outcome.reason}")
        raise typer.Exit(ExitCode.UNUSABLE)


def isolability_command(
    network: Annotated[
        str,
        typer.Argument(
            help="A network file (TOML), the name of a bundled network, or an FMU.", autocompletion=networks_for
        ),
    ],
    channels: Annotated[str, typer.Option(help="The sensors in addition to inlet.Q, e.g. AA.P,CA.P,FA.P.")],
    dB: Annotated[float, typer.Option("--dB", help="Noise: 40 dB is 1 % of the pulsatile standard deviation.")] = 40.0,
    beats: Annotated[int, typer.Option(help="Number of beats of the experiment.")] = 15,
    out: Annotated[Path | None, typer.Option(help="Write the plan to this .json file.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Predict, before any experiment, which effects a set of sensors can distinguish or cannot see, and the sensor to
    add."""
    with sentences():
        find_network(network)
        check_destinations(out, given=[network])
    from discrepancy.find.model_source import read_model
    from discrepancy.plan.sensor_plan import plan_json, plan_sensors
    from fitting.results.result_files import json_text

    with sentences(*_ERRORS), bar(quiet, pace=_PACE) as progress:
        names = channels.replace(",", " ").split()
        plan = plan_sensors(read_model(network), names, dB, beats, progress)
        text = json_text(plan_json(plan))
        if out is not None:
            write_whole(out, text)
    conclude(as_json, quiet, lambda: text, lambda: _show_plan(plan), written=[out])


# --- output -------------------------------------------------------------------------------------------------------


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
