"""Errors of the published networks against their own converged beats, and the cost of a beat: two tables.

    python benchmarks/convergence.py [--rows FILE] [--small] [NETWORKS ...]

Every network at default settings, with finer and coarser steps and elements, against a fine solution of the same
solver. P and Q in the middle of every vessel, periodic beats; rms of the difference over the pulse of the fine one, its
median and largest over the vessels. CPU time of one thread. FILE stores the measurements, so that a run can be resumed.
"""

from __future__ import annotations

import os

# before NumPy is imported: one thread, so that CPU time is time
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"

import json
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from arterial_fmu.cli.terminal.console import right, show
from benchmarks.table import Small
from solver import Network, NonPhysicalState, NotPeriodic, Settings, Waveforms, load, simulate_periodic
from solver.network.files import write_whole

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


def measured(network: Network, fine: Waveforms, step: float, length: float) -> dict[str, Any]:
    """One row; without errors if the simulation failed."""
    settings, row = settings_of(network, step, length), {"network": network.name, "step": step, "length": length}
    try:
        paid = cost(network, settings) if step >= 1 and length >= 1 else {}
        result = simulate_periodic(network, settings=settings, tolerance=PERIODIC, max_beats=20)
    except (NonPhysicalState, NotPeriodic) as error:
        return {**row, "P": [], "Q": [], "failed": str(error)}
    return {**row, **paid, **errors(result, fine)}


def shown(errors: list[float]) -> str:
    """Median and largest."""
    return f"{np.median(errors):.1e} {np.max(errors):.1e}" if errors else "none"


def tables(rows: list[dict[str, Any]]) -> None:
    """Errors by step and element, and the cost."""
    steps = [f"{step:g} ms, {5 * length:g} cm" for step, length in FACTORS]
    table = Table("network", "", *map(right, steps), title="rms over pulse: median and largest of the vessels")
    for name in dict.fromkeys(row["network"] for row in rows):
        own = {(row["step"], row["length"]): row for row in rows if row["network"] == name}
        for signal in "PQ":
            table.add_row(name, signal, *(shown(own[key][signal]) if key in own else "" for key in FACTORS))
    show(table)
    titles = ("network", "dt", "element", "a beat, s", "until periodic, s", "beats", "P", "Q")
    table = Table(*map(right, titles), title="CPU time and error: median and largest of the vessels")
    for row in (row for row in rows if "beat" in row):
        numbers = f"{row['beat']:.2f}", f"{row['periodic']:.2f}", f"{row['beats']:g}", shown(row["P"]), shown(row["Q"])
        table.add_row(row["network"], f"{row['step']:g} ms", f"{5 * row['length']:g} cm", *numbers)
    show(table)


def main(
    networks: Annotated[list[str] | None, typer.Argument(help="Names.")] = None,
    rows: Annotated[Path, typer.Option(help="What was measured; made, and continued.")] = Path(
        "build/convergence.json"
    ),
    small: Small = False,
) -> None:
    """Measure the missing rows, and print."""
    found = json.loads(rows.read_text()) if rows.is_file() else []
    done = {(row["network"], row["step"], row["length"]) for row in found}
    rows.parent.mkdir(parents=True, exist_ok=True)
    cases = FACTORS[:1] + COARSE[:1] if small else FACTORS + COARSE
    finest = FACTORS[1] if small else FINE
    for name in networks or NETWORKS:
        left = [case for case in cases if (name, *case) not in done]
        if left:
            network = load(name)
            begun = time.process_time()
            settings = settings_of(network, finest[0], finest[1], ITERATION)
            fine = simulate_periodic(network, settings=settings, tolerance=PERIODIC)
            print("fine", name, fine.beats, fine.change, time.process_time() - begun, flush=True)
        for case in left:
            found.append(measured(network, fine, *case))
            write_whole(rows, json.dumps(found, indent=1) + "\n")
            print({k: (v if not isinstance(v, list) else shown(v)) for k, v in found[-1].items()}, flush=True)
    tables(found)


if __name__ == "__main__":
    typer.run(main)
