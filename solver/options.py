"""Arguments and options that several commands have, and how a shell completes them."""

from __future__ import annotations

from collections.abc import Callable
from glob import escape, glob
from pathlib import Path
from typing import Annotated, Any

import typer

from .files import bundled_names

_MODELS = (".toml", ".fmu")


def networks_for(incomplete: str) -> list[str]:
    """How a shell completes the name of a network: those that come along, and files."""
    return [name for name in bundled_names() if name.startswith(incomplete)] + files_for(incomplete)


def files_for(incomplete: str) -> list[str]:
    """How a shell completes a network file or an FMU; folders, too."""
    found = map(Path, sorted(glob(f"{escape(incomplete)}*")))
    return [f"{path}/" if path.is_dir() else str(path) for path in found if path.is_dir() or path.suffix in _MODELS]


NetworkName = Annotated[
    str, typer.Argument(help="A network file (TOML), or a bundled network: see list.", autocompletion=networks_for)
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables and no notes.")]
Json = Annotated[
    bool, typer.Option("--json", help="Print the result as one JSON object; all else goes to the error stream.")
]


def one_command(function: Callable[..., Any], name: str | None = None) -> typer.Typer:
    """A command line of one command."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(name)(function)
    return app
