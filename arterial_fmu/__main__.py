"""The command line: ``arterial-fmu COMMAND``, also ``python -m arterial_fmu COMMAND``."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from . import __version__
from .cli.commands import COMMANDS, load

_APART = "ARTERIAL_FMU_APART"  # in the environment of that process
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_PR_SET_PDEATHSIG = 1  # of linux/prctl.h


class _Lazy(TyperGroup):
    """Names and sentences for --help and completion; the command itself is imported when it is run."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, stub, rest = super().resolve_command(ctx, args)
        return name, stub if name is None else load(name), rest


app = typer.Typer(cls=_Lazy, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False)


def _version(wanted: bool) -> None:
    if wanted:
        from solver.tracing.native import available  # takes a tenth of a second

        typer.echo(f"arterial-fmu {__version__}\nsteps by {available()}")
        raise typer.Exit


@app.callback()
def everything(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Pulse waves in viscoelastic arteries: simulate, build FMUs, fit recordings, find what a model lacks."""


def _stub() -> None:
    """Placeholder for a command that is not yet imported."""


for _name, _command in COMMANDS.items():
    app.command(_name, help=_command.does)(_stub)


# --- a command in its own process, so that its death can be reported --------------------------------------------------


def _is_apart() -> bool:
    """Whether this is that process."""
    return _APART in os.environ


def _end_with_parent() -> None:
    """Treat the end of the parent process as Ctrl-C, even if it was killed; on Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


def _run_apart(words: Sequence[str]) -> int:
    """Run ``arterial-fmu WORDS`` in its own process; return its exit code, after a sentence if it died.

    The process has its own session, so that it receives Ctrl-C once, from here. Any end of this process is Ctrl-C to
    it.
    """
    line = [sys.executable, "-m", "arterial_fmu", *words]
    process = subprocess.Popen(line, env={**os.environ, _APART: "1"}, start_new_session=True)
    came: list[int] = []

    def pass_on(number: int, _frame: Any) -> None:
        came.append(number)
        process.send_signal(signal.SIGINT)

    for number in _ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, pass_on)
    code = process.wait()
    if came and code in (128 + signal.SIGINT, -signal.SIGINT):
        return 128 + came[0]
    if code >= 0:
        return code
    from arterial_fmu.cli.terminal.console import complain
    from solver.io.exit_codes import HostDied

    died = HostDied(next((word for word in words if word.lower().endswith(".fmu")), "the FMU"), code)
    complain(f"Error: {died}")
    return int(died.exit_code)


def main(words: Sequence[str] | None = None) -> None:
    """The console script. words : by default those of the command line.

    An FMU may end the process that runs it, so ``run`` has its own process.
    """
    words = sys.argv[1:] if words is None else list(words)
    if _is_apart():
        _end_with_parent()
    elif words[:1] == ["run"]:
        raise SystemExit(_run_apart(words))
    try:
        app(words, prog_name="arterial-fmu")
    except Exception:
        from arterial_fmu.cli.terminal.console import faults  # takes a tenth of a second

        with faults():
            raise


if __name__ == "__main__":
    main()
