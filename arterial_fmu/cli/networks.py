"""The commands ``list``, ``import`` and ``export``: whole networks."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Column, Table

from solver.errors import InputError
from solver.io.writing import check_destinations, check_new, write_whole
from solver.network.description import Network
from solver.network.files import bundled_names, dumps, find_network, from_sections, loads, read_network
from solver.network.importers import sections as written
from solver.network.importers.openbf import read_openbf
from solver.network.importers.sheet import read_sheet, to_sheet

from .terminal.console import put, right, say, say_notes, say_written, sentences, show
from .terminal.options import Force, Json, NetworkName

importers = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Make a network file of another format.",
)

Out = Annotated[Path | None, typer.Option(help="The network file to write; default: its name, in this folder.")]


def list_networks(as_json: Json = False) -> None:
    """List the included networks."""
    networks = [read_network(find_network(name)) for name in bundled_names()]
    if as_json:
        put({"networks": [_plain(n) | {"species": n.species, "reference": n.reference} for n in networks]})
        return
    source = Column("source", overflow="fold")  # a DOI is never cut
    table = Table("name", right("segments"), right("outlets"), "species", source, padding=0)
    for n in networks:
        table.add_row(n.name, str(len(n.segments)), str(len(n.outlets)), n.species, _short(n.reference))
    show(table)


def _plain(network: Network) -> dict[str, Any]:
    return {"name": network.name, "segments": len(network.segments), "outlets": len(network.outlets)}


def _short(reference: str) -> str:
    """First author, year and DOI or arXiv number of a reference; the whole reference if it has no year."""
    found = re.search(r"(\w+)(,.*?)?:.*?\((\d{4})\)(, (?:doi|arXiv):\S+\w)?", " ".join(reference.split()))
    return f"{found[1]}{' et al.' if found[2] else ''} ({found[3]}){found[4] or ''}" if found else reference


@importers.command("openbf")
def import_openbf(
    file: Annotated[Path, typer.Argument(help="openBF's YAML file, with its inflow file in the same folder.")],
    out: Out = None,
    as_run: Annotated[
        bool, typer.Option("--as-run", help="Import the values that openBF 2 uses where they differ from its file.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Import a network of openBF."""
    with sentences():
        check_destinations(out, given=[file])
        _write(read_openbf(file, as_run=as_run), file, out, force, as_json)


@importers.command("csv")
def import_csv(
    table: Annotated[Path, typer.Argument(help="A table with one row per vessel.")],
    out: Out = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Import a table of vessels."""
    with sentences():
        check_destinations(out, given=[table])
        sections = read_sheet(table)
        if set(sections["inlet"]) == {"segment"}:
            half_sine = "the table does not define the inlet, which gets a half-sine of 55 mL/s in 0.5 s"
            lines = '# inlet.Q_max = "90 mL/s" and # inlet.T = "0.8 s", or # inlet.Q = "flow.csv"'
            say_notes([f"{half_sine}; to define another, write above the table {lines}."], aside=as_json)
        folder = (out or Path()).parent
        _write(_relative_to(folder, sections, table.parent), table, out, force, as_json, folder)


def _relative_to(folder: Path, sections: written.Sections, old: Path) -> written.Sections:
    """Sections with the paths of their inflow files relative to another folder."""
    if folder.resolve() == old.resolve():
        return sections

    def moved(inlet: dict[str, Any]) -> dict[str, Any]:
        files = {key: inlet[key] for key in ("Q", "P") if isinstance(inlet.get(key), str)}
        return inlet | {key: Path(os.path.relpath(old / file, folder)).as_posix() for key, file in files.items()}

    further = {name: moved(inlet) for name, inlet in sections.get("inlets", {}).items()}
    return sections | {"inlet": moved(sections["inlet"])} | ({"inlets": further} if further else {})


def _write(
    sections: written.Sections, source: Path, out: Path | None, force: bool, as_json: bool, folder: Path | None = None
) -> None:
    """folder : of the files named in the sections; default: that of the source."""
    try:
        network = from_sections(sections, folder or source.parent)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    files = written.write(sections, out or Path(f"{network.name}.toml"), force=force)
    if as_json:
        put(_plain(network) | {"written": list(map(str, files))})
        return
    say_written(*files)
    say(f"{network.name}: {len(network.segments)} segments, {len(network.outlets)} outlets")


def export_csv(
    network: NetworkName,
    out: Annotated[
        Path | None,
        typer.Option(help="Table or network file (.toml) to write; default: a table with the network's name."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Write a network as a table, or as a network file."""
    with sentences():
        source = find_network(network)
        model = read_network(source)
        path = out or Path(f"{model.name}.csv")
        check_destinations(path, given=[network])
        text = _network_text(source, model) if path.suffix == ".toml" else to_sheet(model)
        check_new({path: text}, force)
        write_whole(path, text)
    if as_json:
        put(_plain(model) | {"written": [str(path)]})
    else:
        say_written(path)


def _network_text(source: Path, model: Network) -> str:
    """A network file that stands alone: the source's own text with its comments, or in SI if it names other files."""
    if source.suffix == ".toml":
        text = source.read_text(encoding="utf-8")
        with suppress(InputError):
            loads(text, source.name)
            return text
    return dumps(model)
