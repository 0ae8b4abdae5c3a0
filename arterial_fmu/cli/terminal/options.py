"""Arguments and options shared by several commands, and their completion in a shell."""

from __future__ import annotations

from collections.abc import Callable
from glob import escape, glob
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from solver.network.files import bundled_names

_MODELS = (".toml", ".fmu")


def networks_for(incomplete: str) -> list[str]:
    """Shell completion of the name of a network: included networks and files."""
    return [name for name in bundled_names() if name.startswith(incomplete)] + files_for(incomplete)


def files_for(incomplete: str) -> list[str]:
    """Shell completion of a network file or an FMU, including folders."""
    found = map(Path, sorted(glob(f"{escape(incomplete)}*")))
    return [f"{path}/" if path.is_dir() else str(path) for path in found if path.is_dir() or path.suffix in _MODELS]


NetworkName = Annotated[
    str,
    typer.Argument(help="A network file (TOML), a bundled network (see list), or an FMU.", autocompletion=networks_for),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress, no tables and no notes.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing file that may have been edited.")]
Json = Annotated[
    bool,
    typer.Option(
        "--json", is_eager=True, help="Print the result as one JSON object; everything else goes to the error stream."
    ),
]


class DefaultGroup(TyperGroup):
    """A group whose first command is the default: ``build sheep`` is ``build network sheep``."""

    @property
    def _default(self) -> tuple[str, Any]:
        return next(iter(self.commands.items()))

    def parse_args(self, context: Any, words: list[str]) -> list[str]:
        named = words[0] in (*self.commands, "--help") if words else context.resilient_parsing
        return super().parse_args(context, words if named else [self._default[0], *words])

    def shell_complete(self, context: Any, incomplete: str) -> list[Any]:
        first = self._default[1].params[0]
        return [*super().shell_complete(context, incomplete), *first.shell_complete(context, incomplete)]

    def format_options(self, context: Any, formatter: Any) -> None:
        """The commands, and the options of the first."""
        super().format_options(context, formatter)
        name, command = self._default
        rows = [each.get_help_record(context) for each in command.params]
        with formatter.section(f"Options of {name}, a word that may be left out"):
            formatter.write_dl([row for row in rows if row is not None])


def one_command(function: Callable[..., Any], name: str | None = None) -> typer.Typer:
    """A command line of one command."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(function)
    return app
