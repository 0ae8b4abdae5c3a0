"""Mean beats as waves: the harmonics above the noise, and the foot of the upstroke."""

from __future__ import annotations

import numpy as np

from solver.quantities.units import INFLOW

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients, derivative, resample, without_high

_POINTS = 2048  # a beat, to resolve a foot to less than a millisecond
_HIGHEST = 40  # harmonic
_NOISE, _SMALL = 3.0, 0.01  # standard deviations, and fraction of the largest harmonic: thresholds for a harmonic
_BACK = 0.3  # of the period before the steepest rise: search range for the end of diastole
FEET = 0.01  # of the period: by which a delay between feet may be off
_LATEST = 0.1  # of the period: the largest delay of a meter; beyond it the clocks differ (doubts.py)
_EARLY = (0.1, 0.3)  # of the rise: the part extrapolated to the foot


def heard(beats: Beats, name: str, small: float = _SMALL) -> Array:
    """The harmonics k >= 1 of a channel's mean beat above its noise : (K,) of k.

    small : fraction of the largest harmonic, below which one is ignored.
    """
    size = np.abs(coefficients(beats.mean(name)))[: _HIGHEST + 1]
    noise = np.zeros(len(size))
    if beats.n_beats > 1:
        noise = np.sqrt(beats.covariance((name,))[: _HIGHEST + 1, 0, 0].real)
    loud = (size > _NOISE * noise) & (size > small * size[1:].max())
    return np.flatnonzero(loud)[int(loud[0]) :]


def smooth(beats: Beats, name: str, most: int | None = None, wave: Array | None = None) -> Array:
    """The mean beat with the harmonics up to the last that is heard, or ``most``, on many points : (n,).

    wave : (N,) instead of the mean beat, such as that before a known filter.
    """
    most = int(max(heard(beats, name), default=1)) if most is None else most
    return without_high(resample(beats.mean(name) if wave is None else wave, _POINTS), most)


def late(beats: Beats, root: str, wave: Array | None = None) -> float:
    """The delay [s] of inlet.Q against the pressure at the same place, foot to foot; 0 if it may be none, or is so
    large that the clocks differ.

    wave : (N,) of inlet.Q before known filters; default: as recorded.
    """
    T = beats.T
    found = later(foot(smooth(beats, INFLOW, wave=wave), T) - foot(smooth(beats, root), T), T)
    return found if max(FEET * T, T / beats.N) < abs(found) < _LATEST * T else 0.0


def foot(x: Array, T: float) -> float:
    """The start of the upstroke [s]: the line through 10 to 30 % of the rise meets the end-diastolic level.

    x : (n,) one beat of period T [s]. This is the method of intersecting tangents (Y. C. Chiu et al., Am. Heart J. 121
    (1991) 1460) with the tangent at the start of the rise, before the arrival of reflected waves.
    """
    rise, start = _rise(x, T)
    first, last = (int(np.argmax(rise > part * rise.max())) for part in _EARLY)
    t = np.arange(first, last + 1)
    slope, at_start = np.polyfit(t, rise[t], 1) if len(t) > 1 else (rise[first] / max(first, 1), 0.0)
    return float((start - at_start / slope) * T / len(x))


def steepest_foot(x: Array, T: float) -> float:
    """The same [s] with the tangent at the steepest point of the rise."""
    rise, start = _rise(x, T)
    slope = np.gradient(rise)
    i = int(np.argmax(slope[: int(np.argmax(rise)) + 1]))
    return float((start + i - rise[i] / slope[i]) * T / len(x))


def later(t: float, T: float) -> float:
    """A time difference [s] within half a period of 0."""
    return (t + 0.5 * T) % T - 0.5 * T


def _rise(x: Array, T: float) -> tuple[Array, int]:
    """The beat from the end of diastole on, above the level there : (n,), and the sample where that is."""
    steep = int(np.argmax(derivative(x, T)))
    before = (steep - np.arange(int(_BACK * len(x)))) % len(x)
    start = int(before[np.argmin(x[before])])
    return np.roll(x, -start) - x[start], start
