"""Sensors whose range cut the waves before noise was added: only many beats together show it.

Values that are clipped after the noise are all the same, and are found sample by sample
(:mod:`fitting.records.read.sensors`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from solver.quantities.units import of_signal

from .. import limits

Array = np.ndarray


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
