"""A network of one's own with an inflow of one's own, solved directly and as an FMU.

    python examples/own_network.py [--out dist]

The arteries are in ``own_network.toml``: the human aortic bifurcation with Windkessel outlets, at 120/80 mmHg.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from arterial_fmu.cli.terminal.console import sentences
from build_fmu import build
from fmu_src.importer.run import run_fmu
from solver import read_network, sampled_inflow, simulate_periodic

MMHG = 133.322387415  # Pa

# an illustrative flow in the abdominal aorta [s, mL/s]; a measured record goes here just the same
TIME = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
FLOW = np.array([0.0, 12.0, 42.0, 58.0, 48.0, 26.0, 8.0, -6.0, -12.0, -10.0, -4.0, 1.0, 2.0, 2.0, 1.0, 0.0])


@sentences(ValueError, OSError)
def main(out: Annotated[Path, typer.Option(file_okay=False, help="Directory of the FMU.")] = Path("dist")) -> None:
    """Simulate the network, build its FMU in ``out`` and run that too."""
    network = read_network(Path(__file__).with_name("own_network.toml"))
    inflow = sampled_inflow(TIME, FLOW * 1e-6, period=network.inlet.T)

    # a Windkessel settles slowly; a change of 0.1 % from beat to beat is small enough here
    beat = simulate_periodic(network, inflow, tolerance=1e-3, accelerate=False)  # from rest, as the FMU begins
    print(f"after {beat.beats} beats:")
    for site in network.sites:
        P, Q = beat[f"{site.name}.P"] / MMHG, beat[f"{site.name}.Q"] * 1e6
        print(f"{site.name:12} {P.max():.1f}/{P.min():.1f} mmHg, mean flow {Q[:-1].mean():.2f} mL/s")

    fmu = build(network, out)
    result = run_fmu(fmu, inflow, beat.beats * network.inlet.T)
    difference = np.abs(result["aorta.P"][-len(beat.time) :] - beat["aorta.P"]).max()
    print(f"wrote {fmu}; its pressure differs from the solver's by at most {difference:.0e} Pa")


if __name__ == "__main__":
    typer.run(main)
