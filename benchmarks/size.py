"""Cost against size: synthetic trees of 10 to 4000 segments.

    python benchmarks/size.py [--json FILE] [SEGMENTS ...]

CPU time of one thread of a step of 1 ms, the best of several stretches of a heart beat, and of building; the most
memory that building and stepping took. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import MACHINE, JsonFile, Row, show
from solver import Inlet, Junction, Network, Segment, Settings, Site, Windkessel
from solver.scheme.model import Model, build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.stage import operators
from solver.scheme.step import initial_state, step

SIZES = (10, 100, 300, 1000, 4000)
STRETCH, STRETCHES = 25, 8  # steps that are timed together, and how often
FORK = 2 ** (-1 / 3)  # radius after a fork in two, by Murray's law
RESISTANCE = 1.2e8  # Pa·s/m³ of all outlets together
COMPLIANCE = 1e-8  # m³/Pa of all outlets together


def fork(n: int) -> list[int]:
    """The parent of each segment but the first: every artery forks in two."""
    return [(i - 1) // 2 for i in range(1, n)]


def comb(n: int) -> list[int]:
    """One long artery with a branch at each of its joints."""
    return [i - 1 - (i + 1) % 2 for i in range(1, n)]


def tree(n: int, parents: Callable[[int], list[int]] = fork) -> Network:
    """A synthetic tree of n arteries of 5 cm with Windkessels, its root as wide as a human aorta; a site in each."""
    above = parents(n)
    children: dict[int, list[str]] = {}
    radius = [12e-3]
    for i, parent in enumerate(above, 1):
        children.setdefault(parent, []).append(f"S{i}")
        radius.append(max(radius[parent] * FORK, 1e-3) if parents is fork else 12e-3 if i % 2 == 0 else 3e-3)
    segments = tuple(Segment(f"S{i}", 0.05, R, 0.1 * R, 8e5, 8e3) for i, R in enumerate(radius))
    ends = [i for i in range(n) if i not in children]
    R, C = RESISTANCE * len(ends), COMPLIANCE / len(ends)
    return Network(
        name=f"{parents.__name__}_{n}",
        segments=segments,
        inlet=Inlet("S0", Q_max=2e-4, T=0.8),
        junctions=tuple(Junction((f"S{i}",), tuple(names)) for i, names in children.items()),
        outlets=tuple(Windkessel(f"S{i}", 0.1 * R, C, 0.9 * R) for i in ends),
        sites=tuple(Site(s.name, s.name) for s in segments),
        P_ref=1e4,
        P_0=1e4,
    )


def step_time(model: Model, network: Network) -> float:
    """CPU seconds of a step, with its outputs."""
    report, state, dt, seconds = reporter(model), initial_state(model), model.settings.dt, []
    for stretch in range(STRETCHES):
        Q = network.inlet.Q((stretch * STRETCH + np.arange(STRETCH)[:, None] + INFLOW_TIMES) * dt)
        start = time.process_time()
        for driven in Q:
            state = step(model, state, dt, driven)
            report(state)
        seconds.append((time.process_time() - start) / STRETCH)
    return min(seconds)


def measure(network: Network) -> tuple[float, float, float]:
    """CPU seconds of a step and of building the model with its operators, and the bytes that both took."""
    settings = Settings()
    start = time.process_time()
    model = build(network, settings=settings)
    operators(model, settings.dt)
    built = time.process_time() - start
    stepped = step_time(model, network)
    tracemalloc.start()
    model = build(network, settings=settings)
    step(model, initial_state(model), settings.dt, np.full(4, 1e-4))
    reporter(model)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return stepped, built, float(most)


def main(
    sizes: Annotated[list[int] | None, typer.Argument(help="Numbers of segments.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    rows, smallest = list[Row](), 0.0
    for parents in (fork, comb):
        for n in sizes or SIZES:
            stepped, built, most = measure(tree(n, parents))
            smallest = smallest or stepped
            note = f"{stepped / smallest:.1f} times the first; build {built:.2g} s, {most / 1e6:.0f} MB"
            rows.append(Row(f"a step of {n} segments, {parents.__name__}", 1e3 * stepped, "ms", None, note))
    show(rows, MACHINE, json_file)


if __name__ == "__main__":
    typer.run(main)
