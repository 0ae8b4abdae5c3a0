"""Synthetic pulses at known phases."""

from __future__ import annotations

import numpy as np

from fitting.records.read.record import Record

DT = 1.0 / 200.0
HARMONICS = 20


def pulse(phase: np.ndarray, seed: int = 1, slope: float = 1.3) -> np.ndarray:
    """Σ_k k^-slope cos(2πk φ + a random phase), 20 harmonics: band-limited, of standard deviation about 1."""
    k = np.arange(1, HARMONICS + 1)
    angles = np.random.default_rng(seed).uniform(0, 2 * np.pi, HARMONICS)
    return np.cos(2 * np.pi * np.multiply.outer(phase, k) + angles) @ k**-slope


def pressure(phase: np.ndarray) -> np.ndarray:
    return 11e3 + 2e3 * pulse(phase)


def radius(phase: np.ndarray) -> np.ndarray:
    return 9e-3 + 1e-4 * pulse(phase - 0.01, 2)


def record(time: np.ndarray, **channels: np.ndarray) -> Record:
    return Record("bench.csv", "0" * 64, time, {f"AA.{name}": values for name, values in channels.items()})


def noisy(
    T: float, n_beats: float, sd_P: float, sd_R: float, seed: int, jitter: float = 0.0, drift: float = 0.0
) -> tuple[Record, np.ndarray]:
    """A synthetic record, and the shift of each beat [s]."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(n_beats * T / DT)) * DT
    shifts = rng.normal(0.0, jitter, int(n_beats) + 2)
    phase = (time - shifts[(time / T).astype(int)]) / T
    wander = drift * np.sin(2 * np.pi * time / 17.0 + rng.uniform(0, 6))
    P = pressure(phase) + 300.0 * wander + rng.normal(0, sd_P, len(time))
    R = radius(phase) + 2e-5 * wander + rng.normal(0, sd_R, len(time))
    return record(time, P=P, R=R), shifts
