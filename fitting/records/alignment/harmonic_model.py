"""The harmonic model of channels that repeat, and its period by Gauss–Newton, all channels together.

Everything here counts in samples and cycles: ``f`` is cycles per sample, dt/T, and the model of a channel is

    m_j = Re Σ_k c_k e^{2πi k f j},  k = 0..K,  j = 0..n-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import Legendre
from scipy.linalg import cho_factor, cho_solve

from .. import thresholds as limit
from .upstrokes import usual_range

Array = np.ndarray

_ENOUGH = 1e-4  # of its standard deviation: a smaller step of the period ends the search
_EXACT = 1e-14  # of a channel: noise that is assumed at least, the rounding of doubles


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
    return max(1, min(K, limit.MOST_HARMONICS, measured // 4))


class Model:
    """Least squares on the harmonics of one set of measured samples, and on a slow drift beside them.

    The normal equations of the harmonics are Hermitian and Toeplitz. Channels x : (n,) are zero in gaps.
    """

    def __init__(self, there: Array, f: float) -> None:
        """there : (n,) bool, where measured."""
        self.f, self.n, self.measured, self.there = f, len(there), int(there.sum()), there.astype(float)
        self.K = highest(f, self.n, self.measured)
        s = sums(self.there, f, 2 * self.K + 1)
        index = np.arange(2 * self.K + 1)
        lag = index[:, None] - index[None, :]
        matrix = np.where(lag >= 0, s[np.abs(lag)], s[np.abs(lag)].conj())
        matrix[index, index] += 1e-13 * s[0].real  # gaps may leave a combination barely determined
        self.factor = cho_factor(matrix)

    @classmethod
    def of(cls, there: Array, f: float) -> Model:
        """Channels without gaps share one."""
        return _without_gaps(len(there), f) if there.all() else cls(there, f)

    def harmonics(self, x: Array) -> Array:
        """c_k, k = 0..K."""
        b = sums(x, self.f, self.K + 1)
        X = cho_solve(self.factor, np.concatenate([b[:0:-1].conj(), b]))[self.K :]
        return np.concatenate([X[:1].real, 2.0 * X[1:]])

    def left(self, x: Array, c: Array) -> Array:
        """x less its harmonics."""
        return np.asarray(x - evaluate(c, self.f, self.n) * self.there)

    @cached_property
    def drift(self) -> tuple[Array, Array]:
        """Polynomials of degree 1 to 3 less their harmonics : (3, n), and these : (3, K + 1); none of many beats, whose
        period no drift can feign."""
        degrees = range(1, 4) if self.n * self.f < limit.MANY_BEATS else range(0)
        t = np.linspace(-1.0, 1.0, self.n)
        drift = [Legendre.basis(degree)(t) * self.there for degree in degrees]
        harmonics = [self.harmonics(x) for x in drift]
        left = [self.left(x, c) for x, c in zip(drift, harmonics, strict=True)]
        return np.array(left).reshape(len(left), self.n), np.array(harmonics).reshape(len(left), self.K + 1)

    def without(self, x: Array) -> tuple[Array, Array]:
        """x less harmonics and drift, and the harmonics."""
        c = self.harmonics(x)
        residual, (drift, harmonics) = self.left(x, c), self.drift
        amounts = np.linalg.solve(drift @ drift.T, drift @ residual)
        return residual - amounts @ drift, c - amounts @ harmonics

    def slope(self, x: Array) -> tuple[float, float]:
        """Score and information of f, in units of the noise of x."""
        residual, c = self.without(x)
        noise = residual @ residual / self.measured
        # of |c_k|² it is 2 noise / n; harmonics below it say nothing on the period
        size = np.maximum(np.abs(c) ** 2, np.finfo(float).tiny)
        trusted = np.maximum(0.0, 1.0 - 8.0 * noise / self.measured / size)
        m = evaluate(2j * np.pi * np.arange(len(c)) * trusted * c, self.f, self.n)
        g = self.without((np.arange(self.n) - (self.n - 1) / 2.0) * m * self.there)[0]  # the period's own
        noise = max(noise, _EXACT**2 * float(x @ x) / self.measured, np.finfo(float).tiny)
        return float(residual @ g) / noise, float(g @ g) / noise


@lru_cache(maxsize=2)
def _without_gaps(n: int, f: float) -> Model:
    return Model(np.ones(n, bool), f)


def harmonics(x: Array, f: float) -> Array:
    """c_k, k = 0..K, of a channel x : (n,), NaN in gaps, by least squares."""
    there = ~np.isnan(x)
    middle = x[there].mean()
    c = Model.of(there, f).harmonics(np.where(there, x - middle, 0.0))
    c[0] += middle
    return c


def refine(channels: Sequence[Array], f: float) -> float:
    """The f of all channels, (n,) each, on growing stretches: each tells it well enough not to lose count in the next.

    A channel counts in units of its own noise.
    """
    n = len(channels[0])
    ranges = [usual_range(values) for values in channels]
    there = np.array([(low <= x) & (x <= high) for x, (low, high) in zip(channels, ranges, strict=True)])
    x = np.array([np.where(t, values - values[t].mean(), 0.0) for t, values in zip(there, channels, strict=True)])
    length = min(n, int(6.0 / f) + 1)
    while True:
        part = np.flatnonzero(np.count_nonzero(there[:, :length], axis=1) > (0.5 * length if length < n else 0))
        if len(part):
            f = _gauss_newton(x[part, :length], there[part, :length], f)
        if length == n:
            return f
        length = min(n, 3 * length)


def _gauss_newton(x: Array, there: Array, f: float) -> float:
    """The f of the least-squares fit of harmonics, drift and period to one stretch; x : (m, n), zero in gaps."""
    n, last = x.shape[1], np.inf
    for _ in range(25):
        slopes = [Model.of(where, f).slope(each) for each, where in zip(x, there, strict=True)]
        score, information = np.sum(slopes, axis=0)
        if not information > 0.0:
            return f
        step = float(np.clip(score / information, -0.1 / n, 0.1 / n))
        f += step
        doubt = 1.0 / np.sqrt(information)  # standard deviation of f
        if abs(step) < max(4e-16 * f, _ENOUGH * doubt) or (abs(step) < 1e-9 * f and abs(step) > 0.3 * last):
            return f  # rounding has the last word where there is no noise
        last = abs(step)
    return f
