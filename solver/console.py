"""What the command lines of this project have in common on the terminal: sentences, tables, errors, a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

BAD_INPUT = 2  # exit code
PACE = 30.0  # s


@contextmanager
def sentences(*kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of these kinds, what a user can put right, into one sentence and exit code 2 (typer.Exit)."""
    try:
        yield
    except kinds as error:
        complain(f"Error: {error}")
        raise typer.Exit(BAD_INPUT) from None


@contextmanager
def bar(quiet: bool, label: str = "", pace: float | None = None) -> Iterator[Callable[[float, str], None]]:
    """A progress bar on the error stream; the callback takes a fraction of the work and what is being done.

    pace [s] : the time over which the time left is judged, such as PACE; None does not show it.
    """
    columns: list[ProgressColumn] = [SpinnerColumn(), TextColumn("{task.description}", markup=False)]
    columns += [BarColumn(), TimeElapsedColumn()]
    if pace is not None:
        columns.append(TimeRemainingColumn())
    console, period = Console(stderr=True), pace or PACE
    with Progress(*columns, console=console, disable=quiet, transient=True, speed_estimate_period=period) as progress:
        task = progress.add_task(label, total=1.0)
        yield lambda fraction, what: progress.update(task, completed=fraction, description=what)


def complain(text: str) -> None:
    """Print a sentence on the error stream, in red."""
    Console(stderr=True, soft_wrap=True).print(text, style="red", markup=False, highlight=False)


def say(text: str) -> None:
    """Print a sentence."""
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


def say_notes(texts: Iterable[str]) -> None:
    """Print sentences as notes."""
    for text in texts:
        say(f"Note: {text}")


def say_written(*paths: Path | None) -> None:
    """Print the name of every file that was asked for and is there."""
    for path in paths:
        if path is not None and path.exists():
            say(f"wrote {path}")


def show(*tables: RenderableType) -> None:
    """Print tables."""
    console = Console()
    for table in tables:
        console.print(table)


def right(heading: str) -> Column:
    """A column of numbers."""
    return Column(heading, justify="right")
