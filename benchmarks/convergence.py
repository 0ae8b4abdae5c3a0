"""Errors of the published networks against their own converged beats, and the cost of a beat: two tables.

    python benchmarks/convergence.py [--rows FILE] [--small] [NETWORKS ...]

Every network at default settings, with finer and coarser steps and elements, against a fine solution of the same
solver. P and Q in the middle of every vessel, periodic beats; rms of the difference over the pulse of the fine one, its
median and largest over the vessels. CPU time of one thread. FILE stores the measurements, so that a run can be resumed.
"""

from __future__ import annotations

import time
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.table import Small, continued, start, tabulate
from solver import Network, NonPhysicalState, NotPeriodic, Settings, Waveforms, load, simulate_periodic

NETWORKS = ("cca", "uta", "ibif", "wang55", "matthys37", "circle_of_willis", "adan56")
FINE = (1 / 4, 1 / 8)  # of the default step of 1 ms and of the default element of 5 cm
FACTORS = ((1, 1), (1 / 2, 1), (1 / 4, 1), (1, 1 / 2), (1, 1 / 4), (1 / 2, 1 / 2), (1 / 4, 1 / 4))
COARSE = ((2, 1), (4, 1), (2, 2), (4, 2))
ITERATION, PERIODIC = 1e-6, 3e-5


def settings_of(network: Network, step: float, length: float, iteration: float | None = None) -> Settings:
    """The defaults with other steps, a whole number of them in the period, and other elements."""
    default = Settings()
    dt = network.inlet.T / np.ceil(network.inlet.T / (step * default.dt) - 1e-9)
    return Settings(dt, length * default.element_length, default.degree, iteration or default.tolerance)


def cost(network: Network, settings: Settings) -> dict[str, float]:
    """CPU seconds until beats repeat to 1e-3 from the default start, and of one more beat; how many beats it took."""
    begun = time.process_time()
    result = simulate_periodic(network, settings=settings, tolerance=1e-3)
    until = time.process_time() - begun
    simulate_periodic(network, settings=settings, tolerance=1.0, start=result)  # two beats
    return {"periodic": until, "beats": result.beats, "beat": (time.process_time() - begun - until) / 2}


def errors(result: Waveforms, fine: Waveforms) -> dict[str, list[float]]:
    """By signal, P and Q: rms of the difference over the pulse, at every site in the order of the network's."""
    found: dict[str, list[float]] = {"P": [], "Q": []}
    for name, values in fine.items():
        site, _, signal = name.rpartition(".")
        if signal in found and not site.endswith("outlet") and site != "inlet":
            own = result[name] - np.interp(result.time, fine.time, values)
            found[signal].append(float(np.sqrt(np.mean(own**2)) / np.ptp(values)))
    return found


@cache
def fine(name: str, step: float, length: float) -> Waveforms:
    """The solution that a network's others are compared with."""
    network, begun = load(name), time.process_time()
    found = simulate_periodic(network, settings=settings_of(network, step, length, ITERATION), tolerance=PERIODIC)
    print("fine", name, found.beats, found.change, time.process_time() - begun, flush=True)
    return found


def measured(finest: tuple[float, float], name: str, step: float, length: float) -> dict[str, Any]:
    """One row; without errors if the simulation failed."""
    network, row = load(name), {"network": name, "step": step, "length": length}
    settings = settings_of(network, step, length)
    try:
        paid = cost(network, settings) if step >= 1 and length >= 1 else {}
        result = simulate_periodic(network, settings=settings, tolerance=PERIODIC, max_beats=20)
    except (NonPhysicalState, NotPeriodic) as error:
        return {**row, "P": [], "Q": [], "failed": str(error)}
    return {**row, **paid, **errors(result, fine(name, *finest))}


def shown(errors: list[float]) -> str:
    """Median and largest."""
    return f"{np.median(errors):.1e} {np.max(errors):.1e}" if errors else "none"


def tables(rows: list[dict[str, Any]]) -> None:
    """Errors by step and element, and the cost."""
    steps = [f"{step:g} ms, {5 * length:g} cm" for step, length in FACTORS]
    own = {(row["network"], row["step"], row["length"]): row for row in rows}
    names = dict.fromkeys(row["network"] for row in rows)
    cells = [
        (name, signal, *(shown(own[name, *key][signal]) if (name, *key) in own else "" for key in FACTORS))
        for name in names
        for signal in "PQ"
    ]
    tabulate("rms over pulse: median and largest of the vessels", ("network", "", *steps), cells, left=2)
    cells = [
        (r["network"], f"{r['step']:g} ms", f"{5 * r['length']:g} cm", f"{r['beat']:.2f}", f"{r['periodic']:.2f}",
         f"{r['beats']:g}", shown(r["P"]), shown(r["Q"]))
        for r in rows if "beat" in r
    ]  # fmt: skip
    columns = ("network", "dt", "element", "a beat, s", "until periodic, s", "beats", "P", "Q")
    tabulate("CPU time and error: median and largest of the vessels", columns, cells)


def main(
    networks: Annotated[list[str] | None, typer.Argument(help="Names.")] = None,
    rows: Annotated[Path, typer.Option(help="What was measured; made, and continued.")] = Path(
        "build/convergence.json"
    ),
    small: Small = False,
) -> None:
    """Measure the missing rows, and print."""
    factors = FACTORS[:1] + COARSE[:1] if small else FACTORS + COARSE
    cases = [(name, *each) for name in networks or NETWORKS for each in factors]
    finest = FACTORS[1] if small else FINE
    tables(continued(rows, ("network", "step", "length"), cases, partial(measured, finest)))


if __name__ == "__main__":
    start(main)
