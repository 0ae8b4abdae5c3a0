"""Several files of one recording on one time axis: aligned by their stamps, over the time that all have.

The axis is that of the slowest file, the first of equals. Samples of a faster one are low-passed before they are taken
there, lest noise beyond half the slow rate folds into the pulse. The other way round, harmonics that no sensor measured
would count as measured, and free of noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver.errors import InputError

from . import thresholds as limit
from .time_axis import between

Array = np.ndarray

# A Hamming window of 16 slow intervals has a transition of 3.3/16 = 0.2 of the slow rate f: from 0.3 f, as it was,
# to 0.5 f, gone
_HALF, _CUTOFF = 8, 0.8


@dataclass(frozen=True)
class Part:
    """One file: time : (n,) [s], uniform; channels : (n,) each."""

    source: str
    time: Array
    channels: Mapping[str, Array]

    @property
    def dt(self) -> float:
        """[s]"""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)


def together(parts: Sequence[Part]) -> tuple[Array, dict[str, Array], str]:
    """Time (n,) [s], the channels of all parts (n,), and what was done, for people.

    Raises ValueError, one sentence, where the times have nothing in common or two files have one channel.
    """
    base = max(parts, key=lambda p: round(p.dt / parts[0].dt, 4))
    low, high = max(p.time[0] for p in parts), min(p.time[-1] for p in parts)
    at = base.time[(base.time >= low - limit.ONE_SAMPLE * base.dt) & (base.time <= high + limit.ONE_SAMPLE * base.dt)]
    if len(at) < 2:
        spans = ", ".join(f"{p.source} from {p.time[0]:.6g} to {p.time[-1]:.6g} s" for p in parts)
        raise InputError(f"{spans}: their times do not overlap; give files of one recording, stamped by one clock.")
    channels: dict[str, Array] = {}
    for part in parts:
        for name, values in part.channels.items():
            if name in channels:
                mine = f"{Path(part.source).name}:TITLE"
                raise InputError(
                    f'{part.source}: {name} is in another file, too; leave one out, --map "{mine}=", or say what it '
                    f'is, --map "{mine}=AA.P [mmHg]".'
                )
            channels[name] = _at(part, values, base, at)
    rates = ", ".join(f"{p.source} at {1.0 / p.dt:.6g} Hz from {p.time[0] - parts[0].time[0]:+.6g} s" for p in parts)
    said = f"{rates}: aligned by their times over {at[-1] - at[0]:.6g} s that all have, at {1.0 / base.dt:.6g} Hz"
    return at, channels, f"{said}, the rate of {base.source}{'' if base is parts[0] else ', the slowest'}."


def _at(part: Part, values: Array, base: Part, at: Array) -> Array:
    """A channel at the times ``at`` : (n,) of another file."""
    place = (at - part.time[0]) / part.dt
    near = np.clip(np.rint(place).astype(int), 0, len(values) - 1)
    gaps, ratio = np.isnan(values), base.dt / part.dt
    if ratio > 1.0 + limit.ONE_SAMPLE:
        values = _low_passed(np.interp(part.time, part.time[~gaps], values[~gaps]), ratio)
    if np.abs(place - near).max() > limit.ONE_SAMPLE:
        there = ~np.isnan(values)
        return np.where(gaps[near], np.nan, between(part.time[there], values[there], at))
    return np.where(gaps[near], np.nan, values[near])


def _low_passed(values: Array, ratio: float) -> Array:
    """Without what a rate ``ratio`` times slower cannot show, and without delay."""
    from scipy.signal import firwin, oaconvolve  # takes half a second

    half = min(int(np.ceil(_HALF * ratio)), len(values) - 1)
    padded = np.pad(values, half, mode="reflect", reflect_type="odd")
    return np.asarray(oaconvolve(padded, firwin(2 * half + 1, _CUTOFF / ratio), mode="valid"))
