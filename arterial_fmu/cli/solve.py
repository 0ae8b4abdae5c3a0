"""The command ``solve``: simulate a network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from solver.errors import InputError, NonPhysicalState
from solver.io.writing import check_destinations
from solver.muscl.settings import MusclSettings
from solver.network.description import Network
from solver.network.doubts import network_doubts
from solver.network.files import find_network, parse_quantity, read_network
from solver.quantities.legible import number
from solver.quantities.text import assignments, typed_quantity
from solver.quantities.units import MMHG
from solver.scheme.model import Settings
from solver.schemes import AnySettings
from solver.simulate import NotPeriodic, Waveforms, simulate, simulate_periodic

from .terminal.console import conclude, ranges, right, sentences, show
from .terminal.options import Json, NetworkName, Quiet
from .terminal.progress import bar


def main(
    network: NetworkName,
    out: Annotated[Path | None, typer.Option(help="Write the waveforms to this CSV file.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help='Change a parameter, e.g. --set "CA.phi0=0 kPa*s"; repeatable.')
    ] = None,
    duration: Annotated[
        str | None, typer.Option(help='Run this long, e.g. "2 s"; default: until the beats repeat.')
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Start state: rest, or periodic (near the periodic beat); default: the faster one."),
    ] = None,
    dt: Annotated[str, typer.Option(help="Time step.")] = "1 ms",
    element_length: Annotated[str | None, typer.Option(help="Maximum element length; default: 5 cm.")] = None,
    scheme: Annotated[
        str, typer.Option(help="Numerical scheme: staggered, or muscl (the paper's finite volumes).")
    ] = "staggered",
    cell: Annotated[str | None, typer.Option(help="muscl: maximum cell length; default: 5 mm.")] = None,
    cfl: Annotated[float | None, typer.Option(help="muscl: CFL number, at most 0.45; default: 0.45.")] = None,
    ends: Annotated[
        str | None,
        typer.Option(help="muscl: viscous pressure at the ends, coupled (default) or neumann (as published)."),
    ] = None,
    slopes: Annotated[
        str | None,
        typer.Option(help="muscl: slopes in the cells, van Albada (default), minmod, monotonized central or central."),
    ] = None,
    tolerance: Annotated[float, typer.Option(help="Maximum relative change between the last two beats.")] = 1e-5,
    max_beats: Annotated[int, typer.Option(help="Maximum number of beats.")] = 100,
    backend: Annotated[
        str, typer.Option(help="numpy, native (the compiled engine), or auto (native if it supports this network).")
    ] = "auto",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a network of arteries and report pressure, flow and radius at its sites."""
    with sentences(NonPhysicalState, NotPeriodic):
        check_destinations(out, given=[network])
        model = read_network(find_network(network))
        seconds = parse_quantity(dt, "s", "--dt")
        settings = _settings(scheme, seconds, element_length, cell, cfl, ends, slopes)
        model = model.with_parameters(_assignments(model, set_ or []))
        result = _run(model, scheme, settings, duration, start, tolerance, max_beats, backend, quiet)
        if out is not None:
            result.to_csv(out)
    notes = [*network_doubts(model), *result.notes]
    conclude(as_json, quiet, lambda: _plain(model, result, notes, out), lambda: _show(model, result), notes, [out])


def _settings(
    scheme: str, dt: float, element_length: str | None, cell: str | None, cfl: float | None, ends: str | None,
    slopes: str | None,
) -> AnySettings:  # fmt: skip
    """The settings of a scheme; raises for an option of the other one."""
    volumes = {"--cell": cell, "--cfl": cfl, "--ends": ends, "--slopes": slopes}
    muscl = scheme == "muscl"
    for option, value in ({"--element-length": element_length} if muscl else volumes).items():
        if value is not None:
            whose = "staggered" if muscl else "muscl"
            raise InputError(f"{option} belongs to --scheme {whose}; select that scheme, or omit {option}.")
    if not muscl:
        return Settings(dt, typed_quantity(element_length or "5 cm", "m", "--element-length"))
    own, length = MusclSettings(), typed_quantity(cell or "5 mm", "m", "--cell")
    return MusclSettings(dt, length, own.cfl if cfl is None else cfl, ends or own.ends, slopes or own.slopes)


def _assignments(network: Network, texts: list[str]) -> dict[str, float]:
    """{"CA.phi0": 0.0} from ["CA.phi0=0 kPa*s"]."""
    units = {name: (q.unit, q.display) for name, q in network.parameter_quantities().items()}
    found = assignments(texts, units)
    return {name: float(value) if name in units else 0.0 for name, value in found.items()}  # others are rejected


def _run(
    network: Network, scheme: str, settings: AnySettings, duration: str | None, start: str | None, tolerance: float,
    max_beats: int, backend: str, quiet: bool,
) -> Waveforms:  # fmt: skip
    with bar(quiet, f"simulating {network.name}") as progress:
        how: dict[str, Any] = {"settings": settings, "scheme": scheme, "backend": backend, "progress": progress}
        if duration is not None:
            seconds = parse_quantity(duration, "s", "--duration")
            return simulate(network, duration=seconds, start=start or "rest", **how)
        return simulate_periodic(network, tolerance=tolerance, max_beats=max_beats, start=start, **how)


def _plain(network: Network, result: Waveforms, notes: list[str], out: Path | None) -> dict[str, Any]:
    """The run as plain data: the variables of its last beat, or of the whole run."""
    return {
        "network": network.name,
        "beats": result.beats,
        "change": None if math.isnan(result.change) else result.change,
        "variables": ranges(result.time, result.columns, result.units),
        "backend": result.backend,
        "notes": notes,
        "written": [] if out is None else [str(out)],
    }


def _show(network: Network, result: Waveforms) -> None:
    periodic = not math.isnan(result.change)
    how = (
        f"{result.beats} beats, last change {number(result.change, 2)}"
        if periodic
        else f"{number(result.time[-1], 4)} s from the start"
    )
    headings = ("P min, mmHg", "P max, mmHg", "Q max, mL/s", "R mean, mm")
    table = Table("site", *map(right, headings), title=f"{network.name}: {how}")
    for site in network.sites:
        P, Q, R = (result[f"{site.name}.{kind}"] for kind in "PQR")
        numbers = (f"{P.min() / MMHG:z.2f}", f"{P.max() / MMHG:z.2f}", f"{Q.max() * 1e6:z.3f}", f"{R.mean() * 1e3:.3f}")
        table.add_row(site.name, *numbers)
    show(table)
