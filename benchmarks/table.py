"""Common code of the benchmarks: one thread, rows of measurements, tables, JSON, and files that a run continues."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from fitting.parallel.threads import ENVIRONMENT
from solver.network.files import write_whole

Small = Annotated[bool, typer.Option("--small", help="The least that runs every part: whether it works, not how fast.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write all numbers to this file.")]
MACHINE = f"{platform.machine()}, Python {platform.python_version()}, NumPy {np.__version__}, one thread"


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread, also of processes that are started, so that CPU time is time."""
    import scipy.linalg  # noqa: F401  (its library must be loaded to be limited)

    os.environ.update(ENVIRONMENT)
    with threadpool_limits(1):
        yield


def start(main: Callable[..., object]) -> None:
    """Run a benchmark with the options of the command line."""
    with one_thread():
        typer.run(main)


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
    cells = []
    for row in rows:
        target = "" if row.target is None else f"<= {row.target:g} {row.unit}"
        cells.append((row.what, row.note, f"{row.value:.3g} {row.unit}", target))
    tabulate(title, ("what", "note", "measured", "target"), cells, left=2, width=130)
    store(json_file, rows)


def tabulate(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[object]], left: int = 1, width: int = 150
) -> None:
    """Print a table; all columns but the first ``left`` are right-aligned."""
    table = Table(title=title)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right")
    for row in rows:
        table.add_row(*map(str, row))
    Console(width=width).print(table)


def store(file: Path | None, content: Any) -> None:
    """Write plain data and dataclasses to a file, if there is one."""
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, json.dumps(content, indent=1, default=asdict) + "\n")


def continued(
    file: Path, keys: Sequence[str], cases: Iterable[tuple[Any, ...]], measure: Callable[..., dict[str, Any]]
) -> list[dict[str, Any]]:
    """The rows of a file, and those of the cases that it lacks, stored one by one: a run that ended goes on from there.

    keys : of a row, whose values are the case that it is of.
    """
    rows: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else []
    done = {tuple(row[key] for key in keys) for row in rows}
    for case in cases:
        if case not in done:
            rows.append(measure(*case))
            store(file, rows)
    return rows
