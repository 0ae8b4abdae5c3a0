"""Progress of a command on the error stream: a bar in a terminal, lines in a file or a pipe."""

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

from solver.io.interrupts import interrupts_again

Report = Callable[[float, str], None]  # takes the finished fraction and the current task
PACE = 30.0  # s
FIRST, NEXT = 2.0, 10.0  # s before the first line, and between lines


@contextmanager
def bar(quiet: bool, label: str = "", pace: float | None = None) -> Iterator[Report]:
    """A progress bar, removed at the end; occasional lines if the error stream is not a terminal.

    label : the first task. pace [s] : the averaging time for the estimate of the remaining time, such as PACE; None
    hides the estimate. A report raises KeyboardInterrupt if an earlier one was lost.
    """
    with interrupts_again() as due, _shown(quiet, label, pace) as report:

        def reported(fraction: float, what: str) -> None:
            due()
            report(fraction, what)

        yield reported


@contextmanager
def _shown(quiet: bool, label: str, pace: float | None) -> Iterator[Report]:
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
    """Progress as lines: none before FIRST, then one every NEXT seconds. clock : [s]."""
    due = clock() + FIRST

    def report(fraction: float, what: str) -> None:
        nonlocal due
        if clock() >= due:
            write(f"{what} ({100 * fraction:.0f} %)" if fraction > 0.0 else what)
            due = clock() + NEXT

    return report
