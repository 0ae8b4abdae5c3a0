"""The solver from Python, without an FMU: change a parameter, run until the beat repeats, write a CSV, run a batch.

python examples/python_api.py [--out dist]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from solver import Network, load, simulate, simulate_periodic


def main(out: Annotated[Path, typer.Option(file_okay=False, help="Directory of the CSV file.")] = Path("dist")) -> None:
    """Simulate the sheep network in several ways; the CSV file goes to ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    network = load("sheep")
    stiffer_carotid(network, out / "stiffer_carotid.csv")
    batch(network)


def stiffer_carotid(network: Network, file: Path) -> None:
    """One changed parameter, by the FMU's name and in SI. A network never changes: a new one is made."""
    stiffer = network.with_parameters({"CA.E": 1.5 * network.segment("CA").E})
    for name, model in (("Table 1", network), ("CA.E + 50 %", stiffer)):
        beat = simulate_periodic(model)  # the last beat, when it repeats the one before
        P, Q = beat["CA.P"], beat["CA.Q"]
        print(f"{name:12} peaks at CA: {P.max():.1f} Pa, {Q.max() * 1e6:.4f} mL/s ({beat.beats} beats)")
    beat.to_csv(file)
    print(f"wrote {file}")


def batch(network: Network) -> None:
    """Many parameter sets in one call, for little more than the price of one: values are arrays of one length."""
    phi0 = np.linspace(0.0, 150e3, 7)  # Pa·s, of the carotid artery
    result = simulate(network, duration=4 * network.inlet.T, parameters={"CA.phi0": phi0})
    last = result.time >= 3 * network.inlet.T
    for value, Q in zip(phi0, result["CA.Q"], strict=True):  # (7, n)
        print(f"CA.phi0 = {value / 1e3:5.1f} kPa·s: peak flow at CA {Q[last].max() * 1e6:.4f} mL/s")


if __name__ == "__main__":
    try:
        typer.run(main)
    except (ValueError, OSError) as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(2)
