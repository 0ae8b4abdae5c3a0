"""Timing jitter of beats: how much earlier or later than the strict period each came, moving it back; and drift."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

Array = np.ndarray

_WINDOW = 3  # harmonics on either side that share one estimate of the noise
_JITTER = 1e-3  # probability of shifts as large as those found without any jitter, below which they are removed
_TIMING = 48  # harmonics that tell the timing of a beat
_EXACT = 1e-7  # of the pulse: noise that is assumed at least when beats are timed


def without_jitter(values: Mapping[str, Array], T: float) -> tuple[Mapping[str, Array], Array]:
    """Values with significant jitter taken out, and the shifts [s]; the same values and zeros if there is none."""
    from scipy.stats import f as f_distribution  # takes half a second

    turns, excess, dof, spectra = _timing(values)
    n_beats = len(turns)
    if n_beats < 3 or f_distribution.sf(excess / (n_beats - 2), n_beats - 2, dof) > _JITTER:
        return values, np.zeros(n_beats)
    moved = {}
    for name, beats in values.items():
        N = beats.shape[1]
        mean, trusted = spectra[name]
        k = np.arange(1, len(mean) + 1)
        change = np.zeros((n_beats, N // 2 + 1), complex)
        change[:, 1 : len(mean) + 1] = (1.0 - np.exp(-2j * np.pi * np.outer(turns, k))) * (mean * trusted)
        moved[name] = beats + np.fft.irfft(change * N, N, axis=1)  # the model moves back, the residual stays
    return moved, turns * T


def _timing(values: Mapping[str, Array]) -> tuple[Array, float, float, dict[str, tuple[Array, Array]]]:
    """Shift of each beat [periods], χ² of the shifts, degrees of freedom of the noise in it, (mean, trusted) spectra.

    Beat b is modelled as the mean beat s_b later: F_bk = m_k e^{-2πi k s_b} + noise of variance S_k + a straight line
    (drift). To first order the shifts are weighted projections on the derivative of the mean beat, all channels
    jointly; repeated until they stand still.
    """
    F = {name: _spectra(beats) for name, beats in values.items()}
    n_beats = len(next(iter(F.values())))
    turns, excess = np.zeros(n_beats), 0.0
    spectra: dict[str, tuple[Array, Array]] = {}
    noise: dict[str, Array] = {}
    N = next(iter(values.values())).shape[1]
    k = np.arange(1, next(iter(F.values())).shape[1] + 1)
    line = np.fft.rfft(np.arange(N) / N)[k] / N
    for _ in range(8):
        score, information = np.zeros(n_beats), 0.0
        parts = {}
        back = np.exp(2j * np.pi * np.outer(turns, k))
        for name, spectrum in F.items():
            turned = spectrum * back
            mean = turned.mean(axis=0)
            turned -= mean
            S = noise.get(name, _pooled(_power(turned)) / (n_beats - 1))
            S = np.maximum(S, (_EXACT**2) * (np.abs(mean) ** 2).sum())
            trusted = np.abs(mean) ** 2 > 9.0 * S / n_beats
            tau = -2j * np.pi * k * mean * trusted
            template = tau - line * (_inner(tau, line, S) / _inner(line, line, S))
            score += (turned @ (template.conj() / S)).real
            information += _inner(template, template, S)
            spectra[name] = (mean, trusted)
            parts[name] = (turned, tau, template, S)
        if not information > 0.0:
            return np.zeros(n_beats), 0.0, 1.0, spectra
        change = score / information
        change -= change.mean()
        for name, (turned, tau, template, S) in parts.items():
            size = _inner(line, line, S)
            left = turned - np.outer(change, tau)
            left -= np.outer((left @ (line.conj() / S)).real / size, line)
            # the share of each harmonic's two numbers that shift and line have taken away
            taken = (np.abs(line) ** 2 / size + np.abs(template) ** 2 / information) / (2.0 * S)
            noise[name] = _pooled(_power(left)) / (_pooled(1.0 - taken) * (n_beats - 1))
        turns = turns + change
        excess = 2.0 * information * float(turns @ turns)
        if np.abs(change).max() ** 2 * information < 1e-6:
            break
    return turns, excess, 2.0 * (2 * _WINDOW + 1) * max(n_beats - 2, 1), spectra


def _spectra(beats: Array) -> Array:
    """Fourier coefficients 1.._TIMING of each beat : (n_beats, K), gaps filled with the mean beat."""
    there = ~np.isnan(beats)
    if not there.all():
        counts = there.sum(axis=0)
        beats = np.where(there, beats, np.where(there, beats, 0.0).sum(axis=0) / counts)
    N = beats.shape[1]
    K = min(_TIMING, (N - 1) // 2)
    return np.ascontiguousarray(np.fft.rfft(beats, axis=1)[:, 1 : K + 1]) / N


def _power(X: Array) -> Array:
    """Σ_b |X_bk|² : (K,)."""
    return np.asarray(np.einsum("bk,bk->k", X, X.conj()).real)


def _inner(a: Array, b: Array, S: Array) -> float:
    return float(((a.conj() * b).real / S).sum())


def _pooled(S: Array) -> Array:
    """The mean over neighbouring harmonics, fewer at the ends."""
    K = len(S)
    total = np.concatenate([[0.0], np.cumsum(S)])
    low = np.maximum(np.arange(K) - _WINDOW, 0)
    high = np.minimum(np.arange(K) + _WINDOW + 1, K)
    return np.asarray((total[high] - total[low]) / (high - low))


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
