"""Virtual recordings of one wall."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from fitting.records.alignment.beats import Beats
from fitting.records.virtual import VirtualWall, jarvik_pressure, measured, pressure_at, solve_radii, solve_radius

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
    return repeated(*loop(wall, n, pulse), dB, seed, beats)


def loops(walls: Sequence[VirtualWall]) -> Iterator[Beats]:
    """Clean virtual recordings of many walls, of one integration."""
    p, n = jarvik_pressure(T, pulse=4e3), len(walls)
    P = pressure_at(p, T, np.arange(N) * T / N)
    for R in solve_radii(walls, np.tile(p, (n, 1)), np.full(n, T), N, rtol=1e-13):
        yield repeated(P, R)


def repeated(P: np.ndarray, R: np.ndarray, dB: float | None = None, seed: int = 0, beats: int = BEATS) -> Beats:
    """A recording of as many beats as one, clean or with white noise."""
    n, P, R = len(P), np.tile(P, beats), np.tile(R, beats)
    if dB is not None:
        rng = np.random.default_rng(seed)
        P, R = measured(P, rng, dB), measured(R, rng, dB)
    values = {"S.P": P.reshape(beats, n), "S.R": R.reshape(beats, n)}
    return Beats("virtual.csv", "0" * 64, T, values, np.zeros(beats))
