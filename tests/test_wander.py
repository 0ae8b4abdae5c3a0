"""Means of beats that wander: what moves channels together, and drifts that are alike by chance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from fitting.records.alignment.beats import Beats
from fitting.records.channels.variability import _correlation_of_means, _mean_wander

Array = np.ndarray
P, Q = "A.P", "B.P"
DRAWS = 400
FIVE_OF_DRAWS = 4.0 * np.sqrt(0.05 * 0.95 / DRAWS)  # of a share of 5 %, four standard deviations


def parts(levels: Array) -> tuple[Beats, Beats]:
    """The last quarter of some beats, and the others. levels : (2, n) their means."""
    values = {name: level[:, None] + np.sin(np.arange(8)) for name, level in zip((P, Q), levels, strict=True)}
    whole = Beats("", "", 1.0, values, np.zeros(levels.shape[1]))
    begin = 3 * levels.shape[1] // 4
    return whole.select(range(begin, levels.shape[1])), whole.select(range(begin))


def drifts(rng: np.random.Generator, n: int, c: float) -> Array:
    """(2, n) independent means with a lag-1 correlation c; random walks if c is 1."""
    steps = rng.normal(size=(2, n + 200))
    return np.cumsum(steps[:, 200:], axis=1) if c == 1.0 else lfilter([1.0], [1.0, -c], steps, axis=1)[:, 200:]


@pytest.mark.parametrize("c", [0.0, 0.8, 1.0])
@pytest.mark.parametrize("n", [12, 64])
def test_drifts_that_are_alike_by_chance(n: int, c: float) -> None:
    """Independent means, random walks included: the least correlation is above 0 in 5 % (4 to 6 % measured)."""
    rng = np.random.default_rng(3)
    found = np.array([_correlation_of_means(*parts(drifts(rng, n, c)), (P, Q))[0, 1] for _ in range(DRAWS)])
    assert np.mean(found > 0.0) == pytest.approx(0.05, abs=FIVE_OF_DRAWS)


@pytest.mark.parametrize("c", [0.0, 0.8])
def test_the_least_correlation(c: float) -> None:
    """Means with a correlation of 0.9 over 64 beats: the bound is above it in at most 5 %, and 0.85 (c = 0) or 0.79 in
    the median."""
    rng, found = np.random.default_rng(4), []
    for _ in range(DRAWS):
        first, other = drifts(rng, 64, c)
        both = np.stack([first, 0.9 * first + np.sqrt(1.0 - 0.81) * other])
        found.append(_correlation_of_means(*parts(both), (P, Q))[0, 1])
    assert np.mean(np.array(found) > 0.9) <= 0.05 + FIVE_OF_DRAWS
    assert np.median(found) == pytest.approx({0.0: 0.852, 0.8: 0.787}[c], abs=0.02)


def test_breathing_moves_means_but_not_their_difference() -> None:
    """Means that swing by 4 mmHg with breathing, and by 0.1 each: their difference is known to 0.17 mmHg or better (0.1
    √2 is its true wander), the means to 2.8."""
    rng = np.random.default_rng(5)
    breath = 4.0 * np.sin(2.0 * np.pi * np.arange(64) / 4.3)
    C = _mean_wander(*parts(breath + 0.1 * rng.normal(size=(2, 64))), (P, Q))
    assert np.sqrt(np.diag(C)) == pytest.approx(np.full(2, 4.0 / np.sqrt(2.0)), rel=0.02)
    assert 0.1 * np.sqrt(2.0) < np.sqrt(C[0, 0] - 2.0 * C[0, 1] + C[1, 1]) < 0.18


def test_wander_of_means_with_gaps() -> None:
    """Beats with gaps count by what they have against the mean beat, empty ones not: the variance of their levels."""
    rng, N = np.random.default_rng(4), 64
    level, wave = rng.normal(size=400), 50.0 * np.sin(2.0 * np.pi * np.arange(N) / N)
    values = level[:, None] + wave
    values[::3, : N // 2] = np.nan
    values[5::50] = np.nan
    part, other = (Beats("", "", 1.0, {P: v}, np.zeros(len(v))) for v in (values[:100], values[100:]))
    assert _mean_wander(part, other, (P,)) == pytest.approx(np.var(level), rel=0.1)


def test_a_channel_at_rest() -> None:
    """One without wander, or three beats: no correlation is known."""
    levels = np.stack([np.arange(12.0), np.zeros(12)])
    assert _correlation_of_means(*parts(levels), (P, Q)).tolist() == [[1.0, 0.0], [0.0, 1.0]]
    short = parts(np.array([[1.0, 2.0, 4.0], [1.0, 2.0, 4.0]]))
    assert _correlation_of_means(*short, (P, Q)).tolist() == [[1.0, 0.0], [0.0, 1.0]]
