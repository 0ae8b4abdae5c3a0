"""Success rate of calibrations from distant starts: synthetic tubes with a Windkessel, all starts off by a factor.

    python benchmarks/calibrations.py [--tubes N] [--first N] [--factor X] [--starts N] [--json FILE]

Each tube is an independent draw, by its number: length 20 to 50 cm, radius 8 to 12 mm, E 0.2 to 1 MPa, a viscosity of
5 to 20 ms, beats of 0.5 to 1 s; a Windkessel whose R2 C is 0.3 to 5 s, with half to one and a half of the tube's
impedance before it, and the resistance that makes a mean pressure of 9 to 14 kPa. Recorded are inlet.Q and P at both
ends, 15 beats with white noise of 1 % of each channel's pulse. Five parameters without prior, E, phi0, R1, C and R2,
start above or below the truth by the factor. The benchmark counts 95 % intervals that contain the truth, ends far from
it, and failures, and measures the CPU time of each calibration.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import JsonFile, start, store, tabulate
from fitting.calibrate.multistart import calibrate_from
from fitting.records.alignment.beats import Beats
from solver import Inlet, Network, Segment, Site, Windkessel, beat_harmonics

Array = np.ndarray

FREE = tuple(f"all.{key}:none" for key in ("E", "phi0", "outlet.R1", "outlet.C", "outlet.R2"))
NUMBERS = ("A.E", "A.phi0", "A.outlet.R1", "A.outlet.C", "A.outlet.R2")
CHANNELS = ("Ao.P", "Pe.P")
BEATS, SAMPLES, NOISE = 15, 200, 0.01
FAR = 2.0  # χ²/dof of an end far from the truth; the noise alone gives less
RHO = 1060.0  # kg/m³


@dataclass(frozen=True)
class Made:
    """A recording of a tube, the tube, and where the calibration begins."""

    beats: Beats
    true: Network
    start: Network
    RC: float


@dataclass(frozen=True)
class Row:
    """The result of one tube: the number of five intervals with the truth, the reason of a failure, the other
    starts."""

    seed: int
    RC: float
    within: int
    chi2: float
    seconds: float
    failed: str
    said: tuple[str, ...]


def ejected(t: Array, T: float, size: float) -> Array:
    """Inflow [m³/s]: a half-sine over a third of the beat, with a little backflow after it."""
    u = np.mod(t / T, 1.0)
    return size * (np.where(u < 0.35, np.sin(np.pi * u / 0.35), 0.0) - 0.15 * np.exp(-(((u - 0.39) / 0.03) ** 2)))


def noisy(rng: np.random.Generator, name: str, T: float, waves: Mapping[str, Array]) -> Beats:
    """The recording of waves, with white noise relative to each."""
    values = {key: x + NOISE * x.std() * rng.normal(size=(BEATS, SAMPLES)) for key, x in waves.items()}
    return Beats(name, "0" * 64, T, values, np.zeros(BEATS))


def make(seed: int, factor: float = 3.0) -> Made:
    """The recording of a number."""
    rng = np.random.default_rng([27, seed])
    R0, E, T = rng.uniform(8e-3, 12e-3), rng.uniform(2e5, 1e6), rng.uniform(0.5, 1.0)
    tube = Segment("A", L=rng.uniform(0.2, 0.5), R0=R0, h=0.12 * R0, E=E, phi0=E * rng.uniform(5e-3, 20e-3))
    Z = np.sqrt(RHO * E * 0.12 / 1.5) / (np.pi * R0**2)
    size = rng.uniform(2e-4, 5e-4) * (R0 / 1e-2) ** 2
    mean = float(ejected(np.linspace(0.0, T, 999), T, size).mean())
    R1, RC = Z * rng.uniform(0.5, 1.5), float(np.exp(rng.uniform(np.log(0.3), np.log(5.0))))
    P = rng.uniform(9e3, 14e3)
    R2 = P / mean - R1
    sites = (Site("Ao", "A", 0.0), Site("Pe", "A", 1.0))
    end = Windkessel("A", R1=R1, C=RC / R2, R2=R2)
    true = Network("tube", (tube,), Inlet("A", mean, T), outlets=(end,), sites=sites, P_ref=P, P_0=P)
    X = beat_harmonics(true, CHANNELS, SAMPLES // 2 - 1, lambda t: ejected(t, T, size), T, tolerance=1e-8)[0]
    waves = dict(zip(CHANNELS, np.fft.irfft(X, SAMPLES, axis=0, norm="forward").T, strict=True))
    waves = {"inlet.Q": ejected(np.arange(SAMPLES) * (T / SAMPLES), T, size), **waves}
    beats = noisy(rng, f"tube {seed}", T, waves)
    known = true.parameters()
    off = {name: known[name] * factor ** float(rng.choice([-1.0, 1.0])) for name in NUMBERS}
    return Made(beats, true, true.with_parameters(off), RC)


def judge(seed: int, factor: float, starts: int) -> Row:
    """Make a recording, calibrate and compare."""
    made = make(seed, factor)
    begun = time.process_time()
    try:
        found = calibrate_from(made.beats, made.start, FREE, starts).best
    except ValueError as error:
        return Row(seed, made.RC, 0, np.nan, time.process_time() - begun, str(error), ())
    seconds, known = time.process_time() - begun, made.true.parameters()
    within = sum(bool(found.ci95[name][0] <= known[name] <= found.ci95[name][1]) for name in NUMBERS)
    said = tuple(text for text in found.report if "start" in text)
    return Row(seed, made.RC, within, found.chi2 / found.dof, seconds, "", said)


def show(rows: Sequence[Row]) -> None:
    """The counts, then the failures."""
    ended = [row for row in rows if not row.failed]
    seconds = [row.seconds for row in rows]
    far = [row for row in ended if row.chi2 > FAR]
    cells = (
        ("tubes", len(rows)),
        ("failed", len(rows) - len(ended)),
        ("ends far from the truth", len(far)),
        ("intervals that hold the truth", f"{np.mean([row.within for row in rows]) / len(NUMBERS):.1%}"),
        ("begun elsewhere", sum(bool(row.said) for row in ended)),
        ("CPU time, median and longest", f"{np.median(seconds):.2f} s, {max(seconds):.2f} s"),
    )
    tabulate("", ("of calibrations from afar", ""), cells)
    for row in rows:
        if row.failed or row in far or row.said:
            print(f"tube {row.seed}: RC {row.RC:.2g} s, {row.within} within, χ²/dof {row.chi2:.3g}, "
                  f"{row.seconds:.2f} s. {row.failed or '; '.join(row.said)}")  # fmt: skip


def main(
    tubes: Annotated[int, typer.Option(min=1, help="How many.")] = 100,
    first: Annotated[int, typer.Option(min=0, help="The number of the first.")] = 0,
    factor: Annotated[float, typer.Option(min=1.0, help="By which each number is off where it begins.")] = 3.0,
    starts: Annotated[int, typer.Option(min=1, help="Starts of each calibration.")] = 1,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    rows = [judge(seed, factor, starts) for seed in range(first, first + tubes)]
    show(rows)
    store(json_file, rows)


if __name__ == "__main__":
    start(main)
