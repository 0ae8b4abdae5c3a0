"""Equal beats: cut at one strict period, the slope of the line through their timings; their jitter and their drift.

The harmonic model of a channel that repeats counts in samples and cycles: ``f`` is cycles per sample, dt/T, and

    m_j = Re Σ_k c_k e^{2πi k f j},  k = 0..K,  j = 0..n-1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.special import fdtrc

from solver.errors import InputError

from .. import limits
from ..read.sensors import without_gaps
from .variable_beats import Array, mean

_EXACT = 1e-7  # of the pulse: noise that is assumed at least when beats are timed
# The search for the period ends if the predicted next change is below _ENOUGH standard deviations, or if the last one
# is below _NEARLY and more than _SHRINKS times the one before: noise then limits it
_ENOUGH, _NEARLY, _SHRINKS = 1e-6, 0.1, 0.3


@dataclass(frozen=True)
class Grid:
    """Where equal beats lie. f : cycles a sample; samples : (n_beats, N) the nearest to each phase j/N of each beat.

    in_step : whether beats keep step with the samples.
    """

    f: float
    samples: Array
    in_step: bool
    slip: float = 0.0  # samples by which beats may be off one another
    within: bool = True  # all samples of a beat are its own

    def of(self, x: Array) -> Array:
        """Beats of a channel x : (n,) -> (n_beats, N), without the slope of a slow drift.

        Samples as they are if the beats keep step with them, else the harmonic model plus the residual of the nearest
        one. The model carries the pulse exactly; the residual is moved by less than half a sample but not averaged, so
        that white noise keeps its variance. At high harmonics this small shift is a large part of a period and would
        add noise to the mean beat; the mean of the residual is therefore removed there, and the mean beat is the model.
        At low harmonics the residual is needed: drift leaks into the model of a record that is no whole number of
        beats, and the residual compensates this.
        """
        if self.in_step:
            return _without_slope(x[self.samples])
        N, c = self.samples.shape[1], harmonics(x, self.f)
        moved = (x - evaluate(c, self.f, len(x)))[self.samples]
        spectrum = np.fft.rfft(without_gaps(mean(moved.T)))
        spectrum[len(c) :] = spectrum[: N // limits.MOVED] = 0.0
        return _without_slope(moved - np.fft.irfft(spectrum, N) + evaluate(c, 1.0 / N, N))


def grid(T: float, dt: float, n: int, source: str) -> Grid:
    """The grid of a period T [s] in n samples, dt [s] apart. Raises ValueError if it has fewer than two beats."""
    f = dt / T
    N, n_beats = round(1.0 / f), int((n + 0.5) * f)  # half a sample of tolerance: noise must not cost the last beat
    if N < limits.FEWEST_SAMPLES:
        raise InputError(
            f"{source}: {1 / f:.2g} samples in a period of {T:.4g} s are too few; sample "
            f"{limits.FEWEST_SAMPLES} times a beat or more often, or check the unit of its time column."
        )
    if n_beats < 2:
        raise InputError(
            f"{source}: {n_beats} whole beat in {n * dt:.4g} s of record with a period of {T:.4g} s; "
            "record at least two whole beats."
        )
    in_step = abs(N * f - 1.0) * n < limits.IN_STEP and n_beats * N <= n
    f = 1.0 / N if in_step else f
    at = np.rint(np.arange(n_beats * N) / (N * f)).astype(np.intp)
    return Grid(f, np.minimum(at, n - 1).reshape(n_beats, N), in_step)


def strict_period(channels: Mapping[str, Array], dt: float, T: float, source: str) -> float:
    """The strict period [s] of all channels near T.

    Beats are cut at T and timed, and T is put right by the slope of their shifts. Raises ValueError as :func:`grid` and
    :func:`check_steady`.
    """
    last, n = 0.0, len(next(iter(channels.values())))
    for _ in range(25):
        at = grid(T, dt, n, source)
        turns, information, _ = _timing((at.of(x) for x in channels.values()), at.samples.shape[1])
        b = np.arange(len(turns)) - (len(turns) - 1) / 2.0
        slope = float(b @ turns / (b @ b))
        doubt = float(1.0 / np.sqrt(max(information, np.finfo(float).tiny) * (b @ b)))
        T = dt / at.f * (1.0 + slope)
        shrinks, last = min(1.0, abs(slope) / last) if last > 0.0 else 1.0, abs(slope)
        if shrinks * last < max(4e-16, _ENOUGH * doubt) or (last < _NEARLY * doubt and shrinks > _SHRINKS):
            break
    check_steady(float(np.abs(np.diff(turns)).max()), T, source)
    return T


def check_steady(unsteadiness: float, T: float, source: str) -> None:
    """Raise ValueError if intervals of beats are too far from T [s], by that part of it."""
    if unsteadiness > limits.NEAR:
        raise InputError(
            f"{source}: the heart rate is not steady: if cut every {T:.4g} s, a beat is shifted against the one before "
            f"by up to {unsteadiness:.0%} of that, and more than {limits.NEAR:.0%} cannot be aligned; use a stretch of "
            "the record with a steady rate."
        )


def without_jitter(values: Mapping[str, Array], T: float) -> tuple[Mapping[str, Array], Array]:
    """Values with significant jitter taken out, and the shifts [s]; the same values and zeros if there is none."""
    n_beats, N = next(iter(values.values())).shape
    turns, information, means = _timing(values.values(), N)
    free = max(n_beats - 2, 1)  # shifts beside mean and period
    noise = 2.0 * (2.0 * limits.NEIGHBOURS + 1.0) * free  # numbers that tell it
    if n_beats < 3 or fdtrc(free, noise, information * (turns @ turns) / free) > limits.JITTER:
        return values, np.zeros(n_beats)
    moved = {}
    for (name, beats), mean_beat in zip(values.items(), means, strict=True):
        k = np.arange(1, len(mean_beat) + 1)
        change = np.zeros((n_beats, N // 2 + 1), complex)
        change[:, k] = (1.0 - np.exp(-2j * np.pi * np.outer(turns, k))) * mean_beat
        moved[name] = beats + np.fft.irfft(change * N, N, axis=1)  # the model moves back, the residual stays
    return moved, turns * T


def _timing(beats: Iterable[Array], N: int) -> tuple[Array, float, Array]:
    """Shift of each beat [periods], their information [1/periods²], and the mean beats where they are above the noise :
    (m, K), coefficients 1 … K of m channels; beats : (n_beats, N) of each channel.

    Beat b is modelled as the mean beat s_b later: F_bk = m_k e^{-2πi k s_b} + noise of variance S_k + a straight line
    (drift). To first order the shifts are weighted projections on the derivative of the mean beat, all channels
    jointly; repeated until they stand still.
    """
    F = np.stack([_spectra(x) for x in beats])
    _, n_beats, K = F.shape
    k = np.arange(1, K + 1)
    line = np.fft.rfft(np.arange(N) / N)[k] / N
    turns, S = np.zeros(n_beats), None
    for _ in range(8):
        turned = F * np.exp(2j * np.pi * np.outer(turns, k))
        mean = turned.mean(axis=1)
        turned -= mean[:, None]
        S = _pooled((np.abs(turned) ** 2).sum(axis=1)) / (n_beats - 1) if S is None else S
        S = np.maximum(S, _EXACT**2 * (np.abs(mean) ** 2).sum(axis=1, keepdims=True))
        mean *= np.abs(mean) ** 2 > limits.SURE**2 * S / n_beats
        tau, size = -2j * np.pi * k * mean, _inner(line, line, S)
        template = tau - line * (_inner(tau, line, S) / size)
        information = float(_inner(template, template, S).sum())
        if not information > 0.0:
            return np.zeros(n_beats), 0.0, mean
        change = (turned @ (template.conj() / S)[..., None]).real.sum(axis=0)[:, 0] / information
        change -= change.mean()
        residual = turned - change[:, None] * tau[:, None]
        residual -= (residual @ (line.conj() / S)[..., None]).real / size[:, None] * line
        # the share of each harmonic's two numbers that shift and line have taken away
        taken = (np.abs(line) ** 2 / size + np.abs(template) ** 2 / information) / (2.0 * S)
        S = _pooled((np.abs(residual) ** 2).sum(axis=1)) / (_pooled(1.0 - taken) * (n_beats - 1))
        turns = turns + change
        if np.abs(change).max() ** 2 * information < 1e-6:
            break
    return turns, 2.0 * information, mean


def _spectra(beats: Array) -> Array:
    """Fourier coefficients 1 … MAX_HARMONICS of each beat : (n_beats, K), gaps filled with the mean beat."""
    N = beats.shape[1]
    whole = np.where(np.isnan(beats), without_gaps(mean(beats.T)), beats)
    return np.fft.rfft(whole)[:, 1 : min(limits.MAX_HARMONICS, (N - 1) // 2) + 1] / N


def _inner(a: Array, b: Array, S: Array) -> Array:
    """(m, 1), each harmonic in units of its noise."""
    return np.asarray(((a.conj() * b).real / S).sum(axis=-1, keepdims=True))


def _pooled(S: Array) -> Array:
    """The mean over neighbouring harmonics, fewer at the ends : (m, K)."""
    K = S.shape[1]
    total = np.concatenate([np.zeros((len(S), 1)), np.cumsum(S, axis=1)], axis=1)
    low, high = np.maximum(np.arange(K) - limits.NEIGHBOURS, 0), np.minimum(np.arange(K) + limits.NEIGHBOURS + 1, K)
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def _without_slope(beats: Array) -> Array:
    """Beats without the slope that the slow drift from beat to beat has within each of them.

    A drift puts the same ramp into every beat: the scatter between beats does not show it, the mean beat has it. Its
    slope is that of the beats' levels; the levels themselves stay, and count as scatter of the mean.
    """
    if len(beats) < 3:
        return beats
    measured = np.flatnonzero(~np.isnan(beats).all(axis=1))
    deviations = beats[measured] - mean(beats.T)
    levels = np.interp(np.arange(len(beats)), measured, mean(deviations))  # also of a beat in a gap
    N = beats.shape[1]
    return np.asarray(beats - np.outer(np.gradient(levels), (np.arange(N) + 0.5) / N - 0.5))


# --- the harmonic model of a channel ---------------------------------------------------------------------------------


def _blocks(n: int) -> tuple[int, int]:
    """Samples in a block, about √n, so that the fewest phasors are computed; and blocks."""
    block = 1 << round(np.log2(max(n, 2)) / 2)
    return block, -(-n // block)


@lru_cache(maxsize=8)  # the channels of a record share them
def _phasors(f: float, count: int, stride: int, orders: int) -> Array:
    """e^{-2πi k f stride b}, b = 0..count-1, k = 0..orders-1; cycles are reduced first to keep their digits."""
    cycles = (np.arange(count) * (stride * f)) % 1.0
    return np.exp(-2j * np.pi * (np.outer(cycles, np.arange(orders)) % 1.0))


def sums(x: Array, f: float, orders: int) -> Array:
    """Σ_j x_j e^{-2πi k f j}, k = 0..orders-1 : (orders,) complex."""
    block, blocks = _blocks(len(x))
    table = np.zeros(blocks * block)
    table[: len(x)] = x
    inner = _phasors(f, block, 1, orders)
    both = table.reshape(blocks, block) @ np.hstack([inner.real, inner.imag])
    partial = both[:, :orders] + 1j * both[:, orders:]
    return np.einsum("bk,bk->k", _phasors(f, blocks, block, orders), partial)


def evaluate(c: Array, f: float, n: int) -> Array:
    """m_j = Re Σ_k c_k e^{2πi k f j} at n samples : (n,)."""
    orders, (block, blocks) = len(c), _blocks(n)
    outer = c * _phasors(f, blocks, block, orders).conj()
    inner = _phasors(f, block, 1, orders).conj().T
    return (np.hstack([outer.real, -outer.imag]) @ np.vstack([inner.real, inner.imag])).ravel()[:n]


def highest(f: float, n: int, measured: int) -> int:
    """The highest harmonic that n samples, of which some are ``measured``, tell from its alias."""
    K = int(0.5 / f - 0.5 / max(1.0, n * f))  # distance to the alias: a whole turn over the record
    return max(1, min(K, limits.MOST_HARMONICS, measured // 4))


@lru_cache(maxsize=2)
def _without_gaps(n: int, f: float) -> tuple[Array, bool]:
    """:func:`_normal` of channels without gaps, which share it."""
    return _normal(np.ones(n), f)


def _normal(there: Array, f: float) -> tuple[Array, bool]:
    """The factor of the normal equations, Hermitian and Toeplitz, of the harmonics -K..K.

    there : (n,) 1 where measured, else 0.
    """
    K = highest(f, len(there), int(there.sum()))
    s = sums(there, f, 2 * K + 1)
    matrix = toeplitz(s)
    matrix[np.diag_indices_from(matrix)] += 1e-13 * s[0].real  # gaps may leave a combination barely determined
    return cho_factor(matrix)


def harmonics(x: Array, f: float) -> Array:
    """c_k, k = 0..K, of a channel x : (n,), NaN in gaps, by least squares."""
    there = ~np.isnan(x)
    factor = _without_gaps(len(x), f) if there.all() else _normal(there.astype(float), f)
    K, middle = len(factor[0]) // 2, x[there].mean()
    b = sums(np.where(there, x - middle, 0.0), f, K + 1)
    X = cho_solve(factor, np.concatenate([b[:0:-1].conj(), b]))[K:]
    return np.concatenate([X[:1].real + middle, 2.0 * X[1:]])
