"""Faults of sensors that only many beats together show: spikes, which are single samples far off everything around
them, and ranges that cut the waves before noise was added.

Values that are clipped after the noise are all the same, and are found sample by sample
(:mod:`fitting.records.read.sensors`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from solver.quantities.units import of_signal

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


def limited_sensors(
    channels: Mapping[str, Array], beats: Mapping[str, Array], steps: Mapping[str, float], T: float
) -> Iterator[str]:
    """A sentence for each channel whose top is cut off, and for each flow without its negative values.

    channels : (n,) as recorded; beats : (n_beats, N) of values in phase; steps : of the converters. T : the period [s].
    """
    for name, values in beats.items():
        unit, shown = of_signal(name)
        if top := _flat_top(values, steps.get(name, 0.0)):
            level, fraction = top
            yield (
                f"{name} stays within its noise at the top of its mean beat, {shown * level:.4g} {unit}, for "
                f"{1e3 * fraction * T:.3g} ms: its amplifier or converter may have cut off what is higher; the pulse "
                f"of {name} is too small then. Record it with a wider range."
            )
        if name.endswith(".Q") and np.nanmin(channels[name]) >= 0.0 and _would_be_negative(values):
            yield (
                f"{name} rests within its noise of zero and is never negative: its meter or its export may have cut "
                "off negative values or reversed their sign; backflow is missing then, and the mean flow too large."
            )


def _flat_top(beats: Array, step: float) -> tuple[float, float] | None:
    """The level of the top of the mean beat and the fraction of the beat in which it is flat; None if a wave may be.

    Within δ of its maximum, as a fraction of its pulse, a sinusoid is for 2 √δ/π of its period.
    """
    n = beats.shape[1]
    window = max(1, round(limits.SMOOTHED * n))
    mean_beat = np.nanmean(beats, axis=0)
    mean_beat = np.convolve(
        np.concatenate([mean_beat, mean_beat[: window - 1]]), np.full(window, 1.0 / window), "valid"
    )
    pulse, top = float(np.ptp(mean_beat)), int(np.argmax(mean_beat))
    if pulse == 0.0:
        return None
    error = float(np.nanstd(beats[:, top])) / math.sqrt(len(beats) * window)
    tolerance = limits.TOP * pulse + limits.EXTREME * error + step
    at_top = np.roll(mean_beat > mean_beat[top] - tolerance, -top)
    length = int(np.argmin(at_top)) + int(np.argmin(at_top[::-1]))
    longest = limits.FLAT_TOP * 2.0 / math.pi * math.sqrt(tolerance / pulse)
    return (float(mean_beat[top]), length / n) if length >= limits.PLATEAU and length > longest * n else None


def _would_be_negative(beats: Array) -> bool:
    """Whether noise would take the rest of a flow (n_beats, N) below zero: the lowest quarter of its mean beat.

    The noise is the deviation over the beats, phase by phase. Neighbouring samples may share it: a beat counts as two.
    """
    mean, deviation = np.nanmean(beats, axis=0), np.nanstd(beats, axis=0)
    rest = (mean <= np.quantile(mean, 0.25)) & (deviation > 0.0)
    below = [0.5 * math.erfc(m / (math.sqrt(2.0) * d)) for m, d in zip(mean[rest], deviation[rest], strict=True)]
    return bool(below) and 2.0 * len(beats) * float(np.mean(below)) > limits.NEGATIVE
