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


def limited_sensors(channels: Mapping[str, Array], T: float) -> Iterator[str]:
    """A sentence for each channel whose top is cut off, and for each flow without its negative values.

    channels : (n_beats, N) of values in phase. T : the period [s].
    """
    for name, beats in channels.items():
        unit, shown = of_signal(name)
        if part := _flat_top(beats):
            yield (
                f"{name} stays within its noise at the highest value of its mean beat, "
                f"{shown * float(np.nanmean(beats, axis=0).max()):.4g} {unit}, for {1e3 * part * T:.3g} ms: its "
                "amplifier or converter may have cut off the top; pulse, resistance and compliance would be wrong. "
                "Record it with a wider range."
            )
        if name.endswith(".Q") and _never_negative(beats):
            yield (
                f"{name} rests within its noise of zero and is never negative: its meter or its export may have cut "
                "off or turned over negative values; backflow is missing then, and the mean flow too large."
            )


def _flat_top(beats: Array) -> float:
    """The part of the beat that the top of the mean beat is flat for, 0.0 if that is no longer than waves have.

    Within δ of its maximum, as a fraction of its pulse, a sinusoid is for 2 √δ/π of its period.
    """
    n = beats.shape[1]
    wide = max(1, round(limits.SMOOTHED * n))
    there = _moving_mean(np.nanmean(beats, axis=0), wide)
    pulse, top = float(np.ptp(there)), int(np.argmax(there))
    error = float(np.nanstd(beats[:, top])) / math.sqrt(len(beats) * wide)
    near = np.roll(there > there[top] - limits.TOP * pulse - limits.EXTREME * error, -top)
    if pulse == 0.0 or near.all():
        return 0.0
    length = int(np.argmin(near)) + int(np.argmin(near[::-1]))
    longest = limits.FLAT_TOP * 2.0 / math.pi * math.sqrt(limits.TOP + limits.EXTREME * error / pulse)
    return length / n if length >= limits.PLATEAU and length > longest * n else 0.0


def _moving_mean(x: Array, n: int) -> Array:
    """The mean of n neighbours in a beat x : (N,)."""
    return np.convolve(np.concatenate([x, x[: n - 1]]), np.full(n, 1.0 / n), mode="valid")


def _never_negative(beats: Array) -> bool:
    """Whether a flow (n_beats, N) is never below zero though its noise about its rest would take it there.

    Rest is the lowest quarter of the mean beat; of each beat it counts as two independent values.
    """
    if not float(np.nanmin(beats)) >= 0.0:
        return False
    there = np.nanmean(beats, axis=0)
    rest = beats[:, there <= np.quantile(there, 0.25)]
    mean, deviation = float(np.nanmean(rest)), float(np.nanstd(rest))
    expected = len(beats) * math.erfc(mean / (math.sqrt(2.0) * max(deviation, np.finfo(float).tiny)))
    return deviation > 0.0 and expected > limits.NEGATIVE
