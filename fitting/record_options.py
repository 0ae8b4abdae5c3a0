"""Options of every command that reads a record: which column is what, and a look at the columns."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from solver.console import put, say, sentences, show

from .cohort.file import read_cohort
from .records.columns import Reading
from .records.preview import preview, preview_questions, preview_table


def _look(ctx: typer.Context, wanted: bool) -> None:
    """Show the columns and end, before anything else is asked for."""
    if not wanted or ctx.resilient_parsing:
        return
    given: dict[str, Any] = ctx.params
    with sentences():
        path = given["record"] if "record" in given else read_cohort(given["cohort"])[0].record
        found = preview(path, Reading.asked(given["mapped"], given["decimal"]))
    if given["as_json"]:
        put(found)
    else:
        show(preview_table(found))
        for question in preview_questions(found):
            say(question)
    raise typer.Exit


# The options that --columns needs are eager: they are known when it is, wherever they stand.
RECORD_HELP = "CSV, text of LabChart or AcqKnowledge, .mat or .edf"
Mapped = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="TITLE=VARIABLE",
        is_eager=True,
        help='Which column is what, repeatable: "Pressure (mmHg)=AA.P", "p=AA.P [mmHg]"; "ECG=" leaves one out.',
    ),
]
Decimal = Annotated[
    str | None, typer.Option("--decimal", is_eager=True, help="Decimal mark: comma or point; default: found.")
]
AsMeasured = Annotated[
    bool, typer.Option("--as-measured", help="Take values that no artery has as they are: a phantom, a vein.")
]
Columns = Annotated[
    bool, typer.Option("--columns", callback=_look, help="Show the columns of the record and end; with --json, too.")
]
