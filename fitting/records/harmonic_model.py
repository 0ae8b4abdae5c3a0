"""The harmonic model of channels that repeat, and its period by Gauss–Newton, all channels together.

Everything here counts in samples and cycles: ``f`` is cycles per sample, dt/T, and the model of a channel is

    m_j = Re Σ_k c_k e^{2πi k f j},  k = 0..K,  j = 0..n-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Legendre
from scipy.linalg import cho_factor, cho_solve

from . import thresholds as limit

Array = np.ndarray

_ENOUGH = 1e-4  # of its standard deviation: a smaller step of the period ends the search
_EXACT = 1e-14  # of a channel: noise that is assumed at least, the rounding of doubles


def _block(n: int) -> int:
    """Samples in a block: about √n, so that the fewest phasors are computed."""
    return 1 << round(np.log2(max(n, 2)) / 2)


@lru_cache(maxsize=8)  # the channels of a record share them
def _phasors(f: float, count: int, stride: int, orders: int) -> Array:
    """e^{-2πi k f stride b}, b = 0..count-1, k = 0..orders-1; cycles are reduced first to keep their digits."""
    cycles = (np.arange(count) * (stride * f)) % 1.0
    return np.exp(-2j * np.pi * (np.outer(cycles, np.arange(orders)) % 1.0))


def sums(x: Array, f: float, orders: int) -> Array:
    """Σ_j x_j e^{-2πi k f j}, k = 0..orders-1 : (orders,) complex."""
    block = _block(len(x))
    blocks = -(-len(x) // block)
    table = np.zeros(blocks * block)
    table[: len(x)] = x
    inner = _phasors(f, block, 1, orders)
    both = table.reshape(blocks, block) @ np.hstack([inner.real, inner.imag])
    partial = both[:, :orders] + 1j * both[:, orders:]
    return np.einsum("bk,bk->k", _phasors(f, blocks, block, orders), partial)


def evaluate(c: Array, f: float, n: int) -> Array:
    """m_j = Re Σ_k c_k e^{2πi k f j} at n samples : (n,)."""
    block = _block(n)
    orders, blocks = len(c), -(-n // block)
    outer = c * _phasors(f, blocks, block, orders).conj()
    inner = _phasors(f, block, 1, orders).conj().T
    return (np.hstack([outer.real, -outer.imag]) @ np.vstack([inner.real, inner.imag])).ravel()[:n]


def highest(f: float, n: int, measured: int) -> int:
    """The highest harmonic that n samples, of which some are ``measured``, tell from its alias."""
    K = int(0.5 / f - 0.5 / max(1.0, n * f))  # distance to the alias: a whole turn over the record
    return max(1, min(K, limit.MOST_HARMONICS, measured // 4))


@dataclass(frozen=True)
class Normal:
    """The normal equations of the harmonic model for one set of measured samples: Hermitian, Toeplitz, factored."""

    f: float
    K: int
    factor: tuple[Array, bool]

    @classmethod
    def of(cls, there: Array | None, f: float, K: int, n: int) -> Normal:
        """there : (n,) 1 where measured, 0 in gaps; None without gaps. One set serves all channels without gaps."""
        s = sums(np.ones(n) if there is None else there, f, 2 * K + 1)
        index = np.arange(2 * K + 1)
        lag = index[:, None] - index[None, :]
        matrix = np.where(lag >= 0, s[np.abs(lag)], s[np.abs(lag)].conj())
        matrix[index, index] += 1e-13 * s[0].real  # gaps may leave a combination barely determined
        return cls(f, K, cho_factor(matrix))

    def solve(self, x: Array) -> Array:
        """c_k, k = 0..K, by least squares; x : (n,), zero in gaps."""
        b = sums(x, self.f, self.K + 1)
        X = cho_solve(self.factor, np.concatenate([b[:0:-1].conj(), b]))[self.K :]
        return np.concatenate([X[:1].real, 2.0 * X[1:]])


@lru_cache(maxsize=2)
def _without_gaps(f: float, K: int, n: int) -> Normal:
    return Normal.of(None, f, K, n)


def harmonics(x: Array, f: float) -> Array:
    """c_k, k = 0..K, of a channel x : (n,), NaN in gaps, by least squares."""
    there, n = ~np.isnan(x), len(x)
    K, middle = highest(f, n, int(there.sum())), x[there].mean()
    normal = _without_gaps(f, K, n) if there.all() else Normal.of(there.astype(float), f, K, n)
    c = normal.solve(np.where(there, x - middle, 0.0))
    c[0] += middle
    return c


def refine(channels: Sequence[Array], f: float) -> float:
    """The f of all channels, (n,) each, on growing stretches: each tells it well enough not to lose count in the next.

    A channel counts in units of its own noise.
    """
    n = len(channels[0])
    x, there = np.array([_measured(values) for values in channels]).transpose(1, 0, 2)
    length = min(n, int(6.0 / f) + 1)
    while True:
        part = np.flatnonzero(np.count_nonzero(there[:, :length], axis=1) > (0.5 * length if length < n else 0))
        if len(part):
            f = _gauss_newton(x[part, :length], there[part, :length] > 0.0, f)
        if length == n:
            return f
        length = min(n, 3 * length)


def _measured(values: Array) -> tuple[Array, Array]:
    """A channel about its mean, 0 in gaps and at spikes, and 1 where there are none."""
    low, high = np.nanquantile(values, limit.ORDINARY)
    there = np.abs(np.nan_to_num(values, nan=np.inf) - 0.5 * (low + high)) <= 1.5 * (high - low)
    return np.where(there, values - values[there].mean(), 0.0), there.astype(float)


def _gauss_newton(x: Array, there: Array, f: float) -> float:
    """The f of the least-squares fit of harmonics, drift and period to one stretch; x : (m, n), zero in gaps."""
    n = x.shape[1]
    last = np.inf
    for _ in range(25):
        whole = _Stretch.of(None, f, n) if there.all(axis=1).any() else None
        score = information = 0.0
        for each, where in zip(x, there, strict=True):
            stretch = whole if whole is not None and where.all() else _Stretch.of(where, f, n)
            s, i = stretch.slope(each)
            score, information = score + s, information + i
        if not information > 0.0:
            return f
        step = float(np.clip(score / information, -0.1 / n, 0.1 / n))
        f += step
        doubt = 1.0 / np.sqrt(information)  # standard deviation of f
        if abs(step) < max(4e-16 * f, _ENOUGH * doubt) or (abs(step) < 1e-9 * f and abs(step) > 0.3 * last):
            return f  # rounding has the last word where there is no noise
        last = abs(step)
    return f


def _drift(n: int, f: float) -> Array:
    """Polynomials of degree 1 to 3 over a stretch : (3, n); none for many beats, whose period no drift can feign."""
    degrees = range(1, 4) if n * f < limit.MANY_BEATS else range(0)
    return np.array([Legendre.basis(d)(np.linspace(-1.0, 1.0, n)) for d in degrees]).reshape(len(degrees), n)


class _Stretch:
    """Least squares on harmonics and drift together: the harmonics are taken out of the drift first."""

    def __init__(self, normal: Normal, there: Array | None, n: int) -> None:
        self.normal, self.there, self.n = normal, there, n
        drift = _drift(n, normal.f) if there is None else _drift(n, normal.f) * there
        self.coefficients = [normal.solve(each) for each in drift]
        self.left = np.array([each - self._model(c) for each, c in zip(drift, self.coefficients, strict=True)])

    @classmethod
    def of(cls, there: Array | None, f: float, n: int) -> _Stretch:
        """there : (n,) bool, where measured; None without gaps."""
        K = highest(f, n, n if there is None else int(there.sum()))
        return cls(Normal.of(None if there is None else there.astype(float), f, K, n), there, n)

    def slope(self, x: Array) -> tuple[float, float]:
        """Score and information of the period f, in units of the noise of x : (n,)."""
        measured = self.n if self.there is None else int(self.there.sum())
        residual, c = self.without(x)
        noise = residual @ residual / measured
        # of |c_k|² it is 2 noise / n; harmonics below it say nothing on the period
        trusted = np.maximum(0.0, 1.0 - 8.0 * noise / measured / np.maximum(np.abs(c) ** 2, np.finfo(float).tiny))
        m = evaluate(2j * np.pi * np.arange(len(c)) * trusted * c, self.normal.f, self.n)
        index = np.arange(self.n) - (self.n - 1) / 2.0
        g = self.without(index * m if self.there is None else index * m * self.there)[0]  # the period's own
        noise = max(noise, _EXACT**2 * float(x @ x) / measured, np.finfo(float).tiny)
        return float(residual @ g) / noise, float(g @ g) / noise

    def _model(self, c: Array) -> Array:
        model = evaluate(c, self.normal.f, self.n)
        return model if self.there is None else model * self.there

    def without(self, x: Array) -> tuple[Array, Array]:
        """x less harmonics and drift, and the harmonics."""
        c = self.normal.solve(x)
        residual = x - self._model(c)
        if len(self.left):
            amounts = np.linalg.solve(self.left @ self.left.T, self.left @ residual)
            residual = residual - amounts @ self.left
            c = c - amounts @ np.array(self.coefficients)
        return residual, c
