"""Rate of periods that are a part of a beat or several beats: synthetic recordings with known beats.

    python benchmarks/periods.py [--recordings N] [--json FILE]

Each recording is an independent draw, by its number: 8 to 30 beats of 0.3 to 1.5 s, sampled at 100 to 250 Hz, of one to
four channels (flows, pressures, a radius). The heart ejects in one of five shapes. The rate varies by a standard
deviation of 0 to 6 % of a beat, beat by beat or with a breath of 3.5 to 8 beats, the stroke by half of that. A channel
has one to three peaks a beat: those after the first come at even distances, give or take 6 % of a beat, with 0.3 to 0.9
of its size; a pressure is stored in a Windkessel as well. White noise of 20 to 50 dB is added. The waves are cheap: no
network is solved. Peaks that are equal in all channels and evenly spaced are no part of it: that beat cannot be told
from several.

Counted is what ``usual_period`` says, which decides of what length beats are cut: right to a tenth of the mean beat; a
half, a third, two thirds, three halves, twice or three times of it; another; and whether a note says that it is
doubtful. The exit code is 1 if one is wrong without a note.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import typer
from scipy.signal import lfilter

from benchmarks.table import JsonFile, start, store, tabulate
from fitting.records.alignment.period import usual_period

Array = np.ndarray

SHAPES = ("half-sine", "notched", "triangle", "raised cosine", "early peak")
CHANNELS = (
    ("AA.P",),
    ("AA.P", "AA.R"),
    ("inlet.Q", "AA.P"),
    ("inlet.Q", "BT.Q"),
    ("inlet.Q", "AA.P", "BT.Q", "CA.P"),
)
RATIOS = {"third": 1 / 3, "half": 1 / 2, "2/3": 2 / 3, "right": 1.0, "3/2": 3 / 2, "twice": 2.0, "three times": 3.0}
NEAR = 0.1  # of a ratio


@dataclass(frozen=True)
class Made:
    """A synthetic recording: T [s], its mean beat; rate : standard deviation of its beats' lengths over that."""

    channels: dict[str, Array]
    dt: float
    T: float
    rate: float
    dB: float
    peaks: int
    shape: str


@dataclass(frozen=True)
class Row:
    """What became of one recording: kind of RATIOS, "other" or "refused"."""

    seed: int
    kind: str
    noted: bool
    rate: float
    dB: float
    peaks: int
    channels: int
    shape: str

    @property
    def silent(self) -> bool:
        """Whether it is wrong, and nothing says so."""
        return self.kind not in ("right", "refused") and not self.noted


def shape_of(name: str, u: Array) -> Array:
    """An ejection, u from 0 to 1."""
    if name == "half-sine":
        return np.asarray(np.sin(np.pi * u))
    if name == "notched":
        return np.asarray(np.sin(np.pi * u) ** 1.5 - 0.3 * np.exp(-(((u - 0.93) / 0.05) ** 2)))
    if name == "triangle":
        return np.minimum(u / 0.3, (1.0 - u) / 0.7)
    if name == "raised cosine":
        return np.asarray(0.5 - 0.5 * np.cos(2.0 * np.pi * u))
    return u * (1.0 - u) ** 2


def ejected(shape: str, begin: Array, size: Array, lasting: float, time: Array) -> Array:
    """A flow of one ejection a beat."""
    b = np.maximum(np.searchsorted(begin, time, side="right") - 1, 0)
    u = (time - begin[b]) / lasting
    return np.where((u >= 0.0) & (u < 1.0), size[b] * shape_of(shape, u.clip(0.0, 1.0)), 0.0)


def low_pass(x: Array, steps: float, first: float) -> Array:
    """x behind a first-order lag of so many steps, from a state ``first``."""
    a = np.exp(-1.0 / steps)
    return np.asarray(lfilter([1.0 - a], [1.0, -a], x, zi=[a * first])[0])


