"""Beats of unequal length: each cut where its upstroke begins, at the end of diastole, none of them stretched.

A heart that beats faster shortens diastole; systole keeps its length. So beats are laid upon one another from their
start: the length is the mean interval, a longer beat loses its end, and a shorter one goes on from where it ends by the
mean slope of diastole. All channels are cut alike, and what is done to them is linear: a response to the drive, cut in
the same way, can be compared with them (:mod:`fitting.records.felt`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .upstrokes import find_upstrokes, lead, without_gaps

Array = np.ndarray

_UNEQUAL = 0.02  # of the period: upstrokes that stray further from a steady rhythm tell that beats must be cut singly
_PULSES = 0.02  # standard deviation of the pulses over their mean, from which the same is true
_NOISE = 0.5  # of the noise over the pulse: more is no noise of a beat's range
_ALIKE = 0.9  # median correlation of upstrokes, and of beats, from which they are those of one heart
_MOSTLY = 0.4  # of the intervals that must be near the usual one, or the upstrokes are no beats
_NEAR = 0.1  # of the usual interval, by which a beat may be longer or shorter
_UNLIKE = 0.35  # of the pulse, by which a beat may differ
_USUAL = 6.0  # times as much as beats usually do
_ORDINARY = (0.05, 0.95)  # quantiles: spikes are beyond them
_MISSING = 3  # odd beats in a row that do not end a stretch
_ONE = 1.5  # intervals: a period that is shorter is that of single beats
_SAME = 0.1  # of a beat, by which a strict period may differ from the usual interval
_END = 0.06  # of a beat: its end, from which it goes on
_FEWEST = 4  # upstrokes
_NAMED = 3
_UNSTEADY = 0.05  # of the mean length: more is worth a sentence


@dataclass(frozen=True)
class Cut:
    """How the beats of a stretch are cut.

    starts, lengths : (n,) [samples] of all beats of the stretch, one after the other. steady : of those that are alike.
    serving : of those that are used. N : samples of each.
    """

    starts: Array
    lengths: Array
    steady: Array
    serving: Array
    N: int

    @property
    def span(self) -> tuple[int, int]:
        """First sample of the stretch, and the one after its last."""
        return int(self.starts[0]), int(self.starts[-1] + self.lengths[-1])

    @property
    def interval(self) -> float:
        """The mean length of the beats that are alike [samples]."""
        return float(self.lengths[self.steady].mean())

    def of(self, x: Array) -> Array:
        """The beats (m, N) of samples x : (n,), NaN in gaps; linear in x."""
        index = np.minimum(self.starts[:, None] + np.arange(self.N), len(x) - 1)
        width = 2 * max(1, round(_END * self.N / 2))
        ends = x[(self.starts + self.lengths)[:, None] - width + np.arange(width)]
        early, late = _mean(ends[:, : width // 2]), _mean(ends[:, width // 2 :])
        slope = _mean((late - early)[self.steady]) / (width // 2)
        beyond = np.arange(self.N) - self.lengths[:, None]
        on = late[:, None] + slope * (beyond + 0.5 * (width // 2 + 1))
        return np.asarray(np.where(beyond >= 0, on, x[index])[self.serving])

    def select(self, index: Array) -> Cut:
        """With some of the beats that serve."""
        return replace(self, serving=self.serving[index])


def _mean(x: Array) -> Array:
    """Along the last axis, of what is not NaN."""
    there = ~np.isnan(x)
    total, count = np.where(there, x, 0.0).sum(axis=-1), there.sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True)
class Whole:
    """The record that unequal beats are cut from: channels : (n,) each, SI, without gaps; dt [s].

    said : what was left out, in sentences.
    """

    cut: Cut
    channels: Mapping[str, Array]
    dt: float
    said: tuple[str, ...] = ()

    def select(self, index: Sequence[int] | Array) -> Whole:
        """With some of the beats."""
        return replace(self, cut=self.cut.select(np.asarray(index)))


def unequal(channels: Mapping[str, Array], dt: float, T: float) -> Whole | None:
    """The beats, T [s] long or near it, if their intervals or pulses differ; else None."""
    found = find_upstrokes(channels, T / dt)
    if found is None or len(found.at) < _FEWEST or np.median(found.likeness) < _ALIKE:
        return None
    intervals = np.diff(found.at)
    usual = _usual(intervals)
    passed = np.maximum(np.rint(intervals / usual), 1.0)  # more than 1 where an upstroke was not seen
    intervals = intervals / passed
    beats = T / dt / usual
    if not 1.0 / _ONE < beats < _ONE:  # whatever its length: upstrokes tell that better where the rate drifts
        return None
    x = without_gaps(channels[found.channel])
    near = np.abs(intervals - usual) <= _NEAR * usual
    if near.mean() < _MOSTLY or (alike := _likeness(x, found.at[:-1][near], usual)) < _ALIKE:
        return None
    pulses = _pulses(channels[found.channel], found.at)
    noise = np.sqrt(max(1.0 / alike**2 - 1.0, 0.0))  # over the pulse, if all beats are alike
    varied = pulses.std() > max(_PULSES, _NOISE * noise) * pulses.mean()
    same = abs(beats - 1.0) <= _SAME
    if same and not (varied or _wander(found.at, passed) > _UNEQUAL * usual):
        return None
    starts = np.rint(found.at).astype(int) - lead(channels, found.at, usual)
    starts = starts[starts >= 0]
    return _whole(channels, dt, starts[:-1], np.diff(starts), usual)


def _whole(channels: Mapping[str, Array], dt: float, starts: Array, lengths: Array, usual: float) -> Whole | None:
    """The longest stretch of steady beats; None if there are not two."""
    near = np.flatnonzero(np.abs(lengths - usual) <= _NEAR * usual + 1.0)
    if len(near) < 2:
        return None
    odd = _odd(channels, Cut(starts, lengths, near, near, round(float(lengths[near].mean()))))
    alike = _stretch(np.setdiff1d(near, odd))
    if len(alike) < 2:
        return None
    first, last = int(alike[0]), int(alike[-1]) + 1
    said = _said(starts, lengths, near, odd, alike, dt)
    N = round(float(lengths[alike].mean()))
    cut = Cut(starts[first:last], lengths[first:last], alike - first, alike - first, N)
    return Whole(cut, {name: without_gaps(x) for name, x in channels.items()}, dt, said)


def _wander(at: Array, passed: Array) -> float:
    """Standard deviation [samples] of upstrokes about the steady rhythm that fits them best."""
    count = np.concatenate([[0.0], np.cumsum(passed)])
    return float(np.std(at - np.polyval(np.polyfit(count, at, 1), count)))


def _likeness(x: Array, at: Array, length: float) -> float:
    """The median correlation of whole beats with their mean."""
    n = int(0.9 * length)
    beats = np.stack([x[i : i + n] for i in np.rint(at).astype(int)])
    beats = beats - beats.mean(axis=1, keepdims=True)
    mean = beats.mean(axis=0)
    size = np.linalg.norm(beats, axis=1) * np.linalg.norm(mean)
    return float(np.median(beats @ mean / np.maximum(size, np.finfo(float).tiny)))


def _pulses(x: Array, at: Array) -> Array:
    """The range of each beat that was measured, but for spikes."""
    beats = [x[round(a) : round(b)] for a, b in zip(at, at[1:], strict=False)]
    return np.array([np.ptp(np.quantile(beat, _ORDINARY)) for beat in beats if not np.isnan(beat).any()] or [1.0])


def _usual(intervals: Array) -> float:
    """The interval that most others are near to."""
    near = np.abs(intervals[:, None] / intervals[None, :] - 1.0) <= _NEAR
    best = int(near.sum(axis=0).argmax())
    return float(np.median(intervals[near[:, best]]))


def _odd(channels: Mapping[str, Array], cut: Cut) -> Array:
    """The beats that are unlike the others in a channel: ectopic ones, a flushed line, a lost contact."""
    odd: set[int] = set()
    for x in channels.values():
        rows = cut.of(x)
        off = rows - np.nanmedian(rows, axis=0)
        off -= _mean(off)[:, None]
        size = np.sqrt(_mean(off**2))
        pulse = float(np.nanstd(np.nanmedian(rows, axis=0)))
        far = size > max(_UNLIKE * pulse, _USUAL * float(np.nanmedian(size)))
        odd |= set(cut.serving[far].tolist())
    return np.array(sorted(odd), int)


def _stretch(serving: Array) -> Array:
    """The longest stretch that no more than _MISSING odd beats in a row interrupt."""
    if not len(serving):
        return serving
    parts = np.split(serving, np.flatnonzero(np.diff(serving) > _MISSING + 1) + 1)
    return max(parts, key=len)


def _said(starts: Array, lengths: Array, near: Array, odd: Array, alike: Array, dt: float) -> tuple[str, ...]:
    """What was left out, in sentences."""
    stretch = np.arange(alike[0], alike[-1] + 1)
    said = []
    shortest, longest, mean = lengths[alike].min(), lengths[alike].max(), lengths[alike].mean()
    if max(longest - mean, mean - shortest) > _UNSTEADY * mean:
        said.append(
            f"the heart rate was not steady: beats lasted {shortest * dt:.3g} to {longest * dt:.3g} s; each was cut at "
            "the end of diastole."
        )
    for which, why in (
        (np.setdiff1d(stretch, near), f"more than {_NEAR:.0%} longer or shorter than the others"),
        (np.intersect1d(odd, stretch), "unlike the others in shape"),
    ):
        if len(which):
            times = ", ".join(f"{starts[i] * dt:.4g}" for i in which[:_NAMED]) + (" …" if len(which) > _NAMED else "")
            said.append(f"beats left out ({len(which)}, {times} s after the record's start): {why}.")
    outside = len(starts) - len(stretch)
    if outside:
        first, last = starts[stretch[0]] * dt, (starts[stretch[-1]] + lengths[stretch[-1]]) * dt
        said.append(
            f"used from {first:.4g} to {last:.4g} s after the record's start, the longest stretch with a steady heart "
            f"rate; beats before and after it left out ({outside})."
        )
    return tuple(said)
