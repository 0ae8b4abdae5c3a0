"""How far a command is, on the error stream: a bar in a terminal, lines in a file or a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer
from time import monotonic

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Report = Callable[[float, str], None]  # takes a fraction of the work and what is being done
PACE = 30.0  # s
FIRST, NEXT = 2.0, 10.0  # s before the first line, and between lines


@contextmanager
def bar(quiet: bool, label: str = "", pace: float | None = None) -> Iterator[Report]:
    """A progress bar, gone at the end; where the error stream is no terminal, a line from time to time.

    label : what is done before anything else is reported. pace [s] : the time over which the time left is judged, such
    as PACE; None does not show it.
    """
    console = Console(stderr=True, soft_wrap=True)
    if quiet:
        yield lambda fraction, what: None
    elif console.is_terminal:
        with _drawn(console, pace) as progress:
            task = progress.add_task(label, total=1.0)
            yield lambda fraction, what: progress.update(task, completed=fraction, description=what)
    else:
        report = lines(lambda text: console.print(text, markup=False, highlight=False))
        first = Timer(FIRST, report, (0.0, label))
        first.daemon = True
        if label:
            first.start()
        try:
            yield report
        finally:
            first.cancel()


def _drawn(console: Console, pace: float | None) -> Progress:
    columns: list[ProgressColumn] = [SpinnerColumn(), TextColumn("{task.description}", markup=False)]
    columns += [BarColumn(), TimeElapsedColumn()]
    if pace is not None:
        columns.append(TimeRemainingColumn())
    return Progress(*columns, console=console, transient=True, speed_estimate_period=pace or PACE)


def lines(write: Callable[[str], None], clock: Callable[[], float] = monotonic) -> Report:
    """Progress as lines: none of what takes less than FIRST, then one every NEXT seconds. clock : [s]."""
    due = clock() + FIRST

    def report(fraction: float, what: str) -> None:
        nonlocal due
        if clock() >= due:
            write(f"{what} ({100 * fraction:.0f} %)" if fraction > 0.0 else what)
            due = clock() + NEXT

    return report
