"""Commands run where the test runs, by the same command line: a new process for each costs a second of imports."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import typer
from typer.testing import CliRunner


def in_process(main: Callable[..., Any], arguments: Sequence[str | os.PathLike[str]]) -> Any:
    """Exit code, output and error output of a command, as ``subprocess.run`` gives them."""
    app = typer.Typer()
    app.command()(main)
    line = list(map(os.fspath, arguments))
    done = CliRunner().invoke(app, line)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return subprocess.CompletedProcess(line, done.exit_code, done.stdout, done.stderr)


def without_progress(said: str) -> str:
    """What a command said on the error stream but for lines of progress, which a slow computer sees."""
    return re.sub(r"^(?:(?:building|running|simulating) .*|building|.* \(\d+ %\))\n", "", said, flags=re.MULTILINE)


def refused_in_one_sentence(app: typer.Typer, arguments: Sequence[str], sentence: str, folder: Path) -> None:
    """Assert exit code 2, one sentence on the error stream that names the thing, and nothing new in the folder."""
    before = sorted(folder.rglob("*"))
    done = CliRunner(env={"COLUMNS": "160"}).invoke(app, [*arguments, "-q"])
    assert done.exit_code == 2, done.output
    assert sentence in done.stderr
    assert done.stderr.startswith("Error: ")
    assert len(done.stderr.strip().splitlines()) == 1
    assert sorted(folder.rglob("*")) == before
