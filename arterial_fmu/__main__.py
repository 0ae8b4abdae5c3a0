"""The command line: ``arterial-fmu COMMAND``, also ``python -m arterial_fmu COMMAND``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from . import __version__
from .cli.apart import end_with_parent, is_apart, run_apart
from .cli.commands import COMMANDS, load


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


def main(words: Sequence[str] | None = None) -> None:
    """The console script. words : by default those of the command line.

    An FMU may end the process that runs it, so ``run`` has its own process.
    """
    words = sys.argv[1:] if words is None else list(words)
    if is_apart():
        end_with_parent()
    elif words[:1] == ["run"]:
        raise SystemExit(run_apart(words))
    try:
        app(words, prog_name="arterial-fmu")
    except Exception:
        from arterial_fmu.cli.terminal.console import faults  # takes a tenth of a second

        with faults():
            raise


if __name__ == "__main__":
    main()
