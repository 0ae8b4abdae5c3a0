"""Timing jitter of beats: how much earlier or later than the strict period each came, moving it back; and drift."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from . import thresholds as limit

Array = np.ndarray

_EXACT = 1e-7  # of the pulse: noise that is assumed at least when beats are timed


def without_jitter(values: Mapping[str, Array], T: float) -> tuple[Mapping[str, Array], Array]:
    """Values with significant jitter taken out, and the shifts [s]; the same values and zeros if there is none."""
    from scipy.stats import f as f_distribution  # takes half a second

    n_beats, N = next(iter(values.values())).shape
    turns, excess, dof, means = _timing(np.stack([_spectra(beats) for beats in values.values()]), N)
    if n_beats < 3 or f_distribution.sf(excess / (n_beats - 2), n_beats - 2, dof) > limit.JITTER:
        return values, np.zeros(n_beats)
    moved = {}
    for (name, beats), mean in zip(values.items(), means, strict=True):
        k = np.arange(1, len(mean) + 1)
        change = np.zeros((n_beats, N // 2 + 1), complex)
        change[:, 1 : len(mean) + 1] = (1.0 - np.exp(-2j * np.pi * np.outer(turns, k))) * mean
        moved[name] = beats + np.fft.irfft(change * N, N, axis=1)  # the model moves back, the residual stays
    return moved, turns * T


def _timing(F: Array, N: int) -> tuple[Array, float, float, Array]:
    """Shift of each beat [periods], χ² of the shifts, degrees of freedom of the noise in it, and the mean beats where
    they are above it : (m, K), of the coefficients 1 … K of m channels, F : (m, n_beats, K), of beats of N samples.

    Beat b is modelled as the mean beat s_b later: F_bk = m_k e^{-2πi k s_b} + noise of variance S_k + a straight line
    (drift). To first order the shifts are weighted projections on the derivative of the mean beat, all channels
    jointly; repeated until they stand still.
    """
    _, n_beats, K = F.shape
    k = np.arange(1, K + 1)
    line = np.fft.rfft(np.arange(N) / N)[k] / N
    turns, excess, S = np.zeros(n_beats), 0.0, None
    for _ in range(8):
        turned = F * np.exp(2j * np.pi * np.outer(turns, k))
        mean = turned.mean(axis=1)
        turned -= mean[:, None]
        S = _pooled(_power(turned)) / (n_beats - 1) if S is None else S
        S = np.maximum(S, _EXACT**2 * (np.abs(mean) ** 2).sum(axis=1, keepdims=True))
        mean *= np.abs(mean) ** 2 > limit.ABOVE_NOISE**2 * S / n_beats
        tau, size = -2j * np.pi * k * mean, _inner(line, line, S)
        template = tau - line * (_inner(tau, line, S) / size)
        information = float(_inner(template, template, S).sum())
        if not information > 0.0:
            return np.zeros(n_beats), 0.0, 1.0, mean
        change = (turned @ (template.conj() / S)[..., None]).real.sum(axis=0)[:, 0] / information
        change -= change.mean()
        left = turned - change[:, None] * tau[:, None]
        left -= (left @ (line.conj() / S)[..., None]).real / size[:, None] * line
        # the share of each harmonic's two numbers that shift and line have taken away
        taken = (np.abs(line) ** 2 / size + np.abs(template) ** 2 / information) / (2.0 * S)
        S = _pooled(_power(left)) / (_pooled(1.0 - taken) * (n_beats - 1))
        turns = turns + change
        excess = 2.0 * information * float(turns @ turns)
        if np.abs(change).max() ** 2 * information < 1e-6:
            break
    return turns, excess, 2.0 * (2 * limit.NEIGHBOURS + 1) * max(n_beats - 2, 1), mean


def _spectra(beats: Array) -> Array:
    """Fourier coefficients 1.._TIMING of each beat : (n_beats, K), gaps filled with the mean beat."""
    there = ~np.isnan(beats)
    if not there.all():
        beats = np.where(there, beats, np.nanmean(beats, axis=0))
    N = beats.shape[1]
    return np.fft.rfft(beats, axis=1)[:, 1 : min(limit.TIMING, (N - 1) // 2) + 1] / N


def _power(X: Array) -> Array:
    """Σ_b |X_bk|² : (m, K)."""
    return np.asarray((np.abs(X) ** 2).sum(axis=1))


def _inner(a: Array, b: Array, S: Array) -> Array:
    """(m, 1), each harmonic in units of its noise."""
    return np.asarray(((a.conj() * b).real / S).sum(axis=-1, keepdims=True))


def _pooled(S: Array) -> Array:
    """The mean over neighbouring harmonics, fewer at the ends : (m, K)."""
    K = S.shape[1]
    total = np.concatenate([np.zeros((len(S), 1)), np.cumsum(S, axis=1)], axis=1)
    low, high = np.maximum(np.arange(K) - limit.NEIGHBOURS, 0), np.minimum(np.arange(K) + limit.NEIGHBOURS + 1, K)
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def without_slope(beats: Array) -> Array:
    """Beats without the slope that the slow drift from beat to beat has within each of them.

    A drift puts the same ramp into every beat: the scatter between beats does not show it, the mean beat has it. Its
    slope is that of the beats' levels; the levels themselves stay, and count as scatter of the mean.
    """
    if len(beats) < 3:
        return beats
    measured = np.flatnonzero(~np.isnan(beats).all(axis=1))
    deviations = beats[measured] - np.nanmean(beats, axis=0)
    levels = np.interp(np.arange(len(beats)), measured, np.nanmean(deviations, axis=1))  # also of a beat in a gap
    N = beats.shape[1]
    return np.asarray(beats - np.outer(np.gradient(levels), (np.arange(N) + 0.5) / N - 0.5))
