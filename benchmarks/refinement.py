"""Whether refined runs hold: every network, with elastic and with viscoelastic walls, in ever shorter steps.

    python benchmarks/refinement.py [--rows FILE] [--small] [NETWORKS ...]

Three beats from rest with the default elements and with half of them. What is shown of a run: "ok" and the part of the
flow that is in the polynomial of highest degree of any element (largest of the last beat, relative to the largest flow
of that element in the beat); or when it broke down. Networks without viscosity of their own get φ0/E = 12.5 ms as
viscoelastic ones, which is that of the human network. FILE keeps what was measured, so that a run can be continued.
"""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.table import Small, continued, start, tabulate
from solver import Network, NonPhysicalState, Settings, load
from solver.network.coefficients import Parameters
from solver.network.inflow import drives_of
from solver.scheme.model import Model, build
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import State, initial_state, step
from solver.tracing.native import Backend

NETWORKS = (
    "sheep", "sheep_nonlinear", "human", "cca", "uta", "ibif", "wang55", "matthys37", "circle_of_willis", "adan56"
)  # fmt: skip
STEPS = (2.0, 1.0, 0.5, 0.25, 0.1)  # ms
LENGTHS = (1.0, 0.5)  # of the default element
BEATS, LOOKS = 3, 64  # beats from rest, and how often in the last one the highest degree is looked at
USUAL = 12.5e-3  # s: φ0/E of walls whose network has no viscosity


def walls(network: Network, kind: str) -> Parameters:
    """The parameters that make all walls elastic, or viscoelastic."""
    if kind == "elastic":
        return {f"{s.name}.{name}": 0.0 for s in network.segments for name in ("phi0", "phiNL")}
    if any(s.phi0 for s in network.segments):
        return {}
    return {f"{s.name}.phi0": USUAL * s.E for s in network.segments}


def highest(model: Model, Q: np.ndarray) -> np.ndarray:
    """The part of the polynomial of highest degree in Q : (…, N+1), at the ends of the element (…,) [m³/s]."""
    x = model.mesh.element.x_lobatto
    legendre = np.polynomial.legendre.legvander(x, len(x) - 1)
    return np.abs(np.linalg.solve(legendre, Q[..., None])[..., -1, 0])


def run(name: str, kind: str, dt: float, length: float, beats: int = BEATS) -> dict[str, Any]:
    """One row: the part of the highest degree and where it is largest, or when and where the run broke down."""
    network, settings = load(name), Settings(dt=1e-3 * dt, element_length=length * Settings().element_length)
    row: dict[str, Any] = {"network": name, "walls": kind, "dt": dt, "length": length}
    model = build(network, walls(network, kind), settings)
    backend, drives = Backend.of("auto", model, settings.dt), drives_of(network, None, 1)
    n, begun, state = round(network.inlet.T / settings.dt), time.process_time(), initial_state(model)
    looks = np.unique(np.linspace(0, n, LOOKS + 1).round().astype(int))
    ends = np.concatenate([np.arange(1, beats) * n, (beats - 1) * n + looks[1:]])
    size, high = np.zeros(model.mesh.n_elements), np.zeros(model.mesh.n_elements)
    try:
        for end in ends:
            state = advance(model, backend, drives, settings.dt, state, int(end))
            if end > (beats - 1) * n:
                size = np.maximum(size, np.abs(state.Q[0]).max(axis=-1))
                high = np.maximum(high, highest(model, state.Q[0]))
    except NonPhysicalState as error:
        return {**row, "failed": str(error), "seconds": time.process_time() - begun}
    worst = int(np.argmax(high / size))
    place = network.segments[model.mesh.segment[worst]].name
    part = float(high[worst] / size[worst])
    return {**row, "part": part, "where": place, "halved": state.halved, "seconds": time.process_time() - begun}


def advance(model: Model, backend: Backend, drives: Any, dt: float, state: State, end: int) -> State:
    """Steps until the given one."""
    done = round(state.t / dt)
    drive = drives((np.arange(done, end)[:, None] + INFLOW_TIMES) * dt)
    table = np.empty((end - done, 1, len(model.network.output_units())))
    at = 0
    while at < len(drive):
        many, state = backend.steps(state, drive[at:], table[at:])
        if not many:
            state, many = step(model, state, dt, drive[at]), 1
        at += many
    return state


def main(
    networks: Annotated[list[str] | None, typer.Argument(help="Names.")] = None,
    rows: Annotated[Path, typer.Option(help="What was measured; made, and continued.")] = Path("build/refinement.json"),
    small: Small = False,
) -> None:
    """Measure what is not yet in the rows, and print."""
    cases = [(kind, dt, length) for kind in ("elastic", "viscoelastic") for length in LENGTHS for dt in STEPS]
    each = [(name, *case) for name in networks or NETWORKS for case in (cases[:1] if small else cases)]
    keys = ("network", "walls", "dt", "length")
    found = continued(rows, keys, each, partial(run, beats=1 if small else BEATS))
    columns = [f"{dt:g} ms, {5 * length:g} cm" for length in LENGTHS for dt in STEPS]
    own = {tuple(row[key] for key in keys): row for row in found}
    lines = dict.fromkeys((row["network"], kind) for row in found for kind in ("elastic", "viscoelastic"))
    cells = [(*line, *(shown(own.get((*line, dt, length))) for length in LENGTHS for dt in STEPS)) for line in lines]
    tabulate("highest degree, part of the flow; or broken down", ("network", "walls", *columns), cells, left=2)


def shown(row: dict[str, Any] | None) -> str:
    """A cell of the table."""
    if row is None:
        return ""
    return "broken" if "failed" in row else f"{row['part']:.0e}" + (f" h{row['halved']}" if row["halved"] else "")


if __name__ == "__main__":
    start(main)
