"""Command line for whole networks: ``python -m solver list | import | export``."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from .console import right, say, say_written, sentences, show
from .files import bundled_names, find_network, from_sections, read_network, write_whole
from .importers import sections as written
from .importers.openbf import read_openbf
from .importers.sheet import read_sheet, to_sheet

app = typer.Typer(add_completion=False, no_args_is_help=True, help="Networks: which come along, in and out.")
importers = typer.Typer(no_args_is_help=True, help="Make a network file of another format.")
app.add_typer(importers, name="import")

Out = Annotated[Path | None, typer.Option(help="The network file to write; default: its name, here.")]


@app.command("list")
def list_networks() -> None:
    """The networks that come along."""
    table = Table("name", right("segments"), right("outlets"), "species", "source")
    for name in bundled_names():
        network = read_network(find_network(name))
        counts = (str(len(network.segments)), str(len(network.outlets)))
        table.add_row(name, *counts, network.species, _short(network.reference))
    show(table)


def _short(reference: str) -> str:
    """The first author, the year and the DOI or arXiv number of a reference; all of it where it has no year."""
    found = re.search(r"(\w+)(,.*?)?:.*?\((\d{4})\)(, (?:doi|arXiv):\S+\w)?", " ".join(reference.split()))
    return f"{found[1]}{' et al.' if found[2] else ''} ({found[3]}){found[4] or ''}" if found else reference


@importers.command("openbf")
def import_openbf(
    file: Annotated[Path, typer.Argument(help="openBF's YAML file; its inflow lies beside it.")],
    out: Out = None,
    as_run: Annotated[
        bool, typer.Option("--as-run", help="What openBF 2 computes where that differs from what the file says.")
    ] = False,
) -> None:
    """A network of openBF."""
    with sentences(ValueError):
        _write(read_openbf(file, as_run=as_run), file, out)


@importers.command("csv")
def import_csv(
    table: Annotated[Path, typer.Argument(help="A table with one row per vessel.")], out: Out = None
) -> None:
    """A table of vessels."""
    with sentences(ValueError):
        sections = read_sheet(table)
        if set(sections["inlet"]) == {"segment"}:
            say("Note: the table says nothing of the inlet; its default is a half-sine of 55 mL/s in 0.5 s. "
                "Add # inlet.Q_max and # inlet.T, or # inlet.Q.")  # fmt: skip
        folder = (out or Path()).parent
        _write(_seen_from(folder, sections, table.parent), table, out, folder)


def _seen_from(folder: Path, sections: written.Sections, old: Path) -> written.Sections:
    """Sections whose files of inflow are found from another folder."""
    if folder.resolve() == old.resolve():
        return sections

    def moved(inlet: dict[str, Any]) -> dict[str, Any]:
        files = {key: inlet[key] for key in ("Q", "P") if isinstance(inlet.get(key), str)}
        return inlet | {key: Path(os.path.relpath(old / file, folder)).as_posix() for key, file in files.items()}

    further = {name: moved(inlet) for name, inlet in sections.get("inlets", {}).items()}
    return sections | {"inlet": moved(sections["inlet"])} | ({"inlets": further} if further else {})


def _write(sections: written.Sections, source: Path, out: Path | None, folder: Path | None = None) -> None:
    """folder : where files that the sections name are looked for; default: beside the source."""
    try:
        network = from_sections(sections, folder or source.parent)
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    say_written(*written.write(sections, out or Path(f"{network.name}.toml")))
    say(f"{network.name}: {len(network.segments)} segments, {len(network.outlets)} outlets")


@app.command("export")
def export_csv(
    network: Annotated[str, typer.Argument(help="A network file, or the name of a bundled network.")],
    out: Annotated[Path | None, typer.Option(help="The table to write; default: the network's name, here.")] = None,
) -> None:
    """Write a network as a table with one row per vessel."""
    with sentences(ValueError):
        model = read_network(find_network(network))
        path = out or Path(f"{model.name}.csv")
        write_whole(path, to_sheet(model))
    say_written(path)
