"""The measurement chain in the form that a search can follow: gain, lag and the two coefficients of a second order.

The catalogue's f_n and ζ run away where a sensor is perfect; a = 2ζ/ω_n (slow) and b = 1/ω_n² (resonance) are 0 there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..records.beats import Beats
from .fit import Member
from .unknown import values

Array = np.ndarray
Number = float | Array


def transfer(omega: Array, lag: Number, gain: Number, slow: Number, resonance: Number) -> Array:
    """g e^{-iω lag} / (1 + iω a - ω² b): a = 2ζ/ω_n (slow) [s], b = 1/ω_n² (resonance) [s²]; 1 where all is perfect."""
    return np.asarray(gain * np.exp(-1j * omega * lag) / (1.0 + 1j * omega * slow - omega**2 * resonance))


def resonance_of(slow: float, resonance: float) -> tuple[float, float]:
    """f_n [Hz] and ζ of a second-order sensor; of one that is only slow, ζ = 50 stands for the overdamped limit."""
    b = max(resonance, (slow / 100.0) ** 2, 1e-12)
    return 1.0 / (2.0 * np.pi * np.sqrt(b)), slow / (2.0 * np.sqrt(b))


def chain(moved: Mapping[str, Array], channel: str, omega: Array) -> tuple[Array, Array]:
    """Transfer function (…, n) of a measurement chain at omega : (n,), and its offset (…, 1).

    moved : values (…,) of the search's numbers by name; absent ones are neutral.
    """
    own = {
        key: np.asarray(moved.get(f"{channel}.{key}", 0.0))[..., None] for key in ("lag", "slow", "resonance", "offset")
    }
    gain = np.asarray(moved.get(f"{channel}.gain", 1.0))[..., None]
    return transfer(omega, own["lag"], gain, own["slow"], own["resonance"]), own["offset"]


def sense(member: Member, names: Sequence[str], X: Array, T: float, means: bool = True) -> Array:
    """Observation: what the measurement chains of a hypothesis make of the coefficients X : (n, m).

    means : with their offsets.
    """
    if not any(term.is_sensor for term in member.terms):
        return X
    moved = values(member.unknowns, member.x, {})
    omega, X = 2.0 * np.pi / T * np.arange(len(X)), X.copy()
    for i, name in enumerate(names):
        H, offset = chain(moved, name, omega)
        X[:, i] *= H
        X[0, i] += float(offset[0]) * means
    return X


def mean_wander(part: Beats, other: Beats, names: Sequence[str]) -> Array:
    """Variance (m,) by which the mean of one part of a record may be off that of the other: what means drift a beat.

    A slow drift is alike in neighbouring beats, so that averaging over few of them leaves it as it is. A beat with gaps
    counts by what it has, against the mean beat; one without a sample does not count.
    """

    def of(name: str) -> float:
        beats = np.concatenate([other.values[name], part.values[name]])
        beats = beats[~np.isnan(beats).all(axis=1)]
        return float(np.var(np.nanmean(beats - np.nanmean(beats, axis=0), axis=1)))

    return np.array([of(name) for name in names])
