"""The command ``build``: FMUs of arteries, hearts, bodies and whole systems."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
import typer.core

from arterial_fmu.cli.terminal.console import put, say, say_notes, sentences
from arterial_fmu.cli.terminal.options import DefaultGroup, Json, NetworkName, Quiet
from arterial_fmu.cli.terminal.progress import bar
from build_fmu import build, build_model, build_native, build_native_model, build_system
from fmu_src.contents import models
from fmu_src.contents.models import FMUContents
from fmu_src.native.binaries import PLATFORMS
from fmu_src.variables.variable import Variable
from solver.errors import InputError
from solver.io.writing import check_destinations
from solver.lumped.species import SPECIES
from solver.network.doubts import network_doubts
from solver.network.files import find_network, read_network
from solver.quantities.text import assignments
from solver.scheme.model import Settings

app = typer.Typer(
    cls=DefaultGroup,
    add_completion=False,
    rich_markup_mode=None,
    help="Build FMUs of arteries, hearts, bodies and whole systems.",
)

_SPECIES = "|".join(SPECIES)
SpeciesName = Annotated[str, typer.Option("--species", metavar=_SPECIES, help="Species of the heart or body.")]
Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help='A start value: "heart.rate=1.3 Hz".')
]
Out = Annotated[Path, typer.Option(help="Directory of the FMU.")]
ExecutionTool = Annotated[bool, typer.Option(help="Set needsExecutionTool in the FMU; some importers reject it.")]
Native = Annotated[bool, typer.Option("--native", help="Build an FMU that needs no Python on its host.")]
Standard = Annotated[int, typer.Option("--fmi", metavar="2|3", help="With --native: version of FMI.")]
Platforms = Annotated[
    str,
    typer.Option(
        "--platforms",
        metavar="|".join(PLATFORMS),
        help="With --native: platforms, separated by commas; default: this machine.",
    ),
]


@app.command("network")
def main(
    network: NetworkName = "sheep",
    out: Out = Path("dist"),
    execution_tool: ExecutionTool = True,
    inlet: Annotated[
        str | None, typer.Option(metavar="flow|pressure", help="Drive of the inlet; default: as in the network file.")
    ] = None,
    change: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help='A start value, such as "CA.phi0=0 kPa*s".')
    ] = None,
    native: Native = False,
    fmi: Standard = 2,
    platforms: Platforms = "",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Build the FMU of a network of arteries. This is the default: the word network is optional."""
    with sentences(), bar(quiet, "building"):
        if inlet not in (None, "flow", "pressure"):
            raise InputError(f"--inlet {inlet}: must be flow or pressure.")
        arteries = read_network(find_network(network))
        check_destinations(out / f"{arteries.name}.fmu", given=[network], folders=True)
        arteries = replace(arteries, inlet=replace(arteries.inlet, causality=inlet or arteries.inlet.causality))
        native = _is_native(native, fmi, platforms)
        starts = _start_values(models.arteries_model(arteries, Settings()).table, change or [])
        if native:
            target = build_native(arteries, out, None, starts, fmi, _listed(platforms))
        else:
            target = build(arteries, out, execution_tool=execution_tool, starts=starts)
    _report(target, as_json, quiet)
    if not quiet:
        say_notes(network_doubts(models.given_arteries(arteries, Settings(), starts)[0]), aside=as_json)


def _is_native(native: bool, fmi: int, platforms: str) -> bool:
    """Raises ValueError for options without ``--native``."""
    if not native and (fmi != 2 or platforms):
        raise InputError("--fmi and --platforms: for FMUs that need no Python; add --native.")
    return native


def _listed(platforms: str) -> list[str]:
    return [name for name in platforms.split(",") if name]


def _start_values(table: Iterable[Variable], changes: Sequence[str]) -> dict[str, float | str]:
    """Start values from texts such as "CA.phi0=0 kPa*s". Raises ValueError."""
    numbers = {v.name: v.quantity for v in table if v.quantity is not None}
    return assignments(changes, {name: (q.unit, q.display) for name, q in numbers.items()})


def _lumped(model: Callable[..., FMUContents]) -> Callable[..., None]:
    """The command that builds a heart or a body."""

    def command(
        species: SpeciesName = "human",
        out: Out = Path("dist"),
        native: Native = False,
        fmi: Standard = 2,
        platforms: Platforms = "",
        execution_tool: ExecutionTool = True,
        change: Changes = None,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        with sentences(), bar(quiet, "building"):
            known = model(species)
            check_destinations(out / f"{known.name}.fmu", folders=True)
            starts = _start_values(known.table, change or [])
            if _is_native(native, fmi, platforms):
                target = build_native_model(model(species, starts, fmi), out, _listed(platforms))
            else:
                target = build_model(model(species, starts), out, execution_tool)
        _report(target, as_json, quiet)

    return command


app.command("heart", help="Build the FMU of a left heart.")(_lumped(models.heart_model))
_VEINS = "Build the FMU of the veins, which close the volume between arteries and heart."
app.command("body", help=_VEINS)(_lumped(models.body_model))


@app.command("system")
def system_command(
    network: NetworkName = "human",
    species: Annotated[
        str | None, typer.Option(metavar=_SPECIES, help="Species of heart and body; default: from the network's name.")
    ] = None,
    out: Out = Path("dist"),
    execution_tool: ExecutionTool = True,
    native: Native = False,
    platforms: Platforms = "",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Build heart, arteries and body as one SSP."""
    with sentences(), bar(quiet, "building heart, arteries and body"):
        arteries = read_network(find_network(network))
        check_destinations(out / f"{arteries.name}.ssp", folders=True)
        native = _is_native(native, 2, platforms)
        target = build_system(arteries, species, out, execution_tool, native, _listed(platforms))
    _report(target, as_json, quiet)


def _report(target: Path, as_json: bool, quiet: bool) -> None:
    size = target.stat().st_size
    if as_json:
        put({"written": [str(target)], "bytes": size})
    elif not quiet:
        say(f"wrote {target} ({size / 1000:.0f} kB)")
