"""Beats that differ: linear response of the channels to a drive whose beats differ, and means of beats that wander, by
breathing, which moves all channels together, and by drift.

The linear response h to the drive q of a whole record, cut into beats as the record was (C_b), is compared with the
periodic response to the mean beat q̄:

    change_b = C_b(h ∗ q) - mean_b C_b(h ∗ q),      seam = mean_b C_b(h ∗ q) - h ∗ q̄.

A simulation of the mean beat cannot contain the seam: the ends of the mean beat do not meet, and each beat depends on
the previous one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .. import limits
from ..alignment.beats import Array, Beats
from .spectral import coefficients, scaled

Transfer = Callable[[float, int], Array]


@dataclass(frozen=True)
class BeatVariation:
    """Response of the channels to the variation of the drive between beats.

    change : (m, n_beats, N). seam : (m, N). doubt : (m, N) by which the seam changes if the beats before the record
    were larger than the mean by a standard deviation of the others.
    """

    change: Array
    seam: Array
    doubt: Array

    def coefficients(self, n: int) -> tuple[Array, Array, Array]:
        """(n, m) of the seam, and of its errors by uncertain walls and by unknown earlier beats."""
        seam, doubt = (coefficients(x)[:, :n].T for x in (self.seam, self.doubt))
        return seam, limits.SEAM_ERROR * seam, doubt


def beat_variation(
    beats: Beats, drive: str, transfer: Transfer, harmonics: int, memory: bool = True
) -> BeatVariation | None:
    """The response of channels to beat-to-beat variation of the drive; None of beats cut at equal intervals.

    transfer(T, n) : (n + 1, m) the linear response at the harmonics 0 … n of a period T [s]. harmonics : highest
    harmonic of a beat. memory : whether the response may contain beats before the record.
    """
    if beats.variable is None:
        return None
    singly, N, mean = beats.variable, beats.N, beats.mean(drive)
    first, last = singly.edges[[0, -1]]
    q = singly.channels[drive][first:last]
    before = limits.BEATS_BEFORE * N
    length = before + len(q)
    H = transfer(length * singly.dt, int(harmonics * length / N)).T
    larger = np.zeros(length)
    if memory:
        unknown = np.tile(mean, limits.BEATS_UNKNOWN)
        sizes = np.nanstd(beats.values[drive], axis=1)  # of the beats
        larger[before - len(unknown) : before] = unknown * float(np.nanstd(sizes) / np.nanmean(sizes))

    def cut(x: Array) -> Array:
        """(m, n_beats, N) of (m, length)."""
        return np.stack([singly.of(np.concatenate([np.zeros(first), each[before:]])) for each in x])

    followed = cut(scaled(np.concatenate([np.tile(mean, limits.BEATS_BEFORE), q]), H))
    mean_followed = followed.mean(axis=1)
    seam = mean_followed - scaled(mean, transfer(beats.T, harmonics).T)
    return BeatVariation(followed - mean_followed[:, None], seam, cut(scaled(larger, H)).mean(axis=1))


_ALIKE = 1e-6  # beyond a correlation of 1 - this, channels are one to the precision of their samples


def _mean_wander(part: Beats, other: Beats, names: Sequence[str]) -> Array:
    """Covariance (m, m) of the mean of one part of a record about that of the other: the drift of the means per beat.

    A slow drift is alike in neighbouring beats, so that averaging over few of them does not reduce it. What moves all
    channels together, such as breathing, does not move their differences (:func:`_correlation_of_means`). A beat with
    gaps counts by its samples relative to the mean beat; one without a sample does not count.
    """
    level = _levels(part, other, names)
    sd = np.nanstd(level, axis=0)
    return sd[:, None] * _correlation_of_means(part, other, names) * sd


def _correlation_of_means(part: Beats, other: Beats, names: Sequence[str]) -> Array:
    """Correlation (m, m) that the means of the beats of two channels have at least, with a probability of 95 %.

        tanh(artanh |r| - 1.645/√(n - 3)),   n = b (1 - c_i c_j)/(1 + c_i c_j)

    of b beats with lag-1 correlations c, by Fisher and Bartlett: two slow drifts look correlated by chance.
    """
    level = _levels(part, other, names)
    level = level[~np.isnan(level).any(axis=1)]
    level = level - level.mean(axis=0)
    size = np.sqrt((level**2).sum(axis=0))
    if len(level) < 4 or not size.all():
        return np.eye(len(names))
    level = level / size
    r, lagged = level.T @ level, np.clip((level[1:] * level[:-1]).sum(axis=0), 0.0, 1.0)
    alike = lagged[:, None] * lagged
    n = len(level) * (1.0 - alike) / (1.0 + alike)
    reach = np.divide(
        limits.FIVE_PERCENT, np.sqrt(np.maximum(n - 3.0, 0.0)), out=np.full_like(r, np.inf), where=n > 3.0
    )
    least = np.tanh(np.maximum(np.arctanh(np.minimum(np.abs(r), 1.0 - _ALIKE)) - reach, 0.0)) * np.sign(r)
    np.fill_diagonal(least, 1.0)
    power, axes = np.linalg.eigh(least)
    whole = (axes * np.maximum(power, _ALIKE)) @ axes.T  # three lower bounds together need not be a correlation
    scale = np.sqrt(np.diag(whole))
    return np.asarray(whole / scale[:, None] / scale)


def _levels(part: Beats, other: Beats, names: Sequence[str]) -> Array:
    """(n, m) deviations of the beats' means from that of all; nan for a beat without a sample."""

    def of(name: str) -> Array:
        beats = np.concatenate([other.values[name], part.values[name]])
        there = ~np.isnan(beats).all(axis=1)
        found = np.full(len(beats), np.nan)
        found[there] = np.nanmean((beats - np.nanmean(beats, axis=0))[there], axis=1)
        return found

    return np.stack([of(name) for name in names], axis=1)


def of_other_beats(
    covariance: Array, beats: Beats, fitted: Beats, names: Sequence[str], error: Array | float = 0.0
) -> Array:
    """The covariance (n, m, m) of other beats of the same record, from the noise of the fitted ones, scaled to their
    number.

    error : (n, m) standard deviation of the errors of solver and model, which more beats do not reduce.
    """
    times, at = fitted.n_beats / beats.n_beats, np.arange(len(names))
    found = covariance * times
    found[:, at, at] -= (times - 1.0) * np.square(error)
    wander = _mean_wander(beats, fitted, names)
    more = np.sqrt(np.maximum(1.0 - np.diag(found[0]).real / np.maximum(np.diag(wander), 1e-300), 0.0))
    found[0] += more[:, None] * wander * more
    return found
