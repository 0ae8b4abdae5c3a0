"""One batch of a study, from parameter sets to the table of results: the task of a worker.

The table has numbers of each beat at each site, and its waves of pressure and flow at 100 points.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from fitting.parallel.threads import single_threaded
from fitting.records.channels.spectral import interpolated
from solver.quantities.units import SIGNAL_UNITS

from .models import StudyModel

Array = np.ndarray

POINTS = 100  # of a kept beat, at times j T/100
WAVES = ("P", "Q")
SET, FAILED = "set", "failed"
WAVE = pl.Array(pl.Float32, POINTS)


def largest(beat: Array) -> Array:
    """The maximum of a periodic beat (…, N), by a parabola through the largest sample and its neighbours."""
    at = np.argmax(beat, axis=-1, keepdims=True)
    before, top, after = (np.take_along_axis(beat, (at + i) % beat.shape[-1], -1)[..., 0] for i in (-1, 0, 1))
    slope, bend = (after - before) / 2.0, 2.0 * top - before - after  # ≥ 0
    lift = np.divide(slope**2, 2.0 * bend, out=np.zeros_like(top), where=bend > 0.0)
    return np.asarray(top + lift)


def smallest(beat: Array) -> Array:
    """The minimum of a periodic beat, as :func:`largest`."""
    return -largest(-beat)


def _mean(beat: Array) -> Array:
    return np.asarray(beat.mean(axis=-1))


def _pulse(beat: Array) -> Array:
    return largest(beat) - smallest(beat)


# signal -> name of the number -> its function of a beat (…, N) [SI]
MEASURES: Mapping[str, Mapping[str, Callable[[Array], Array]]] = {
    "P": {"systolic": largest, "diastolic": smallest, "mean": _mean, "pulse": _pulse},
    "Q": {"mean": _mean, "max": largest, "min": smallest},
    "R": {"mean": _mean, "distension": _pulse},
}


def pulse_of(channel: str, sets: pl.DataFrame) -> Array:
    """The pulses of a channel, ``CA.P``, from its numbers."""
    of = {"P": ("pulse",), "Q": ("max", "min"), "R": ("distension",)}[channel.rpartition(".")[2]]
    most, *least = (sets[f"{channel}.{name}"].to_numpy() for name in of)
    return np.asarray(most - sum(least))


def measures(sites: Sequence[str], signals: Sequence[str]) -> dict[str, str]:
    """The numbers of a study by name, ``CA.P.systolic``, and their SI units. signals : outputs of the model."""
    return {
        f"{site}.{signal}.{name}": SIGNAL_UNITS[signal]
        for site in sites
        for signal, numbers in MEASURES.items()
        if f"{site}.{signal}" in signals
        for name in numbers
    }


def measured(name: str, beats: Mapping[str, Array]) -> Array:
    """A number by its name, of beats (…, N) by channel [SI]."""
    channel, _, number = name.rpartition(".")
    return MEASURES[channel[-1]][number](beats[channel])


@dataclass(frozen=True)
class Batch:
    """The input of a worker: sets (n,) by number, their parameters (n,) [SI], and the results to keep."""

    model: StudyModel
    sets: Array
    parameters: Mapping[str, Array]
    measures: tuple[str, ...]
    waves: tuple[str, ...]


@single_threaded
def run_batch(batch: Batch) -> bytes:
    """The table of a batch as Parquet: set, numbers, waves at 100 points, and the sentence of a failed set."""
    return parquet(table(batch))


def table(batch: Batch) -> pl.DataFrame:
    """A row for each set; only the sentence for a failed one."""
    answers = batch.model.run(batch.parameters)
    failed = [answer if isinstance(answer, str) else None for answer in answers]
    every = pl.DataFrame({SET: batch.sets, FAILED: pl.Series(failed, dtype=pl.String)})
    good = [answer for answer in answers if not isinstance(answer, str)]
    channels = dict.fromkeys([*(name.rpartition(".")[0] for name in batch.measures), *batch.waves])
    beats = {name: np.reshape([beat[name] for beat in good], (len(good), -1 if good else POINTS)) for name in channels}
    numbers = {name: pl.Series(measured(name, beats), dtype=pl.Float64) for name in batch.measures}
    waves = {name: pl.Series(interpolated(beats[name], POINTS).astype(np.float32), dtype=WAVE) for name in batch.waves}
    there = every.filter(pl.col(FAILED).is_null()).select(SET)
    found = there.with_columns(**numbers, **waves)
    return every.select(SET).join(found, on=SET, how="left", maintain_order="left").with_columns(every[FAILED])


def parquet(frame: pl.DataFrame) -> bytes:
    """A table as a Parquet file; the same table gives the same bytes."""
    stream = io.BytesIO()
    frame.rechunk().write_parquet(stream, compression="zstd", statistics=False, row_group_size=1 << 16)
    return stream.getvalue()
