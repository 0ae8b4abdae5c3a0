"""The local wall law on a periodic loop: the pressure of one segment's wall from its radius, and its derivatives."""

from __future__ import annotations

import numpy as np

from .catalogue import neutral_value
from .coefficients import coefficients
from .network import Network

Array = np.ndarray


def loop_pressure(network: Network, segment: str, R: Array, T: float) -> Array:
    """The pressure [Pa] of a segment's wall, at its middle, on a periodic loop.

    R : (N,) [m], evenly spaced over the period T [s] without its end. dA/dt is that of the trigonometric interpolant;
    memory is periodic too. Raises ValueError where R or T do not fit or there is no such segment.
    """
    R = np.asarray(R, float)
    if R.ndim != 1 or len(R) < 3 or not np.all(R > 0.0) or not (np.isfinite(T) and T > 0.0):
        raise ValueError(
            f"loop of {segment}: give at least 3 positive radii [m] and a positive period, not T = {T!r} s."
        )
    names = [s.name for s in network.segments]
    if segment not in names:
        raise ValueError(f"loop: there is no segment {segment!r}; use one of {', '.join(names)}.")
    wall = coefficients(network).wall_at(np.array([names.index(segment)]), np.array([0.5])).at(np.zeros(len(R), int))
    A, omega = np.pi * R * R, 2.0 * np.pi / T * np.arange(len(R) // 2 + 1)
    A_t = np.fft.irfft(1j * omega * np.fft.rfft(A), len(R))
    if wall.tau is not None:
        fading = np.fft.rfft(wall.viscous_stress(A, A_t)) / (1.0 + 1j * omega * wall.tau.flat[0])
        wall = wall.remembering(np.fft.irfft(fading, len(R)), 0.0)
    return wall.pressure(A, A_t)[0]


def column(network: Network, variable: str, R: Array, T: float) -> Array:
    """dP/d(variable) [Pa per SI unit] on the loop of :func:`loop_pressure` : (N,), by second-order differences.

    The wall is that of the variable's segment, or the network's only one. A number at the end of its allowed range is
    varied to the inside. Raises ValueError as :func:`loop_pressure` and ``Network.with_terms``.
    """
    segments = [s.name for s in network.segments]
    prefix, _, key = variable.rpartition(".")
    if prefix not in segments and len(segments) > 1:
        raise ValueError(f"{variable}: not of a segment, and network {network.name} has {len(segments)}; cut one out.")
    segment = prefix if prefix in segments else segments[0]
    if variable not in network.parameters():
        network = network.with_terms({variable: neutral_value(key, variable)})
    q, value = network.parameter_quantities()[variable], network.parameters()[variable]
    step = 1e-5 * max(abs(value), q.nominal)

    def at(n: float) -> Array:
        return loop_pressure(network.with_terms({variable: value + n * step}), segment, R, T)

    if value - step > q.low and value + step <= q.high:
        return (at(1.0) - at(-1.0)) / (2.0 * step)
    side = 1.0 if value + 2.0 * step <= q.high else -1.0
    start = at(0.0)
    return side * (4.0 * (at(side) - start) - (at(2.0 * side) - start)) / (2.0 * step)
