"""The paper's spectral derivative and its loop over γ."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fitting.records.channels.spectral import coefficients, derivative, gamma_loop, resample, shift

T = 0.4724
ODD_AND_EVEN = pytest.mark.parametrize("N", [64, 65])


def wave(t: np.ndarray) -> np.ndarray:
    """Three harmonics and a mean."""
    omega = 2 * math.pi / T
    return 2.0 + np.sin(omega * t) + 0.3 * np.cos(3 * omega * t) - 0.1 * np.sin(12 * omega * t)


def rate(t: np.ndarray) -> np.ndarray:
    omega = 2 * math.pi / T
    return omega * (np.cos(omega * t) - 0.9 * np.sin(3 * omega * t) - 1.2 * np.cos(12 * omega * t))


def times(N: int) -> np.ndarray:
    return np.arange(N) * T / N


@ODD_AND_EVEN
def test_derivative_of_harmonics_is_exact(N: int) -> None:
    """d/dt of a trigonometric polynomial of degree 12 < N/2: round-off (1e-14 of the largest rate)."""
    t = times(N)
    np.testing.assert_allclose(derivative(wave(t), T), rate(t), atol=3e-14 * np.abs(rate(t)).max(), rtol=0.0)


def test_derivative_at_the_nyquist_frequency_is_zero() -> None:
    """cos(π n) has no derivative that its samples show; it must not leak in (even N)."""
    assert np.abs(derivative(np.cos(math.pi * np.arange(32)), T)).max() == 0.0


@ODD_AND_EVEN
def test_coefficients_are_those_of_the_paper(N: int) -> None:
    """R̂_k = (1/N) Σ R_n e^{-2πikn/N} (Step 1), against the sum written out: 1e-15."""
    x = np.random.default_rng(1).normal(size=N)
    n, k = np.arange(N), np.arange(N // 2 + 1)
    expected = (x * np.exp(-2j * math.pi * k[:, None] * n / N)).sum(axis=1) / N
    np.testing.assert_allclose(coefficients(x), expected, atol=1e-15)


@pytest.mark.parametrize(("n", "N"), [(64, 100), (65, 31), (200, 127), (64, 64), (27, 26)])
def test_resample_and_shift(n: int, N: int) -> None:
    """The polynomial of degree 12 is known on any grid of more than 24 points, also shifted: round-off (2e-15)."""
    np.testing.assert_allclose(resample(wave(times(n)), N), wave(times(N)), atol=1e-14)
    np.testing.assert_allclose(shift(wave(times(n)), 0.013 / T), wave(times(n) - 0.013), atol=1e-14)


def _matrix(R: np.ndarray, R_t: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(R), R, R_t], axis=-1)


@ODD_AND_EVEN
def test_gamma_loop_keeps_the_signal_and_drops_the_noise(N: int) -> None:
    """P = 3 + 2 R + 0.05 R' with noise of 0.005 on R alone: the three harmonics, and none below the noise, are kept.

    J(C), of the least-squares problem written out, must be the smallest over all thresholds. The noise leaves the
    coefficients uncertain by 0.6 %.
    """
    t = times(N)
    clean = wave(t)
    P = 3.0 + 2.0 * clean + 0.05 * rate(t)
    R = clean + np.random.default_rng(7).normal(0.0, 0.005, N)
    found = gamma_loop(P, R, T, _matrix)
    assert {1, 3, 12} <= set(found.kept)
    assert len(found.kept) <= 6
    C, J = _fitted(found.R, found.R_t, P)
    c = coefficients(R)
    for gamma in np.sort(np.abs(c[1:])):
        filtered = np.fft.irfft(np.where(np.abs(c) >= min(gamma, abs(c[0])), c, 0.0), N) * N
        assert _fitted(filtered, derivative(filtered, T), P)[1] >= J * (1.0 - 1e-8)
    assert all(size >= found.gamma for size in np.abs(c)[list(found.kept)])
    np.testing.assert_allclose(C, [3.0, 2.0, 0.05], rtol=0.015)


def _fitted(R: np.ndarray, R_t: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, float]:
    """C and J."""
    C = np.linalg.lstsq(_matrix(R, R_t), P, rcond=None)[0]
    return C, float(np.linalg.norm(_matrix(R, R_t) @ C - P) / len(P))


@ODD_AND_EVEN
def test_gamma_loop_without_noise(N: int) -> None:
    """Noise-free: the derivative is kept whole (1e-12), whatever harmonics of rounding are dropped."""
    t = times(N)
    found = gamma_loop(3.0 + 2.0 * wave(t) + 0.05 * rate(t), wave(t), T, _matrix)
    np.testing.assert_allclose(found.R_t, rate(t), atol=1e-12 * np.abs(rate(t)).max())
    assert set(found.kept) >= {1, 3, 12}
