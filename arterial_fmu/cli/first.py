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
from fitting.first.species import NAMES, typical
from solver.errors import InputError
from solver.io.writing import check_destinations, check_new, write_whole
from solver.quantities.legible import number, significant
from solver.quantities.text import typed_quantity
from solver.quantities.units import of_signal

from .terminal import record_options as options

if TYPE_CHECKING:
    from fitting.first.model import FirstModel


def first_command(
    record: Annotated[
        Path, typer.Argument(is_eager=True, help=f"{options.RECORD_HELP}, with `inlet.Q` and P at the root.")
    ],
    out: Annotated[Path | None, typer.Option(help="Network file to write.")] = None,
    like: Annotated[str, typer.Option(help=f"Species of the typical aorta: {', '.join(NAMES)}.")] = "human",
    mass: Annotated[str | None, typer.Option(help='Body mass, "35 kg"; default: typical of the species.')] = None,
    venous: Annotated[str, typer.Option(help="Venous pressure at the end of all resistances.")] = "5 mmHg",
    distance: Annotated[
        list[str] | None,
        typer.Option(help='Distance of a site from the root along the vessels, repeatable: "FA=45 cm".'),
    ] = None,
    path: Annotated[
        list[str] | None,
        typer.Option(help='Sites along a path, repeatable: "Ao,CA"; default: by the delays; side branches are found.'),
    ] = None,
    period: options.Period = None,
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
        how = options.reading([record], mapped, decimal, beside)
        T = options.seconds(period, "--period")
        check_destinations(out, given=[record, *how.beside])
        typical(like)
        kilograms = None if mass is None else typed_quantity(mass, "kg", "--mass")
        P_venous = typed_quantity(venous, "Pa", "--venous")
        distances = _distances(distance or [])
    from fitting.first.model import first_model

    with sentences(), bar(quiet) as progress:
        progress(0.0, "reading")
        beats = options.beats_of(record, how, {}, as_measured, T)
        found = first_model(beats, like, mass=kilograms, P_venous=P_venous, distances=distances, paths=path or [])
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
        "channel", "unit", *map(right, ("mean", "of the model", "pulse", "of the model", "rms of the difference"))
    )
    for row in model.shown:
        unit, factor = of_signal(row.channel)
        numbers = (significant(factor * x, 3) for x in (*row.mean, *row.pulse))
        shown.add_row(row.channel, unit, *numbers, number(factor * row.rms, 2))
    return found, shown


def _distances(texts: list[str]) -> dict[str, float]:
    """{"FA": 0.45} of ["FA=45 cm"]. Raises ValueError for a text that is none, or a length that is not positive."""
    found = {}
    for text in texts:
        site, equals, length = (part.strip() for part in text.partition("="))
        if not (site and equals):
            raise InputError(f'--distance "{text}": must be SITE=LENGTH, such as --distance "FA=45 cm".')
        found[site] = typed_quantity(length, "m", f"--distance {site}")
        if not 0.0 < found[site] <= 10.0:
            raise InputError(f"--distance {site} = {length}: must be more than 0 and at most 10 m; check its unit.")
    return found
