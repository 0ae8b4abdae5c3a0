"""The paper's spectral derivative and its loop over the threshold γ (six steps of the section on the wall model).

A beat of N samples has the coefficients R̂_k = (1/N) Σ R_n e^{-2πikn/N}, k = 0 … N/2 (:func:`coefficients`); those
below γ in absolute value are set to 0, the rest gives R and dR/dt. N may be even or odd: the coefficient at k = N/2 of
an even N has no derivative and is kept out of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

_LONGEST = 64  # thresholds tried at once: a beat of more samples has more harmonics than walls answer to


@dataclass(frozen=True)
class Filtered:
    """A beat without its small harmonics.

    R : (N,) [m], R_t : (N,) [m/s]. gamma : the threshold [m] that was chosen. kept : the harmonics above it.
    """

    R: Array
    R_t: Array
    gamma: float
    kept: tuple[int, ...]


def coefficients(x: Array) -> Array:
    """Fourier coefficients x̂_k = (1/N) Σ x_n e^{-2πikn/N} of the last axis, k = 0 … N//2."""
    return np.fft.rfft(x) / x.shape[-1]


def derivative(x: Array, T: float) -> Array:
    """dx/dt of periodic samples x : (…, N) over the period T [s]: multiplication by 2πik/T (Steps 3 and 4)."""
    return _from_coefficients(coefficients(x), x.shape[-1], T)[1]


def resample(x: Array, N: int) -> Array:
    """Periodic samples (…, n) on N points: the trigonometric polynomial through them, cut where N is too coarse."""
    n = x.shape[-1]
    if n == N:
        return x
    c = coefficients(x)
    if n % 2 == 0:  # the Nyquist term stands for both k = n/2 and k = -n/2
        c[..., -1] *= 0.5
    keep = min(n // 2, (N - 1) // 2) + 1
    return np.fft.irfft(c[..., :keep], N) * N


def interpolated(x: Array, M: int) -> Array:
    """The trigonometric interpolant of periodic samples (…, N) at M equidistant phases, without truncation."""
    every = -(-x.shape[-1] // M)
    return resample(x, every * M)[..., ::every]


def scaled(x: Array, h: Array) -> Array:
    """Periodic samples x : (…, N) with their harmonics times h : (…, n), none beyond."""
    n = min(h.shape[-1], x.shape[-1] // 2 + 1)
    return np.fft.irfft(h[..., :n] * np.fft.rfft(x)[..., :n], x.shape[-1])


def without_high(x: Array, most: int) -> Array:
    """Periodic samples x : (…, N) without the harmonics above ``most``."""
    return np.fft.irfft(np.fft.rfft(x)[..., : most + 1], x.shape[-1])


def shift(x: Array, fraction: float) -> Array:
    """Periodic samples x : (…, N) delayed by a fraction of the period: x(t - fraction · T)."""
    N = x.shape[-1]
    k = np.arange(N // 2 + 1) % (N - N // 2)  # the coefficient at N/2 stays, as it has no derivative
    return np.fft.irfft(np.fft.rfft(x) * np.exp(-2j * np.pi * k * fraction), N)


def gamma_loop(P: Array, R: Array, T: float, columns: Callable[[Array, Array], Array]) -> Filtered:
    """The paper's loop: the threshold γ on |R̂_k| whose filtered R and dR/dt explain P best.

    P, R : (N,) [Pa], [m], one beat of period T [s]. columns(R, R_t) : (…, N) -> (…, N, p), the matrix M.
    Step 6 lowers γ until J(C) = (1/N) √Σ(M C - P)² stops falling. Noise gives J many small valleys, so the loop runs
    through all thresholds that make a difference and takes the lowest.
    """
    N = P.shape[-1]
    c = coefficients(R)
    size = np.abs(c)
    pulsatile = np.sort(size[1:])
    gammas = np.concatenate([[0.0], np.unique(pulsatile[-_LONGEST:])])  # γ equal to an amplitude keeps it
    masks = size >= gammas[:, None]
    masks[:, 0] = True  # the mean is no wave
    filtered, rates = _from_coefficients(np.where(masks, c, 0.0), N, T)
    J = _cost(columns(filtered, rates), P)
    J[masks[:, 1:].sum(axis=1) == 0] = np.inf
    # of thresholds that do equally well (to rounding), the one that keeps least
    best = int(np.flatnonzero(J <= J.min() * (1.0 + 1e-9))[-1])
    return Filtered(
        filtered[best],
        rates[best],
        float(gammas[best]),
        tuple(int(k) for k in np.flatnonzero(masks[best]) if k > 0),
    )


def _from_coefficients(c: Array, N: int, T: float) -> tuple[Array, Array]:
    """x and dx/dt, (…, N) each, of the coefficients of :func:`coefficients`."""
    k = np.arange(c.shape[-1])
    rate = 2j * np.pi / T * k * c
    if N % 2 == 0:
        rate[..., -1] = 0.0
    return np.fft.irfft(c, N) * N, np.fft.irfft(rate, N) * N


def _cost(M: Array, P: Array) -> Array:
    """J(C) = (1/N) √Σ(M C - P)² at the least-squares C, for a stack of matrices M : (g, N, p)."""
    scale = np.linalg.norm(M, axis=-2, keepdims=True)
    q = np.linalg.qr(M / np.where(scale > 0.0, scale, 1.0))[0]
    residual = P - (q @ (P @ q)[..., None])[..., 0]
    return np.linalg.norm(residual, axis=-1) / P.shape[-1]
