"""Virtual recordings of one wall."""

from __future__ import annotations

from functools import cache

import numpy as np

from fitting.records.alignment.beats import Beats
from fitting.records.virtual import VirtualWall, jarvik_pressure, measured, pressure_at, solve_radius

T, N, BEATS = 0.5, 100, 15


@cache
def loop(wall: VirtualWall, n: int = N, pulse: float = 4e3) -> tuple[np.ndarray, np.ndarray]:
    """One clean beat of P and R : (n,)."""
    p = jarvik_pressure(T, pulse=pulse)
    return pressure_at(p, T, np.arange(n) * T / n), solve_radius(wall, p, T, n)


def recording(
    wall: VirtualWall, dB: float | None = None, seed: int = 0, *, n: int = N, beats: int = BEATS, pulse: float = 4e3
) -> Beats:
    """A virtual recording at site "S": clean, or with white noise on P and R."""
    P, R = (np.tile(x, beats) for x in loop(wall, n, pulse))
    if dB is not None:
        rng = np.random.default_rng(seed)
        P, R = measured(P, rng, dB), measured(R, rng, dB)
    values = {"S.P": P.reshape(beats, n), "S.R": R.reshape(beats, n)}
    return Beats("virtual.csv", "0" * 64, T, values, np.zeros(beats))
