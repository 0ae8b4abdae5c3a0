"""The period of a record: found by autocorrelation, refined by Gauss–Newton on a harmonic model.

Everything here counts in samples and cycles: ``f`` is cycles per sample, dt/T, and the model of a channel is

    m_j = Re Σ_k c_k e^{2πi k f j},  k = 0..K,  j = 0..n-1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import Legendre
from scipy.linalg import cho_factor, cho_solve

Array = np.ndarray

SHORTEST, LONGEST = 0.1, 1.0 / 0.3  # periods that are looked for [s]: heart rates of 10 and 0.3 Hz
FEWEST = 8  # samples a beat
_SCREENED = 64.0  # [s] of each channel that the search looks at
_FINE = 5e-3  # [s], the time step of the search
_WANDER = 0.25  # [Hz]; slower than any heart
_LEAST = 0.6  # correlation from beat to beat; with less there is no beat
_SLACK = 0.04  # by which the correlation one beat on may stay behind the one several beats on
_ORDINARY = (0.02, 0.98)  # quantiles: what lies beyond them by the distance between them is a spike
_STRAYED = 0.05  # of the period, by which refinement may move it: by more only where beats come at no steady rate
_ENOUGH = 1e-4  # of its standard deviation: a smaller step of the period ends the search
_MANY = 200.0  # beats
MOST = 128  # harmonics of a model; what lies above is left to the residual


@dataclass(frozen=True)
class Found:
    """A period [s], the channel it was found in, and the correlation from beat to beat there.

    steady : refined to a strict period of the whole record; else no such period is near, and T is a usual distance of
    beats.
    """

    T: float
    channel: str
    correlation: float
    steady: bool


def find_period(channels: Mapping[str, Array], dt: float, source: str) -> Found:
    """The period of the channel that repeats best, to a few thousandths, then refined on that channel if it is strict.

    Where the rate drifts, the refinement counts the beats of one stretch in another, and ends far from all of them.

    Raises ValueError if nothing repeats, or not twice.
    """
    span = len(next(iter(channels.values()))) * dt
    if span < 2.0 * SHORTEST:
        raise ValueError(
            f"{source}: {span:.3g} s of record cannot hold two beats of {SHORTEST:g} s, the shortest; check the unit "
            f"of its time column, or record longer."
        )
    screened = {name: _search(_excerpt(values, dt), dt) for name, values in channels.items()}
    best = max(screened, key=lambda name: screened[name][1])
    T, correlation = screened[best]
    if correlation < _LEAST:
        raise ValueError(
            f"{source}: no periodicity found between {SHORTEST:g} and {LONGEST:.2g} s in {span:.4g} s of record "
            f"(best correlation {max(correlation, 0.0):.2f}, in {best}); record at least two whole beats of "
            f"{FEWEST} samples or more each, or give the period."
        )
    if 2.0 * T > span * 1.02:
        raise ValueError(
            f"{source}: one beat only: {span:.4g} s of record with a period of about {T:.3g} s; "
            f"record at least two whole beats of {FEWEST} samples or more each."
        )
    refined = dt / refine(channels[best], dt / T)
    steady = abs(refined / T - 1.0) <= _STRAYED
    return Found(refined if steady else T, best, correlation, steady)


def _excerpt(values: Array, dt: float) -> Array:
    """The stretch of at most _SCREENED seconds with the fewest gaps."""
    n = round(_SCREENED / dt)
    starts = range(0, max(1, len(values) - n // 2), max(1, n))
    return max((values[i : i + n] for i in starts), key=lambda piece: np.count_nonzero(~np.isnan(piece)))


def _search(values: Array, dt: float) -> tuple[float, float]:
    """The shortest lag at which the values repeat about as well as they ever do [s], and the correlation there."""
    there = ~np.isnan(values)
    if np.count_nonzero(there) < max(2 * FEWEST, 0.5 * len(values)):
        return 0.0, -1.0
    index = np.arange(len(values))
    x = np.interp(index, index[there], values[there])
    low, high = np.quantile(x, _ORDINARY)  # a few spikes must not hide the beat
    x = np.clip(x, low - (high - low), high + (high - low))
    few = max(1, int(_FINE / dt))
    x = x[: len(x) // few * few].reshape(-1, few).mean(axis=1)
    step = few * dt
    x = _without_wander(x, step)
    lags = min(int(LONGEST / step) + 2, int(0.75 * len(x)))
    r = _correlation(x, lags)
    falls = np.flatnonzero(r < 0.2)  # before the first of them, all lags resemble lag 0
    first = max(int(SHORTEST / step * 0.97), int(falls[0]) if len(falls) else lags, 1)
    if first >= lags - 2:
        return 0.0, -1.0
    peaks = first + 1 + np.flatnonzero((r[first + 1 : -1] >= r[first:-2]) & (r[first + 1 : -1] > r[first + 2 :]))
    if len(peaks) == 0:
        return 0.0, -1.0
    lag, height = _vertex(r, peaks)
    enough = height.max() - max(_SLACK, 1.0 - height.max())
    shortest = lag[np.flatnonzero(height >= enough)[0]]
    near = np.flatnonzero((lag >= shortest) & (lag <= 1.2 * shortest))
    at = near[height[near].argmax()]
    return float(lag[at] * step), float(height[at])


def _without_wander(x: Array, step: float) -> Array:
    """Without its straight line, and without what is slower than any heart where the record can tell."""
    index = np.arange(len(x)) - (len(x) - 1) / 2.0
    x = x - x.mean()
    x = x - index * (index @ x) / (index @ index)
    if len(x) * step * _WANDER >= 2.0:
        spectrum = np.fft.rfft(x)
        spectrum[np.fft.rfftfreq(len(x), step) < _WANDER] = 0.0
        x = np.fft.irfft(spectrum, len(x))
    return x


def _correlation(x: Array, lags: int) -> Array:
    """Pearson's correlation of x[:-L] with x[L:], L = 0..lags-1: exactly 1 at the period of a periodic x."""
    n = len(x)
    size = 1 << int(np.ceil(np.log2(n + lags)))
    spectrum = np.fft.rfft(x, size)
    products = np.fft.irfft(spectrum * spectrum.conj(), size)[:lags]
    sums, squares = np.concatenate([[0.0], np.cumsum(x)]), np.concatenate([[0.0], np.cumsum(x * x)])
    count = n - np.arange(lags)
    head, tail = sums[count], sums[n] - sums[:lags]
    head2, tail2 = squares[count], squares[n] - squares[:lags]
    spread = (head2 - head * head / count) * (tail2 - tail * tail / count)
    floor = (1e-12 * squares[n]) ** 2
    return np.where(spread > floor, (products - head * tail / count) / np.sqrt(np.maximum(spread, floor)), 0.0)


