"""Linear response of the channels to a drive whose beats differ: from beat to beat, and in the mean beat.

The linear response h to the drive q of a whole record, cut into beats as the record was (C_b), is compared with the
periodic response to the mean beat q̄:

    change_b = C_b(h ∗ q) - mean_b C_b(h ∗ q),      seam = mean_b C_b(h ∗ q) - h ∗ q̄.

A simulation of the mean beat cannot contain the seam: the ends of the mean beat do not meet, and each beat depends on
the previous one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .. import limits
from ..alignment.beats import Array, Beats
from .spectral import coefficients

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
    H = transfer(length * singly.dt, int(harmonics * length / N))
    larger = np.zeros(length)
    if memory:
        unknown = np.tile(mean, limits.BEATS_UNKNOWN)
        sizes = np.nanstd(beats.values[drive], axis=1)  # of the beats
        larger[before - len(unknown) : before] = unknown * float(np.nanstd(sizes) / np.nanmean(sizes))

    def cut(x: Array) -> Array:
        """(m, n_beats, N) of (m, length)."""
        return np.stack([singly.of(np.concatenate([np.zeros(first), each[before:]])) for each in x])

    followed = cut(_filtered(H, np.concatenate([np.tile(mean, limits.BEATS_BEFORE), q])))
    mean_followed = followed.mean(axis=1)
    seam = mean_followed - _filtered(transfer(beats.T, harmonics), mean)
    return BeatVariation(followed - mean_followed[:, None], seam, cut(_filtered(H, larger)).mean(axis=1))


def _filtered(H: Array, x: Array) -> Array:
    """(m, n) of x : (n,) through H : (K + 1, m), nothing beyond K."""
    X = np.fft.rfft(x)
    n = min(len(H), len(X))
    return np.fft.irfft(H[:n].T * X[:n], len(x))
