"""The command ``first``: a network file from a recording."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from arterial_fmu.cli.terminal.console import conclude, right, sentences, show
from arterial_fmu.cli.terminal.options import Force, Json, Quiet
from arterial_fmu.cli.terminal.progress import bar
from solver.io.writing import check_destinations, check_new, write_whole
from solver.quantities.legible import number, significant
from solver.quantities.units import of_signal

from .terminal import record_options as options

if TYPE_CHECKING:
    from fitting.first.model import FirstModel


def first_command(
    record: Annotated[
        Path, typer.Argument(is_eager=True, help=f"{options.RECORD_HELP}, with `inlet.Q` and P at the root.")
    ],
    out: Annotated[Path | None, typer.Option(help="Network file to write.")] = None,
    like: options.Like = None,
    mass: options.Mass = None,
    venous: options.Venous = None,
    distance: options.Distances = None,
    path: options.Paths = None,
    period: options.Period = None,
    part: options.Part = None,
    beside: options.Beside = None,
    mapped: options.Mapped = None,
    decimal: options.Decimal = None,
    columns: options.Columns = False,
    as_measured: options.AsMeasured = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a first model from a recording: resistance, compliance, impedance, delays, and the network from them."""
    with sentences():
        how = options.reading([record], mapped, decimal, beside, part)
        T = options.seconds(period)
        check_destinations(out, given=[record, *how.beside])
        asked = options.first_options(like, mass, venous, distance, path)
    from fitting.first.model import first_model

    with sentences(), bar(quiet) as progress:
        progress(0.0, "reading")
        beats = options.beats_of(record, how, {}, as_measured, T)
        found = first_model(beats, **vars(asked))
        if out is not None:
            check_new({out: found.text}, force)
            write_whole(out, found.text)
    notes = [*found.notes, *beats.warnings]
    conclude(as_json, quiet, lambda: plain(found), lambda: show(*tables(found)), notes, [out])


def plain(model: FirstModel) -> dict[str, Any]:
    """For JSON: numbers, record against model, notes and the network file, in SI."""
    return {
        "found": [asdict(each) for each in model.found],
        "shown": [asdict(each) for each in model.shown],
        "notes": list(model.notes),
        "network": model.text,
    }


def tables(model: FirstModel) -> tuple[Table, Table]:
    """Tables of the numbers, and of each channel of the record against the model."""
    from fitting.first.text import error, value

    found = Table("found", right("value"), right("1 sd"), "how", title="First model", title_justify="left")
    for each in model.found:
        found.add_row(each.name, value(each), error(each), each.how)
    shown = Table(
        "channel",
        "unit",
        *map(right, ("mean", "of the model", "pulse", "of the model", "rms of the difference")),
        title="Record against model",
        title_justify="left",
    )
    for row in model.shown:
        unit, factor = of_signal(row.channel)
        numbers = (significant(factor * x, 3) for x in (*row.mean, *row.pulse))
        shown.add_row(row.channel, unit, *numbers, number(factor * row.rms, 2))
    return found, shown
