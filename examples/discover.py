"""The discrepancy workflow twice: missing physics, and a slow sensor with a similar signature.

    python examples/discover.py [--out dist]

1. The model is the sheep network with elastic walls. The record (synthetic: no public recording of the paper's sheep
   exists) is of the same network with one viscous artery. The workflow finds where model and record disagree, names
   what is missing, adds it, rebuilds the FMU and runs it on beats that it has not seen.
2. The second record is of the elastic network itself, but one pressure sensor is slow. It damps and delays, as wall
   viscosity does, but in one channel alone.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from arterial_fmu.cli.tables.study import effects_table, gap_text
from arterial_fmu.cli.terminal.console import sentences
from arterial_fmu.cli.terminal.progress import bar
from discrepancy import discover
from fitting.records.read.record import write_record
from fitting.records.virtual import measured
from solver import Network, Settings, load, simulate_periodic
from solver.laws.catalogue import observe
from solver.network.files import write_network

Array = np.ndarray

SITE = "CA"  # of the viscous artery and of the slow sensor
SITES = ("AA", "MD", SITE)  # sites with records of P, Q and R, beside the inlet flow
BEATS, SAMPLES, T = 20, 125, 0.5  # s: 250 Hz
DB = 40.0
F_N, ZETA = 9.0, 1.2  # Hz: a fluid-filled catheter with a bubble in it
SEED = 1
FINE = Settings(dt=0.5e-3, element_length=0.025)  # finer than the workflow's settings


@sentences(ValueError, OSError)
def main(
    out: Annotated[Path, typer.Option(file_okay=False, help="Directory for everything that is written.")] = Path(
        "dist"
    ),
) -> None:
    """Make both records, and study each against the elastic model."""
    folder = out / "discover"
    folder.mkdir(parents=True, exist_ok=True)
    sheep = load("sheep")
    elastic = replace(sheep.with_parameters({f"{s.name}.phi0": 0.0 for s in sheep.segments}), name="sheep_elastic")
    viscous = elastic.with_parameters({f"{SITE}.phi0": sheep.segment(SITE).phi0})
    model = folder / "sheep_elastic.toml"
    write_network(elastic, model)
    write(folder / "virtual_viscous_wall.csv", waves(viscous))
    write(folder / "virtual_slow_sensor.csv", slowed(waves(elastic), f"{SITE}.P"))
    hidden = {
        "viscous_wall": f"hidden in the record: {SITE}.phi0 = {sheep.segment(SITE).phi0 / 1e3:.1f} kPa·s",
        "slow_sensor": f"hidden in the record: the sensor of {SITE}.P, second order, {F_N:g} Hz, ζ = {ZETA:g}",
    }
    for name, truth in hidden.items():
        study(name, truth, model, folder)


def heart(t: Array) -> Array:
    """A smooth ejection of 55 mL/s, once a beat [m³/s]."""
    return np.asarray(55e-6 * np.exp(6.0 * (np.cos(2.0 * np.pi * (t / T - 0.2)) - 1.0)))


def waves(network: Network) -> dict[str, Array]:
    """Fourier coefficients of inlet flow and of P, Q, R at the sites, up to the limit of the sampling."""
    beat = simulate_periodic(network, heart, T, settings=FINE, tolerance=1e-6)
    names = ["inlet.Q", *(f"{site}.{kind}" for site in SITES for kind in ("P", "Q", "R"))]
    return {name: np.fft.rfft(beat[name][:-1], norm="forward")[: SAMPLES // 2 + 1] for name in names}


def slowed(X: dict[str, Array], channel: str) -> dict[str, Array]:
    """The same with one channel through a second-order sensor."""
    omega = 2.0 * np.pi / T * np.arange(len(X[channel]))
    return {**X, channel: observe({"f_n": F_N, "zeta": ZETA}, X[channel], omega)}


def write(path: Path, X: dict[str, Array]) -> None:
    """A noisy record of many beats."""
    rng = np.random.default_rng(SEED)
    clean = {name: np.fft.irfft(x, SAMPLES, norm="forward") for name, x in X.items()}
    channels = {name: measured(np.append(np.tile(x, BEATS), x[0]), rng, DB) for name, x in clean.items()}
    units = {name: {"P": "mmHg", "Q": "mL/s", "R": "mm"}[name[-1]] for name in channels}
    write_record(path, np.arange(BEATS * SAMPLES + 1) * T / SAMPLES, channels, units)


def study(name: str, truth: str, model: Path, folder: Path) -> None:
    """Run the workflow on one record and print what it found."""
    with bar(False, name) as progress:
        outcome = discover(folder / f"virtual_{name}.csv", model, folder / name, progress=progress)
    Console(soft_wrap=True).rule(f"virtual_{name}.csv", align="left")
    print(truth)
    print(f"verdict: {outcome.verdict}. {outcome.sentence}")
    if outcome.effects:
        Console().print(effects_table(outcome))
    print(gap_text(outcome))
    for file in ("report.html", "verdict.json", "model.toml", "model.fmu"):
        if (folder / name / file).exists():
            print(f"wrote {folder / name / file}")
    print(f"({outcome.seconds:.0f} s)\n")


if __name__ == "__main__":
    typer.run(main)
