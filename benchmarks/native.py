"""The compiled engine against NumPy: CPU time of a step with its outputs in one run, and the difference of the results;
and the cost against size, on synthetic trees of 10 to 4000 segments. Beats by harmonic balance: benchmarks/balance.py.

    python benchmarks/native.py [--json FILE] [--small]

One thread; the best of several stretches of a beat, NumPy and the engine alternately. Recording is the cost of the
first model of a kind, binding that of each further one. Nothing here is asserted: see the tests.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.speed import ELASTIC, MANY, SHEEP
from benchmarks.table import MACHINE, JsonFile, Row, Small, show, start
from solver import Inlet, Junction, Network, Segment, Settings, Site, Windkessel, load
from solver.network.coefficients import Parameters
from solver.network.inflow import drives_of
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.stage import operators
from solver.scheme.step import initial_state, step
from solver.tracing.native import Engine, NoEngine, library

SIZES = (10, 100, 300, 1000, 4000)  # of synthetic trees
FORK = 2 ** (-1 / 3)  # radius after a fork in two, by Murray's law
RESISTANCE = 1.2e8  # Pa·s/m³ of all outlets together
COMPLIANCE = 1e-8  # m³/Pa of all outlets together
STRETCH, STRETCHES = 50, 6  # steps that are timed together, and how often


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


class Cost(NamedTuple):
    """CPU seconds of a step by NumPy and by the engine, of recording, of binding and of building the model with its
    operators; the largest difference, by the pulse of a channel of its kind; the most bytes that building and a step
    took."""

    numpy: float
    native: float
    record: float
    bind: float
    apart: float
    build: float
    bytes: float


def measure(network: Network, parameters: Parameters | None, settings: Settings, stretches: int) -> Cost:
    """The cost of steps of a network, from rest on."""
    begun, dt = time.process_time(), settings.dt
    model = build(network, parameters, settings)
    operators(model, dt)
    built, made = time.process_time() - begun, list[float]()
    for _ in range(2):
        start = time.process_time()
        engine = Engine(model, dt)
        made.append(time.process_time() - start)
    report, drives = reporter(model), drives_of(network, None, model.coefficients.B)
    drive = drives((np.arange(stretches * STRETCH)[:, None] + INFLOW_TIMES) * dt)
    tables = np.empty((2, len(drive), model.coefficients.B, len(report.names)))
    states, seconds = [initial_state(model)] * 2, [list[float](), list[float]()]
    for k in range(0, len(drive), STRETCH):
        start = time.process_time()
        for i in range(k, k + STRETCH):
            states[0] = step(model, states[0], dt, drive[i])
            tables[0, i] = report(states[0])
        seconds[0].append(time.process_time() - start)
        start = time.process_time()
        done, states[1] = engine._steps(states[1], drive[k : k + STRETCH], tables[1, k : k + STRETCH])
        seconds[1].append(time.process_time() - start)
        if done < STRETCH:
            raise SystemExit(f"{network.name}: the engine stopped at step {k + done}.")
    kinds = np.array([name[-1] for name in report.names])
    scale = np.array([np.ptp(tables[0][..., kinds == kind], axis=0).max() for kind in kinds])
    apart = float((np.abs(tables[1] - tables[0]).max((0, 1)) / scale).max())
    numpy, native = (min(each) / STRETCH for each in seconds)
    return Cost(numpy, native, made[0] - made[1], made[1], apart, built, memory(network, parameters, settings))


def memory(network: Network, parameters: Parameters | None, settings: Settings) -> float:
    """The most bytes that building a model and a step of it by NumPy take."""
    tracemalloc.start()
    model = build(network, parameters, settings)
    reporter(model)(step(model, initial_state(model), settings.dt, np.full(4, 1e-4)))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(most)


def main(
    json_file: JsonFile = None,
    small: Small = False,
) -> None:
    """Measure and print."""
    try:
        library()
    except NoEngine as reason:
        print(f"Nothing to measure: {reason}.")
        return
    coarse = Settings(dt=5e-3, tolerance=1e-3)
    cases: list[tuple[str, Network, Parameters | None, Settings]] = [
        ("sheep, steps of 5 ms", SHEEP, None, coarse),
        ("sheep", SHEEP, None, Settings()),
        ("sheep, elastic", SHEEP, ELASTIC, Settings()),
        ("sheep, a batch of 32", SHEEP, MANY, Settings()),
    ]
    if not small:
        cases += [(name, load(name), None, Settings()) for name in ("human", "circle_of_willis", "adan56")]
    for parents in (fork, comb):
        for n in SIZES[: 1 if small else None]:
            cases.append((f"a tree of {n} segments, {parents.__name__}", tree(n, parents), None, Settings()))
    rows = []
    for what, network, parameters, settings in cases:
        cost = measure(network, parameters, settings, 1 if small else STRETCHES)
        note = (
            f"NumPy {1e6 * cost.numpy:.0f} us, x {cost.numpy / cost.native:.1f}; apart {cost.apart:.0e}; recorded in "
            f"{1e3 * cost.record:.0f} ms, bound in {1e3 * cost.bind:.1f} ms; model built in {1e3 * cost.build:.0f} ms, "
            f"{cost.bytes / 1e6:.0f} MB"
        )
        rows.append(Row(what, 1e6 * cost.native, "us", None, note))
    show(rows, MACHINE, json_file)


if __name__ == "__main__":
    start(main)
