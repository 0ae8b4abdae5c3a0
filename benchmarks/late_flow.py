"""How often a flow meter is called late or early that is not, and how often one that is.

    python benchmarks/late_flow.py [--animals N] [--first N] [--delays "0 10 20"] [--json FILE]

Each animal is an independent draw, by its number: a tube that forks into two, each with a Windkessel. Lengths are 8 to
30 cm, radii of the parent 8 to 12 mm and of the children 0.6 to 0.9 of it, E 0.3 to 1 MPa, viscosities 5 to 20 ms,
beats 0.5 to 1 s, R C 0.5 to 2.5 s, and a quarter to three quarters of the flow goes to the first child. Recorded are
inlet.Q and P where it begins, 15 beats with white noise of 1 % of each channel's pulse. ``first`` makes a model, one
tube with a Windkessel, and ``calibrate`` refits five of its numbers: the model lacks the fork, as those of users do.
Each animal is recorded with every delay [ms] of the flow meter, early and late. With delay 0 a sentence is false.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Annotated

import numpy as np
import typer

from benchmarks.calibrations import RHO, SAMPLES, ejected, noisy
from benchmarks.hidden.counts import share
from benchmarks.table import JsonFile, start, store, tabulate
from fitting.calibrate.network_calibration import calibrate
from fitting.first.model import first_model
from fitting.records.alignment.beats import Beats
from solver import Inlet, Junction, Network, Segment, Site, Windkessel, beat_harmonics

ROOT = "Ao.P"
FREE = ("all.E", "all.phi0", "all.outlet.R1", "all.outlet.C", "all.outlet.R2")
WORDS = (" late ", " early ")


@dataclass(frozen=True)
class Row:
    """The sentences about one animal with one delay of its flow meter [ms]."""

    seed: int
    delay: float
    first: bool
    calibrate: bool


FIRST, CALIBRATED = attrgetter("first"), attrgetter("calibrate")


def fork(rng: np.random.Generator) -> tuple[Network, float]:
    """An animal, and the size of its inflow [m³/s]."""
    R0, E, T, P = rng.uniform(8e-3, 12e-3), rng.uniform(3e5, 1e6), rng.uniform(0.5, 1.0), rng.uniform(9e3, 14e3)
    size = rng.uniform(2e-4, 5e-4) * (R0 / 1e-2) ** 2
    mean = float(ejected(np.linspace(0.0, T, 999), T, size).mean())
    share, segments, ends = rng.uniform(0.25, 0.75), list[Segment](), list[Windkessel]()
    for name, part in (("A", 1.0), ("B", share), ("C", 1.0 - share)):
        R, stiff = R0 * (1.0 if name == "A" else rng.uniform(0.6, 0.9)), E * rng.uniform(0.8, 1.5)
        phi0 = stiff * rng.uniform(5e-3, 20e-3)
        segments.append(Segment(name, L=rng.uniform(0.08, 0.3), R0=R, h=0.12 * R, E=stiff, phi0=phi0))
        if name != "A":
            R1 = np.sqrt(RHO * stiff * 0.12 / 1.5) / (np.pi * R**2) * rng.uniform(0.5, 1.5)
            R2 = P / (part * mean) - R1
            ends.append(Windkessel(name, R1=R1, C=rng.uniform(0.5, 2.5) / R2, R2=R2))
    junction = Junction(("A",), ("B", "C"))
    return Network("fork", tuple(segments), Inlet("A", mean, T), (junction,), tuple(ends), (Site("Ao", "A", 0.0),),
                   P_ref=P, P_0=P), size  # fmt: skip


def recorded(seed: int, delay: float) -> Beats:
    """The recording of an animal with a flow meter that shows what flowed ``delay`` seconds ago."""
    rng = np.random.default_rng([29, seed])
    true, size = fork(rng)
    T, t = true.inlet.T, np.arange(SAMPLES) * (true.inlet.T / SAMPLES)
    X = beat_harmonics(true, [ROOT], SAMPLES // 2 - 1, lambda t: ejected(t, T, size), T, tolerance=1e-8)[0]
    waves = {"inlet.Q": ejected(t - delay, T, size), ROOT: np.fft.irfft(X[:, 0], SAMPLES, norm="forward")}
    return noisy(rng, f"fork {seed}", T, waves)


def judge(seed: int, delay: float) -> Row:
    """Make a recording, a first model and a calibration of it."""
    beats = recorded(seed, 1e-3 * delay)
    model = first_model(beats)
    plain = calibrate(beats, model.network, FREE)
    return Row(seed, delay, told(model.notes, delay), told(plain.report, delay))


def told(notes: Sequence[str], delay: float) -> bool:
    """True if a sentence says that inlet.Q is late or early, if it is, on the right side."""
    words = WORDS if delay == 0.0 else WORDS[:1] if delay > 0.0 else WORDS[1:]
    return any("inlet.Q" in note and any(word in note for word in words) for note in notes)


def main(
    animals: Annotated[int, typer.Option(min=1, help="How many.")] = 40,
    first: Annotated[int, typer.Option(min=0, help="The number of the first.")] = 0,
    delays: Annotated[str, typer.Option(help="Of the flow meter [ms].")] = "0 -20 -10 10 20",
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    each = [float(x) for x in delays.split()]
    rows = [judge(seed, delay) for seed in range(first, first + animals) for delay in each]
    cells = [
        (f"{delay:g}", *(share([r for r in rows if r.delay == delay], test) for test in (FIRST, CALIBRATED)))
        for delay in each
    ]
    tabulate("", ("delay of inlet.Q [ms]", "first says so", "calibrate says so"), cells, width=120)
    store(json_file, rows)


if __name__ == "__main__":
    start(main)
