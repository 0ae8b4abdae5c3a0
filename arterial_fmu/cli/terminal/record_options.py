"""Options of every command that reads a record: assignment and preview of the columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from arterial_fmu.cli.terminal.console import put, right, say, sentences, show
from fitting.first.options import NAMES, VENOUS, FirstOptions, typical
from fitting.records.read.columns import Reading
from fitting.records.recordings import check_readable
from solver.errors import InputError
from solver.network.files import parse_quantity
from solver.quantities.text import typed_quantity
from solver.quantities.units import MMHG

if TYPE_CHECKING:
    from fitting.records.alignment.beats import Beats
    from fitting.records.plausible import Artery


def _look(ctx: typer.Context, wanted: bool) -> None:
    """Show the columns and stop, before other arguments are checked."""
    if not wanted or ctx.resilient_parsing:
        return
    from fitting.cohort.file import read_cohort
    from fitting.records.read.preview import preview, preview_questions

    given: dict[str, Any] = ctx.params
    with sentences():
        path = given["record"] if "record" in given else read_cohort(given["cohort"])[0].record
        how = Reading.from_options(given["mapped"], given["decimal"], given.get("beside"))
        looks = [preview(file, how) for file in (path, *how.beside)]
    if given["as_json"]:
        put(looks[0] if not how.beside else {"files": looks})
    else:
        for found in looks:
            show(_preview_table(found))
            for question in preview_questions(found):
                say(question)
    raise typer.Exit


# The options that --columns needs are eager, so that they are known with it, in any order.
RECORD_HELP = "CSV, text of LabChart or AcqKnowledge, .mat or .edf"
Mapped = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="TITLE=VARIABLE",
        is_eager=True,
        help='Assign a column to a variable, by title or number, repeatable: "Druck=AA.P [mmHg]", "2=inlet.Q [mL/s]", '
        '"Q.csv:2=…" for one file of several; "ECG=" ignores one.',
    ),
]
Beside = Annotated[
    list[Path] | None,
    typer.Option(
        "--with",
        metavar="FILE[=SHIFT]",
        is_eager=True,
        help="A further file of the same recording, repeatable, aligned by the times in the files. "
        '"Q.csv=0.3 s" adds a shift; "Q.csv=start" aligns it with the start of the first file.',
    ),
]
Filters = Annotated[
    list[str] | None,
    typer.Option(
        "--filter",
        metavar="CHANNEL=FILTER",
        help='A known filter, delay or zero of a sensor, repeatable: "inlet.Q=lowpass 10 Hz", '
        '"AA.P=lowpass 55 Hz order 2", "inlet.Q=delay 20 ms", "AA.P=zero 4 mmHg".',
    ),
]
Decimal = Annotated[
    str | None, typer.Option("--decimal", is_eager=True, help="Decimal mark: comma or point; default: from the file.")
]
Part = Annotated[
    list[str] | None,
    typer.Option(
        "--part",
        metavar="[FILE=]FROM..TO",
        help='Read only this part, in times after the first sample: "60..120 s", "2 min..", "..30 s"; '
        '"drug.txt=60..120 s" of one of several recordings, repeatable.',
    ),
]
AsMeasured = Annotated[
    bool,
    typer.Option("--as-measured", help="Accept values outside the range of arteries, e.g. of a phantom or a vein."),
]
Period = Annotated[str | None, typer.Option(help='Period of the beat, e.g. "0.5 s"; default: from the record.')]
Law = Annotated[
    str | None,
    typer.Option(
        help="Elastic law: beta (the paper's network) or regression (the paper's fit); default: both, by evidence."
    ),
]
FMUBackend = Annotated[
    str,
    typer.Option(
        "--backend",
        help="Kind of the FMUs that are built and run: numpy (that of build), native (with the compiled engine), or "
        "auto (native if it can be built here). Both give the same numbers.",
    ),
]
Columns = Annotated[
    bool, typer.Option("--columns", callback=_look, help="Show the columns of the record and exit; also with --json.")
]


# Options rather than further arguments: `RECORD --columns` has no network, and the role of each file must be
# unambiguous
Further = Annotated[
    list[Path] | None, typer.Option("--and", metavar="FILE", help="A further recording of the same animal, repeatable.")
]
HeldOutFiles = Annotated[
    list[Path] | None,
    typer.Option("--hold-out", metavar="FILE", help="A held-out recording for validation, repeatable."),
]

# of a first model, which discover makes without --model
Like = Annotated[
    str | None,
    typer.Option(
        help=f"Species of the typical aorta: {', '.join(NAMES)}; default: a mammal of the recorded stroke volume."
    ),
]
Mass = Annotated[
    str | None,
    typer.Option(help='Body mass, "35 kg"; default: by the stroke volume, and with --like typical of the species.'),
]
Venous = Annotated[
    str | None,
    typer.Option(help=f"Venous pressure at the end of all resistances; default: {VENOUS / MMHG:g} mmHg."),
]
Distances = Annotated[
    list[str] | None,
    typer.Option("--distance", help='Distance of a site from the root along the vessels, repeatable: "FA=45 cm".'),
]
Paths = Annotated[
    list[str] | None,
    typer.Option(
        "--path", help='Sites along a path, repeatable: "Ao,CA"; default: by the delays; side branches are found.'
    ),
]


def seconds(period: str | None) -> float | None:
    """The period in seconds; None if it is not given."""
    return None if period is None else parse_quantity(period, "s", "--period")


def reading(
    records: Sequence[Path],
    mapped: list[str] | None,
    decimal: str | None,
    beside: list[Path] | None = None,
    part: list[str] | None = None,
) -> Reading:
    """How to read these records. Raises InputError for a wrong option, or a file that cannot be opened."""
    how = Reading.from_options(mapped, decimal, beside, part)
    check_readable(*records, *how.beside)
    check_parts(how, records)
    return how


def check_parts(how: Reading, records: Sequence[Path]) -> None:
    """Raise InputError for a part of a file that is none of these records."""
    names = [path.name for path in records]
    for file in how.parts:
        if file and file not in names:
            raise InputError(f"--part {file}: no recording has this name; they are {', '.join(names)}.")


def beats_of(
    record: Path, how: Reading, arteries: Mapping[str, Artery], as_measured: bool, period: float | None
) -> Beats:
    """The beats of a record, after the check of its values unless ``as_measured``. period : [s]."""
    from fitting.records.alignment.align import align
    from fitting.records.plausible import check_plausible
    from fitting.records.read.record import read_record

    measured = read_record(record, how)
    if not as_measured:
        check_plausible(measured, arteries)
    return align(measured, period)


def first_options(
    like: str | None, mass: str | None, venous: str | None, distance: list[str] | None, path: list[str] | None
) -> FirstOptions:
    """The options of a first model. Raises ValueError, one sentence, for an unknown species or an invalid quantity."""
    kilograms = None if mass is None else typed_quantity(mass, "kg", "--mass")
    if like or kilograms is not None:
        typical(like or "human", kilograms)
    P_venous = VENOUS if venous is None else typed_quantity(venous, "Pa", "--venous")
    if not -20.0 * MMHG <= P_venous <= 50.0 * MMHG:
        raise InputError(
            f"--venous {venous}: must be -20 to 50 mmHg, where the pressures of all veins lie; check its unit and sign."
        )
    return FirstOptions(like, kilograms, P_venous, _distances(distance or []), tuple(path or ()))


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


# --- the columns of a file ------------------------------------------------------------------------------------------


def _preview_table(found: dict[str, Any]) -> Table:
    """The preview as a table; the open questions follow it: :func:`preview_questions`."""
    table = Table(
        "Column", "Unit", right("First values"), right("Min"), right("Max"), right("Gaps"), "Read as",
        title=f"{found['file']}: {found['samples']} samples; {found['format']}",
    )  # fmt: skip
    for each in found["columns"]:
        digits = _digits(each["first"])
        first, low, high = (
            " ".join("" if value is None else f"{value:.{digits}g}" for value in values)
            for values in (each["first"], [each["min"]], [each["max"]])
        )
        meaning = each["read_as"] if each["understood"] else "?, see below"
        texts = (each["title"], each["unit"], first, low, high, str(each["gaps"]), meaning)
        table.add_row(*(text.replace("[", "\\[") for text in texts))  # rich reads brackets as styles
    return table


def _digits(values: list[float | None]) -> int:
    """Of five, nine and twelve significant digits the fewest that tell the values apart: of clocks, five do not."""
    known = {value for value in values if value is not None}
    return next((n for n in (5, 9) if len({f"{value:.{n}g}" for value in known}) == len(known)), 12)
