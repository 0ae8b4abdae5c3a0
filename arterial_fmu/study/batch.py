"""One batch of a study, from parameter sets to the table of results: the task of a worker."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import polars as pl

from fitting.parallel.threads import single_threaded
from fitting.records.channels.spectral import interpolated

from .measures import POINTS, Array, measured
from .models import StudyModel

SET, FAILED = "set", "failed"
WAVE = pl.Array(pl.Float32, POINTS)


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
