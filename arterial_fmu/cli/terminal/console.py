"""Terminal output shared by all commands: sentences, tables, errors, JSON."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.console import Console, RenderableType
from rich.table import Column

from solver.errors import InputError
from solver.io.exit_codes import ExitCode

Array = np.ndarray


@contextmanager
def sentences(*kinds: type[Exception], interrupted: str = "nothing was written.") -> Iterator[None]:
    """Turn InputError and errors of these kinds, which a user can correct, into one sentence and an exit code, that of
    the error if it has one.

    interrupted : the sentence after Ctrl-C.
    """
    expected: tuple[type[Exception], ...] = (InputError, *kinds)
    try:
        yield
    except expected as error:
        complain(f"Error: {error}")
        raise typer.Exit(getattr(error, "exit_code", ExitCode.BAD_INPUT)) from None
    except KeyboardInterrupt:
        complain(f"Interrupted: {interrupted}")
        raise typer.Exit(ExitCode.INTERRUPTED) from None


@contextmanager
def faults() -> Iterator[None]:
    """Turn any other exception, a bug of the program, into a traceback, a request and an exit code."""
    try:
        yield
    except Exception:
        traceback.print_exc()
        complain(
            "This is a bug in the program, not an error in your input: please report it, with your command and the "
            "lines above. No file was left half written."
        )
        raise SystemExit(ExitCode.FAULT) from None


def complain(text: str) -> None:
    """Print a sentence on the error stream, in red."""
    Console(stderr=True, soft_wrap=True).print(text, style="red", markup=False, highlight=False)


class _Terminal(Console):
    """A console that passes on the error of a closed output."""

    def on_broken_pipe(self) -> None:
        raise  # what is being handled


@contextmanager
def _printing() -> Iterator[None]:
    """If the output cannot be written, end with an exit code, after a sentence unless its reader has closed it."""
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for buffered output
        if isinstance(error, BrokenPipeError):
            raise typer.Exit(ExitCode.NOT_READ) from None
        complain(f"Error: the output cannot be written ({error.strerror}); check where it goes.")
        raise typer.Exit(ExitCode.BAD_INPUT) from None


def say(text: str, aside: bool = False) -> None:
    """Print a sentence; aside: on the error stream."""
    with _printing():
        _Terminal(soft_wrap=True, stderr=aside).print(text, markup=False, highlight=False)


def say_notes(texts: Iterable[str], aside: bool = False) -> None:
    """Print sentences as notes; aside: on the error stream, where the output is JSON."""
    for text in texts:
        say(f"Note: {text}", aside)


def say_written(*paths: Path | None, aside: bool = False) -> None:
    """Print the name of every requested file that exists; aside: on the error stream."""
    for path in paths:
        if path is not None and path.exists():
            say(f"wrote {path}", aside)


def put(document: str | Mapping[str, Any]) -> None:
    """Print JSON, a text or plain data, and nothing else."""
    text = (
        document if isinstance(document, str) else json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False)
    )
    with _printing():
        typer.echo(text.rstrip())


def conclude(
    as_json: bool, quiet: bool, document: Callable[[], str | Mapping[str, Any]], shown: Callable[[], None],
    notes: Iterable[str] = (), written: Iterable[Path | None] = (),
) -> None:  # fmt: skip
    """The end of a command: its result as JSON, or else as ``shown``, then its notes and the files that it wrote."""
    if as_json:
        put(document())
    elif not quiet:
        shown()
    if not quiet:
        say_notes(notes, aside=as_json)
        say_written(*written, aside=as_json)


def ranges(time: Array, columns: Mapping[str, Array], units: Mapping[str, str]) -> dict[str, Any]:
    """Unit, minimum, maximum and time mean of every variable (n,) at times (n,) [s]; for JSON."""
    return {
        name: {
            "unit": units[name],
            "min": float(values.min()),
            "max": float(values.max()),
            "mean": float(np.trapezoid(values, time) / (time[-1] - time[0])),
        }
        for name, values in columns.items()
    }


def show(*tables: RenderableType) -> None:
    """Print tables."""
    console = _Terminal()
    with _printing():
        for table in tables:
            console.print(table)


def right(heading: str) -> Column:
    """A column of numbers."""
    return Column(heading, justify="right")
