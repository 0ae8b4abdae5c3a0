"""Spikes: single samples far off everything around them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .. import limits
from .equal_beats import Grid
from .variable_beats import Array, VariableBeats

_ROBUST = 1.4826  # standard deviation over median absolute deviation, of a Gaussian
_LEAST = 1e-6  # of the range: rounding is no scatter


def without_spikes(
    channels: Mapping[str, Array], cut: VariableBeats | Grid, steps: Mapping[str, float]
) -> tuple[dict[str, Array], dict[str, int]]:
    """Channels with gaps in place of their spikes, and the number of these where there are any.

    A spike raises the scatter as much as the mean, so the intervals grow and χ² stays at 1, while the fit is wrong. A
    sample becomes a gap if it is off both the other beats at its phase and its own neighbours: a beat that differs as a
    whole, an ectopic one, is not touched.

    steps : of the channels' converters, whose rounding is no spike.
    """
    found = {name: _spikes(x, cut, steps.get(name, 0.0)) for name, x in channels.items()}
    cleaned = dict(channels)
    for name, at in found.items():
        if len(at):
            cleaned[name] = channels[name].copy()
            cleaned[name][at] = np.nan
    return cleaned, {name: len(at) for name, at in found.items() if len(at)}


def _spikes(values: Array, cut: VariableBeats | Grid, step: float) -> Array:
    """The samples that are spikes.

    The valve of one beat closes a sample later, and the next upstroke begins a sample earlier: what the usual beat
    reaches in a sample, or in those by which beats may be off one another, is no spike.
    """
    samples = cut.samples  # (n_beats, N)
    none, beats = np.array([], int), np.where(cut.within, values[samples], np.nan)
    gaps = np.isnan(beats)
    if len(beats) < limits.FEWEST_BEATS or gaps.all(axis=0).any() or gaps.all(axis=1).any():
        return none  # rejected later, or nothing to compare with
    median = np.nanmedian if gaps.any() else np.median
    usual = median(beats, axis=0)
    off = beats - usual
    off -= median(off, axis=1)[:, None]
    size = _ROBUST * median(np.abs(off), axis=0)
    least = np.maximum(np.median(size), _LEAST * np.ptp(values[~np.isnan(values)]))
    far = limits.FAR * np.maximum(size, least)
    slip = max(1, round(cut.slip))
    near = np.stack([np.roll(usual, shift) for shift in range(-slip, slip + 1)]) - usual
    off = np.nan_to_num(off)
    outside = np.abs(off - np.clip(off, near.min(axis=0), near.max(axis=0)))
    suspect = (np.abs(off) > far) & (outside > limits.STEPS * step)
    if not suspect.any():
        return none
    flat = off.ravel()
    around = np.lib.stride_tricks.sliding_window_view(np.pad(flat, 2, "edge"), 5)
    alone = np.abs(flat - np.median(around, axis=-1)).reshape(off.shape)
    # most of it by itself: the samples of a smooth artefact have neighbours like them
    return np.unique(samples[suspect & (alone > far) & (alone > 0.5 * np.abs(off))])
