"""Beats of variable length: each cut where its upstroke begins, at the end of diastole, none of them stretched.

A heart that beats faster shortens diastole; systole keeps its length. So beats are laid upon one another from their
start: the length is the mean interval, a longer beat loses its end, and a shorter one goes on from where it ends by the
mean slope of diastole. All channels are cut alike, and what is done to them is linear: a response to the drive, cut in
the same way, can be compared with them (:mod:`fitting.records.channels.variability`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .. import limits
from ..read.sensors import without_gaps
from .upstrokes import Array, Upstrokes, lead


@dataclass(frozen=True)
class VariableBeats:
    """The record that variable beats are cut from, and how.

    channels : (n,) each, SI; dt [s]. edges : (m + 1,) samples, where the m beats of a stretch begin and the last one
    ends. steady : numbers of the beats that are alike. serving : of those that are used. said : what was left out.
    """

    channels: Mapping[str, Array]
    dt: float
    edges: Array
    steady: Array
    serving: Array
    said: tuple[str, ...] = ()
    slip = limits.SLIP_OF_CUTS  # samples by which beats may be off one another

    @property
    def N(self) -> int:
        """Samples of a beat: the mean length of those that are alike."""
        return round(float(np.diff(self.edges)[self.steady].mean()))

    @property
    def T(self) -> float:
        """The period [s]: N samples."""
        return self.N * self.dt

    @property
    def samples(self) -> Array:
        """Numbers of the samples of the beats that serve : (m, N); of a short one, into the next."""
        return np.asarray(self.edges[self.serving][:, None] + np.arange(self.N))

    @property
    def within(self) -> Array:
        """Which of them are of the beat itself : (m, N)."""
        return np.asarray(np.arange(self.N) < np.diff(self.edges)[self.serving][:, None])

    def of(self, x: Array) -> Array:
        """The beats (m, N) of samples x : (n,), NaN in gaps; linear in x."""
        starts, ends, at = self.edges[:-1, None], self.edges[1:, None], np.arange(self.N)
        half = max(1, round(limits.BEFORE * self.N / 4))
        last = x[ends - 2 * half + np.arange(2 * half)]
        early, late = mean(last[:, :half]), mean(last[:, half:])
        slope = mean((late - early)[self.steady]) / half
        beyond = at - (ends - starts)
        on = late[:, None] + slope * (beyond + 0.5 * (half + 1))
        return np.asarray(np.where(beyond >= 0, on, x[np.minimum(starts + at, len(x) - 1)])[self.serving])

    def select(self, index: Array) -> VariableBeats:
        """With some of the beats that serve."""
        return replace(self, serving=self.serving[index])


def mean(x: Array) -> Array:
    """Along the last axis, of what is not NaN; NaN of nothing."""
    there = ~np.isnan(x)
    total, count = np.where(there, x, 0.0).sum(axis=-1), there.sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def unlikeness(beats: Array) -> Array:
    """By how much each of the beats (m, N) differs in shape from the median beat, root mean square : (m,)."""
    off = beats - np.nanmedian(beats, axis=0)
    return np.sqrt(mean((off - mean(off)[:, None]) ** 2))


def cut_variable(channels: Mapping[str, Array], dt: float, found: Upstrokes) -> VariableBeats | None:
    """The beats that begin with these upstrokes, if their intervals or pulses differ; else None."""
    x, usual = channels[found.channel], found.usual
    alike = _likeness(x, found.at[:-1][found.near], usual)
    if alike < limits.GOES_ON:
        return None
    beats = [x[round(a) : round(b)] for a, b in zip(found.at, found.at[1:], strict=False)]
    whole = [beat for beat in beats if not np.isnan(beat).any()]
    pulses = np.array([np.ptp(np.quantile(beat, limits.RANGE)) for beat in whole] or [1.0])
    noise = np.sqrt(max(1.0 / alike**2 - 1.0, 0.0))  # over the pulse, if all beats are alike
    _, wander = found.line
    if wander <= limits.VARIES * usual and pulses.std() <= max(limits.VARIES, limits.NO_PULSE * noise) * pulses.mean():
        return None
    edges = np.rint(found.at).astype(int) - lead(channels, found.at, usual)
    return _cut_singly(channels, dt, edges[edges >= 0], usual)


def _cut_singly(channels: Mapping[str, Array], dt: float, edges: Array, usual: float) -> VariableBeats | None:
    """The longest stretch of steady beats that no more than MISSING odd ones in a row interrupt; None if not two."""
    near = np.flatnonzero(np.abs(np.diff(edges) - usual) <= limits.NEAR * usual + 1.0)
    if len(near) < 2:
        return None
    odd = _odd(channels, VariableBeats({}, dt, edges, near, near))
    alike = np.setdiff1d(near, odd)
    alike = max(np.split(alike, np.flatnonzero(np.diff(alike) > limits.MISSING + 1) + 1), key=len)
    if len(alike) < 2:
        return None
    first, last = int(alike[0]), int(alike[-1]) + 1
    notes = _exclusion_notes(edges, near, odd, alike, dt)
    return VariableBeats(channels, dt, edges[first : last + 1], alike - first, alike - first, notes)


def _likeness(x: Array, at: Array, length: float) -> float:
    """The median correlation of whole beats with their mean."""
    beats = without_gaps(x)[np.rint(at).astype(int)[:, None] + np.arange(int(0.9 * length))]
    beats = beats - beats.mean(axis=1, keepdims=True)
    mean = beats.mean(axis=0)
    size = np.linalg.norm(beats, axis=1) * np.linalg.norm(mean)
    return float(np.median(beats @ mean / np.maximum(size, np.finfo(float).tiny)))


def _odd(channels: Mapping[str, Array], singly: VariableBeats) -> Array:
    """The beats that are unlike the others in a channel: ectopic ones, a flushed line, a lost contact."""
    far = np.zeros(len(singly.serving), bool)
    for x in channels.values():
        rows = singly.of(x)
        size, pulse = unlikeness(rows), float(np.nanstd(np.nanmedian(rows, axis=0)))
        far |= size > max(limits.UNLIKE * pulse, limits.USUAL * float(np.nanmedian(size)))
    return singly.serving[far]


def _exclusion_notes(edges: Array, near: Array, odd: Array, alike: Array, dt: float) -> tuple[str, ...]:
    """What was left out, in sentences."""
    times, lengths = edges * dt, np.diff(edges)
    first, last = int(alike[0]), int(alike[-1]) + 1
    used, notes = lengths[alike], []
    if np.abs(used - used.mean()).max() > limits.UNSTEADY * used.mean():
        notes.append(
            f"the heart rate was not steady: beats lasted {used.min() * dt:.3g} to {used.max() * dt:.3g} s; each "
            "was cut at the end of diastole."
        )
    irregular = np.setdiff1d(np.arange(first, last), near)
    for which, why in (
        (irregular, f"more than {100.0 * limits.NEAR:g} % longer or shorter than the others"),
        (odd[(odd >= first) & (odd < last)], "unlike the others in shape"),
    ):
        if len(which):
            begin = ", ".join(f"{times[i]:.4g}" for i in which[: limits.NAMED])
            begin += ", …" if len(which) > limits.NAMED else ""
            notes.append(f"{_count(len(which))} left out, {why}; at {begin} s after the record's start.")
    if outside := len(lengths) - (last - first):
        notes.append(
            f"used from {times[first]:.4g} to {times[last]:.4g} s after the record's start, the longest stretch with a "
            f"steady heart rate; {_count(outside)} before and after it left out."
        )
    return tuple(notes)


def _count(n: int) -> str:
    return f"{n} beat{'s' if n > 1 else ''}"
