"""The local wall law on a periodic loop: the pressure of a wall from its radius, and its derivatives.

Walls are those of the network with all active effects (:meth:`Coefficients.wall_at`). A viscous stress with memory is
also periodic: every harmonic of the stress of an element is multiplied by M = share/(1 + iωτ).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from .errors import InputError
from .laws.catalogue import neutral_value
from .laws.wall import Moment, Wall
from .network.coefficients import Parameters, walls_at
from .network.description import Network

Array = np.ndarray


def wall_of(network: Network, segment: str, parameters: Parameters | None = None) -> Wall:
    """The wall at the middle of a segment : arrays (B, 1), for parameters as in :func:`solver.simulate`.

    Parameters are not checked, because a search may pass through values that a network may not have. Raises ValueError
    for an unknown segment.
    """
    names = [s.name for s in network.segments]
    if segment not in names:
        raise InputError(f"loop: there is no segment {segment!r}; use one of {', '.join(names)}.")
    return walls_at(network, parameters, np.array([names.index(segment)]), np.array([0.5]))


def pressure(wall: Wall, R: Array, R_t: Array, T: float = 1.0) -> Array:
    """P [Pa] of walls (B, 1), or of one wall with scalar coefficients, on a loop R, R' : (…, N).

    T : its period [s], used for walls with memory.
    """
    A, A_t = np.pi * R * R, 2.0 * np.pi * R * R_t
    return _present(wall, A, A_t, T).pressure(A, A_t)


def tangent(wall: Wall, R: Array, R_t: Array, T: float = 1.0) -> tuple[Array, Array, Array]:
    """P as :func:`pressure`, ∂P/∂R at fixed viscous stress [Pa/m], and ∂P/∂R' of the instantaneous stress [Pa·s/m]."""
    A, A_t, around = np.pi * R * R, 2.0 * np.pi * R * R_t, 2.0 * np.pi * R
    P = _present(wall, A, A_t, T).pressure(A, A_t)
    viscous = P - wall.P_ref - wall.elastic.pressure(np.sqrt(A / wall.A0), wall.K, wall.e)
    return P, around * wall.stiffness(A) - viscous / R, around * wall.viscosity(A, A_t)


def slope(wall: Wall, R: Array, R_t: Array, T: float) -> Array:
    """dP/dR : (N, N) [Pa/m] of the first of some walls on a loop R, R' : (N,), with R' varying with R."""
    _, by_R, by_R_t = (np.atleast_2d(x)[0] for x in tangent(wall, R, R_t, T))
    D = derivative_matrix(len(R), T)
    by_strain = wall.K_h * wall.stress_by_strain(np.pi * R * R, 2.0 * np.pi * R * R_t) + 0.0 * R
    if not wall.remembers:
        matrix = by_R_t[:, None] * D + np.diag(np.atleast_2d(by_strain)[0] / R)
    else:  # the stress is σ = P_v R / (K_h R0)
        law, *others = _memory(wall, len(R), T)[:, 0]
        linear = 2.0 * np.pi * R * np.atleast_2d(wall.viscosity_area)[0] / (np.pi * R * R)
        matrix = circulant(law, len(R)) @ ((by_R_t * R)[:, None] * D + np.diag(np.atleast_2d(by_strain)[0]))
        matrix += circulant(np.sum(others, axis=0) + 0.0 * law, len(R)) @ ((linear * R)[:, None] * D)
        matrix /= R[:, None]
    matrix[np.diag_indices(len(R))] += by_R
    return matrix


def _present(wall: Wall, A: Array, A_t: Array, T: float) -> Wall:
    """The wall with its periodic viscous stress after memory."""
    if not wall.remembers:
        return wall
    N = A.shape[-1]
    harmonics = np.fft.rfft(wall.stresses(A, A_t))
    return replace(wall, moment=Moment.present(np.fft.irfft((_memory(wall, N, T) * harmonics).sum(axis=0), N)))


def _memory(wall: Wall, N: int, T: float) -> Array:
    """M : (m, B, N//2 + 1) for every harmonic."""
    return wall.responses(2j * np.pi / T * np.arange(N // 2 + 1)[:, None])[..., 0]


def circulant(h: Array, N: int) -> Array:
    """(N, N) matrix that multiplies harmonic k of N samples by h_k : (N//2 + 1,)."""
    return np.fft.irfft(h, N)[_differences(N)]


@lru_cache(maxsize=8)
def _differences(N: int) -> Array:
    """i - j of all entries (i, j), modulo N."""
    at = np.arange(N)
    return (at[:, None] - at) % N


@lru_cache(maxsize=8)
def derivative_matrix(N: int, T: float) -> Array:
    """D : (N, N) with D x = dx/dt of N periodic samples, by the trigonometric interpolant."""
    omega = 2.0 * np.pi / T * np.arange(N // 2 + 1)
    omega[N // 2 :] *= N % 2  # the highest harmonic of an even number has no sine
    return circulant(1j * omega, N)


def loop_pressure(network: Network, segment: str, R: Array, T: float) -> Array:
    """The pressure [Pa] of a segment's wall, at its middle, on a periodic loop.

    R : (N,) [m], evenly spaced over the period T [s] without its end. dR/dt is that of the trigonometric interpolant.
    Raises ValueError if R or T do not fit or the segment is unknown.
    """
    R = np.asarray(R, float)
    if R.ndim != 1 or len(R) < 3 or not np.all(R > 0.0) or not (np.isfinite(T) and T > 0.0):
        raise InputError(
            f"loop of {segment}: give at least 3 positive radii [m] and a positive period, not T = {T!r} s."
        )
    return pressure(wall_of(network, segment), R, derivative_matrix(len(R), T) @ R, T)[0]


def column(network: Network, variable: str, R: Array, T: float) -> Array:
    """dP/d(variable) [Pa per SI unit] on the loop of :func:`loop_pressure` : (N,), by second-order differences.

    The wall is that of the variable's segment, or the network's only one. At a bound of the allowed range the
    difference is one-sided. Raises ValueError as :func:`loop_pressure` and ``Network.with_terms``.
    """
    segments = [s.name for s in network.segments]
    prefix, _, key = variable.rpartition(".")
    if prefix not in segments and len(segments) > 1:
        raise InputError(f"{variable}: not of a segment, and network {network.name} has {len(segments)}; cut one out.")
    segment = prefix if prefix in segments else segments[0]
    if variable not in network.parameters():
        network = network.with_terms({variable: neutral_value(key, variable)})
    q, value = network.parameter_quantities()[variable], network.parameters()[variable]
    step = 1e-5 * max(abs(value), q.nominal)

    def at(n: float) -> Any:
        return loop_pressure(network.with_terms({variable: value + n * step}), segment, R, T)

    if value - step > q.low and value + step <= q.high:
        return (at(1.0) - at(-1.0)) / (2.0 * step)
    side = 1.0 if value + 2.0 * step <= q.high else -1.0
    start = at(0.0)
    return side * (4.0 * (at(side) - start) - (at(2.0 * side) - start)) / (2.0 * step)
