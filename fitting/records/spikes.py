"""Spikes: single samples far off everything around them, which no scatter between beats can tell from noise.

A spike raises the scatter as much as the mean, so the intervals grow and χ² stays at 1, while the fit is wrong. A
sample becomes a gap if it is off both the other beats at its phase and its own neighbours: a beat that differs as a
whole, an ectopic one, is not touched.
"""

from __future__ import annotations

import numpy as np

from . import thresholds as limit

Array = np.ndarray

_ROBUST = 1.4826  # standard deviation over median absolute deviation, of a Gaussian
_LEAST = 1e-6  # of the range: rounding is no scatter


def without_spikes(values: Array, samples: Array, step: float = 0.0, slip: float = 0.0) -> tuple[Array, int]:
    """A channel with gaps in place of its spikes, and their number.

    samples : (n_beats, N) the sample at each phase of each beat. step : of the channel's converter, whose rounding is
    no spike. slip : samples by which beats may be off one another.
    """
    n_beats, N = samples.shape
    if n_beats < limit.FEWEST_BEATS:
        return values, 0
    nearest = samples.ravel()
    beats = values[nearest].reshape(n_beats, N)
    gaps = np.isnan(beats)
    if gaps.all(axis=0).any() or gaps.all(axis=1).any():
        return values, 0  # refused later, or nothing to compare with
    median = np.nanmedian if gaps.any() else np.median
    usual = median(beats, axis=0)
    off = beats - usual
    off -= median(off, axis=1)[:, None]
    size = _ROBUST * median(np.abs(off), axis=0)
    least = np.maximum(np.median(size), _LEAST * np.ptp(values[~np.isnan(values)]))
    far = np.maximum(limit.FAR * np.maximum(size, least), limit.STEPS * step + slip * np.abs(np.gradient(usual)))
    suspect = np.abs(np.nan_to_num(off)) > far
    if not suspect.any():
        return values, 0
    flat = np.nan_to_num(off.ravel())
    around = np.lib.stride_tricks.sliding_window_view(np.pad(flat, 2, "edge"), 5)
    alone = np.abs(flat - np.median(around, axis=-1)).reshape(off.shape)
    # most of it by itself: the samples of a smooth artefact have neighbours like them
    spikes = np.unique(nearest[(suspect & (alone > far) & (alone > 0.5 * np.abs(np.nan_to_num(off)))).ravel()])
    if not len(spikes):
        return values, 0
    cleaned = values.copy()
    cleaned[spikes] = np.nan
    return cleaned, len(spikes)
