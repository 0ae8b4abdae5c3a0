"""Common code of the benchmarks: one row per measurement, printed as a table and written as JSON."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from solver.network.files import write_whole

Small = Annotated[bool, typer.Option("--small", help="The least that runs every part: whether it works, not how fast.")]


@dataclass(frozen=True)
class Row:
    """One measurement: what, its value and unit, the target where there is one, and a note."""

    what: str
    value: float
    unit: str
    target: float | None = None
    note: str = ""


def best(action: Callable[[], object], repeats: int = 7) -> float:
    """Least CPU seconds of several calls."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        action()
        seconds.append(time.process_time() - start)
    return min(seconds)


def show(rows: Sequence[Row], title: str, json_file: Path | None) -> None:
    """Print the rows, and write them to a file if there is one."""
    table = Table(title=title)
    for column in ("what", "measured", "target", "note"):
        table.add_column(column, justify="right" if column in ("measured", "target") else "left")
    for row in rows:
        target = "" if row.target is None else f"<= {row.target:g} {row.unit}"
        table.add_row(row.what, f"{row.value:.3g} {row.unit}", target, row.note)
    Console(width=130).print(table)
    if json_file is not None:
        write_whole(json_file, json.dumps([asdict(row) for row in rows], indent=1) + "\n")