def make(seed: int) -> Made:
    """The recording of a number."""
    rng = np.random.default_rng([25, seed])
    T, dB = rng.uniform(0.3, 1.5), rng.uniform(20.0, 50.0)
    rate = float(rng.uniform(0.0, 0.06)) if rng.random() < 0.8 else 0.0
    dt, n = float(1.0 / rng.choice([100.0, 125.0, 200.0, 250.0])), int(rng.integers(8, 31))
    if rng.random() < 0.5:
        swing = rng.standard_normal(n + 10).clip(-2.5, 2.5)
    else:
        swing = np.sqrt(2.0) * np.sin(2.0 * np.pi * (np.arange(n + 10) / rng.uniform(3.5, 8.0) + rng.random()))
    lengths = T * (1.0 + rate * swing)
    begin, time = np.cumsum(lengths) - (4.0 + rng.random()) * T, np.arange(round(n * T / dt)) * dt
    size = 1.0 + 0.5 * rate * rng.standard_normal(len(begin))
    shape, peaks = str(rng.choice(SHAPES)), int(rng.integers(1, 4))
    names = CHANNELS[rng.integers(len(CHANNELS))]
    lasting, tau = rng.uniform(0.25, 0.45) * T / np.sqrt(peaks), rng.uniform(0.4, 2.0) * T
    clean: dict[str, Array] = {}
    for name in names:
        if name == "AA.R":
            clean[name] = low_pass(clean["AA.P"], 0.05 * T / dt, float(clean["AA.P"][0]))
            continue
        several = peaks if name == names[-1] or names[-1] == "AA.R" else int(rng.integers(1, peaks + 1))
        wide = lasting * rng.uniform(0.8, 1.2)
        x = ejected(shape, begin, size, wide, time)
        for k in range(1, 1 if name == "inlet.Q" else several):
            late = (k / several + rng.uniform(-0.06, 0.06)) * T
            x = x + rng.uniform(0.3, 0.9) * ejected(shape, begin + late, size, wide, time)
        if name.endswith(".P"):
            x = x + rng.uniform(0.5, 3.0) * tau / T * low_pass(x, tau / dt, float(x.mean()))
        clean[name] = x
    noisy = {name: x + x.std() * 10.0 ** (-dB / 20.0) * rng.standard_normal(len(x)) for name, x in clean.items()}
    first, last = np.searchsorted(begin, time[[0, -1]])
    return Made(noisy, dt, float(lengths[first:last].mean()), rate, float(dB), peaks, shape)


def kind_of(ratio: float) -> str:
    """The nearest of RATIOS, if it is near."""
    name = min(RATIOS, key=lambda each: abs(np.log(ratio / RATIOS[each])))
    return name if abs(ratio / RATIOS[name] - 1.0) <= NEAR else "other"


def judge(seed: int) -> Row:
    """Make a recording, find its period and compare."""
    made = make(seed)
    try:
        found = usual_period(made.channels, made.dt, f"recording {seed}")
        kind, noted = kind_of(found.T / made.T), bool(found.said)
    except ValueError:
        kind, noted = "refused", True
    return Row(seed, kind, noted, made.rate, made.dB, made.peaks, len(made.channels), made.shape)


def measure(first: int, count: int) -> list[Row]:
    """Recordings of successive numbers."""
    return [judge(seed) for seed in range(first, first + count)]


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """All, and by rate, noise and peaks."""
    found = {"all": list(rows)}
    for low, high in ((0.0, 0.0), (0.0, 0.02), (0.02, 0.04), (0.04, 0.06)):
        part = [row for row in rows if (row.rate == 0.0 if high == 0.0 else low < row.rate <= high)]
        found[f"rate {low:.0%} to {high:.0%}" if high else "rate steady"] = part
    for low in (20, 30, 40):
        found[f"noise {low} to {low + 10} dB"] = [row for row in rows if low <= row.dB < low + 10]
    for peaks in (1, 2, 3):
        found[f"peaks {peaks}"] = [row for row in rows if row.peaks == peaks]
    return found


def show(rows: Sequence[Row]) -> None:
    """A row a group: how many are of each kind, without and with a note; then those that are wrong without one."""
    kinds = [kind for kind in (*RATIOS, "other", "refused") if any(row.kind == kind for row in rows)]
    cells = []
    for name, part in groups(rows).items():
        counts = Counter((row.kind, row.noted) for row in part)
        cells.append((name, len(part), *(f"{counts[kind, False]} + {counts[kind, True]}" for kind in kinds)))
    tabulate("the period found: without a note + with one", ("recordings", "", *kinds), cells)
    for row in (each for each in rows if each.silent):
        print(f"wrong without a note: recording {row.seed}, {row.kind}")


def main(
    recordings: Annotated[int, typer.Option(min=1, help="How many.")] = 1000,
    first: Annotated[int, typer.Option(min=0, help="The number of the first.")] = 0,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    rows = measure(first, recordings)
    show(rows)
    store(json_file, rows)
    raise typer.Exit(1 if any(row.silent for row in rows) else 0)


if __name__ == "__main__":
    start(main)