def _vertex(r: Array, peaks: Array) -> tuple[Array, Array]:
    """Place and height of the parabola through each peak and its neighbours."""
    left, middle, right = r[peaks - 1], r[peaks], r[peaks + 1]
    bend = left - 2.0 * middle + right
    offset = np.where(bend < 0.0, 0.5 * (left - right) / np.where(bend < 0.0, bend, 1.0), 0.0)
    return peaks + offset, middle - 0.25 * (left - right) * offset


# --- the harmonic model -------------------------------------------------------------------------------------------


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
    return max(1, min(K, MOST, measured // 4))


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


def refine(values: Array, f: float) -> float:
    """f by Gauss–Newton on growing stretches: each tells the period well enough not to lose count in the next."""
    n = len(values)
    low, high = np.nanquantile(values, _ORDINARY)
    there = np.abs(np.nan_to_num(values, nan=np.inf) - 0.5 * (low + high)) <= 1.5 * (high - low)  # no gaps, no spikes
    filled = np.where(there, values - values[there].mean(), 0.0)
    length = min(n, int(6.0 / f) + 1)
    while True:
        if np.count_nonzero(there[:length]) > 0.5 * length or length == n:
            f = _gauss_newton(filled[:length], there[:length], f)
        if length == n:
            return f
        length = min(n, 3 * length)


def _gauss_newton(x: Array, there: Array, f: float) -> float:
    """The f of the least-squares fit of harmonics, drift and period to one stretch; x : (n,), zero in gaps."""
    n = len(x)
    gaps = None if there.all() else there.astype(float)
    measured = int(there.sum())
    index = np.arange(n) - (n - 1) / 2.0
    drift = _drift(n, f) * there
    last = np.inf
    for _ in range(25):
        K = highest(f, n, measured)
        model = _Stretch(Normal.of(gaps, f, K, n), there, drift)
        residual, c = model.without(x)
        noise = 2.0 * (residual @ residual) / measured**2  # of |c_k|²; harmonics below it say nothing on the period
        trusted = np.maximum(0.0, 1.0 - 4.0 * noise / np.maximum(np.abs(c) ** 2, np.finfo(float).tiny))
        slope = evaluate(2j * np.pi * np.arange(K + 1) * trusted * c, f, n)
        g = model.without(index * slope * there)[0]  # what the other coefficients explain is not the period's
        size = g @ g
        if not size > 0.0:
            return f
        step = float(np.clip(residual @ g / size, -0.1 / n, 0.1 / n))
        f += step
        doubt = np.sqrt(residual @ residual / (measured * size))  # standard deviation of f
        if abs(step) < max(4e-16 * f, _ENOUGH * doubt) or (abs(step) < 1e-9 * f and abs(step) > 0.3 * last):
            return f  # rounding has the last word where there is no noise
        last = abs(step)
    return f


def _drift(n: int, f: float) -> Array:
    """Polynomials of degree 1 to 3 over a stretch : (3, n); none for many beats, whose period no drift can feign."""
    degrees = range(1, 4) if n * f < _MANY else range(0)
    return np.array([Legendre.basis(d)(np.linspace(-1.0, 1.0, n)) for d in degrees]).reshape(len(degrees), n)


class _Stretch:
    """Least squares on harmonics and drift together: the harmonics are taken out of the drift first."""

    def __init__(self, normal: Normal, there: Array, drift: Array) -> None:
        self.normal, self.there = normal, there
        self.coefficients = [normal.solve(each) for each in drift]
        self.left = np.array([each - self._model(c) for each, c in zip(drift, self.coefficients, strict=True)])

    def _model(self, c: Array) -> Array:
        return evaluate(c, self.normal.f, len(self.there)) * self.there

    def without(self, x: Array) -> tuple[Array, Array]:
        """x less harmonics and drift, and the harmonics."""
        c = self.normal.solve(x)
        residual = x - self._model(c)
        if len(self.left):
            amounts = np.linalg.solve(self.left @ self.left.T, self.left @ residual)
            residual = residual - amounts @ self.left
            c = c - amounts @ np.array(self.coefficients)
        return residual, c
