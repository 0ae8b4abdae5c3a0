"""Records for the check of a parameter set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fitting.records.read.record import Record, read_record, write_record
from fitting.records.virtual import table_wall
from fitting.results.parameter_set import ParameterSet, Value
from solver import Settings

Array = np.ndarray
COARSE = Settings(dt=2e-3, element_length=0.1)
T, N, BEATS = 0.5, 125, 15
DISPLAY = {"P": "mmHg", "Q": "mL/s", "R": "mm"}


def recorded(folder: Path, channels: Mapping[str, Array], noise: float = 0.0) -> Record:
    """A record of repeated beats (N,), with white noise relative to the pulsatile standard deviation."""
    rng = np.random.default_rng(5)
    samples = {name: np.tile(beat, BEATS) for name, beat in channels.items()}
    if noise:
        samples = {name: x + rng.normal(0.0, noise * x.std(), x.size) for name, x in samples.items()}
    n = len(next(iter(channels.values())))
    time = np.arange(n * BEATS) * (T / n)
    write_record(folder / "record.csv", time, samples, {name: DISPLAY[name[-1]] for name in channels})
    return read_record(folder / "record.csv")


def bench_set(site: str = "AA", viscous: str = "monotone", **changes: float) -> ParameterSet:
    """The wall of Table 1 with the paper's nonlinear viscosity, as a set."""
    wall = table_wall(site, **changes)
    units = {"R0": "m", "h": "m", "E": "Pa", "phi0": "Pa.s", "phiNL": "Pa.s^2"}
    values = {f"{site}.{key}": Value(getattr(wall, key), unit) for key, unit in units.items()}
    laws = {"network.elastic_law": "regression", "network.viscous_law": viscous}
    return ParameterSet(f"bench {site}", values, laws, {"source": "virtual wall"})
