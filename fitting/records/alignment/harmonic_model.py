"""The harmonic model of a channel that repeats.

Everything here counts in samples and cycles: ``f`` is cycles per sample, dt/T, and the model of a channel is

    m_j = Re Σ_k c_k e^{2πi k f j},  k = 0..K,  j = 0..n-1.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from .. import limits

Array = np.ndarray


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
    index = np.arange(2 * K + 1)
    lag = index[:, None] - index[None, :]
    matrix = np.where(lag >= 0, s[np.abs(lag)], s[np.abs(lag)].conj())
    matrix[index, index] += 1e-13 * s[0].real  # gaps may leave a combination barely determined
    return cho_factor(matrix)


def harmonics(x: Array, f: float) -> Array:
    """c_k, k = 0..K, of a channel x : (n,), NaN in gaps, by least squares."""
    there = ~np.isnan(x)
    factor = _without_gaps(len(x), f) if there.all() else _normal(there.astype(float), f)
    K, middle = len(factor[0]) // 2, x[there].mean()
    b = sums(np.where(there, x - middle, 0.0), f, K + 1)
    X = cho_solve(factor, np.concatenate([b[:0:-1].conj(), b]))[K:]
    return np.concatenate([X[:1].real + middle, 2.0 * X[1:]])
