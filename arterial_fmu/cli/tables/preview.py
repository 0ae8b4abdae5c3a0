"""The columns of a file on the terminal."""

from __future__ import annotations

from typing import Any

from rich.table import Table as Printed

from arterial_fmu.cli.terminal.console import right


def preview_table(found: dict[str, Any]) -> Printed:
    """The preview as a table; the open questions follow it: :func:`preview_questions`."""
    table = Printed(
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
