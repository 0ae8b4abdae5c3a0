"""Beats of variable length: each cut where its upstroke begins, at the end of diastole, none of them stretched.
Upstrokes are found without the assumption that they come at equal intervals.

A heart that beats faster shortens diastole; systole keeps its length. So beats are laid upon one another from their
start: the length is the mean interval, a longer beat loses its end, and a shorter one goes on from where it ends by the
mean slope of diastole. All channels are cut alike, and what is done to them is linear: a response to the drive, cut in
the same way, can be compared with them (:mod:`fitting.records.channels.variability`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .. import limits
from ..read.sensors import without_gaps
from ..read.table import Array

_PASSES = 6  # at most, that find the length of a beat


@dataclass(frozen=True)
class Upstrokes:
    """at : (n,) samples, fractions included, in order; likeness : (n,) correlation of each with their mean."""

    channel: str
    at: Array
    likeness: Array

    @cached_property
    def usual(self) -> float:
        """The interval [samples] that most others are near to."""
        intervals = np.diff(self.at)
        near = np.abs(intervals[:, None] - intervals) <= limits.NEAR * intervals
        return float(np.median(intervals[near[:, near.sum(axis=0).argmax()]]))

    @cached_property
    def passed(self) -> Array:
        """(n - 1,) beats from each to the next: more than 1 where an upstroke was not seen."""
        return np.maximum(np.rint(np.diff(self.at) / self.usual), 1.0)

    @property
    def near(self) -> Array:
        """(n - 1,) whether an interval is near the usual one."""
        return np.abs(np.diff(self.at) / self.passed - self.usual) <= limits.NEAR * self.usual

    @cached_property
    def line(self) -> tuple[float, float]:
        """Period and wander [samples]: slope of the line t_b = t_0 + b T, and the standard deviation about it."""
        count = np.concatenate([[0.0], np.cumsum(self.passed)])
        fitted = np.polyfit(count, self.at, 1)
        return float(fitted[0]), float(np.std(self.at - np.polyval(fitted, count)))


def find_upstrokes(channels: Mapping[str, Array], length: float) -> Upstrokes | None:
    """The upstrokes, one a beat, of the channel whose upstrokes are most alike; length : samples a beat.

    None if no channel has three.
    """
    x = {name: without_gaps(values) for name, values in channels.items()}
    ordinary = np.array([np.clip(each, *usual_range(each)) for each in x.values()])  # spikes must not hide the beat
    tried: dict[float, Array] = {}
    while length not in tried and len(tried) < _PASSES:  # until the length is the record's own, whatever was given
        tried[length] = marks = _beats(ordinary, length)
        if len(marks) < limits.UPSTROKES:
            return None
        length = float(np.median(np.diff(marks)))
    lengths = list(tried)
    length = max(lengths[lengths.index(length) :]) if length in tried else lengths[-1]  # it may be one of two in turn
    found = [_of(name, each, np.isnan(channels[name]), tried[length], length) for name, each in x.items()]
    return max(
        (each for each in found if len(each.at) >= limits.UPSTROKES),
        key=lambda each: (round(float(np.median(each.likeness)), 2), len(each.at)),
        default=None,
    )


def _of(name: str, x: Array, gaps: Array, marks: Array, length: float) -> Upstrokes:
    """A channel's upstrokes, one at each of the marks."""
    before, after, most, end = (
        max(2, round(part * length)) for part in (limits.BEFORE, limits.AFTER, limits.SEARCHED, limits.ANOTHER)
    )
    inside = marks[(marks >= before) & (marks < len(x) - end)]
    if len(inside) < limits.UPSTROKES:
        return Upstrokes(name, inside, inside)
    mean = x[inside[:, None] + np.arange(-before, end)].mean(axis=0)
    at = marks + int(_rise(mean, length).argmax()) - before
    at = at[(at >= before + most) & (at < len(x) - after - most)].astype(float)
    likeness, alike = np.zeros(len(at)), _alike(x, before + after)
    for _ in range(2 if len(at) else 0):
        near = np.rint(at).astype(int)
        r = alike(x[near[:, None] + np.arange(-before, after)].mean(axis=0))[
            near[:, None] - before + np.arange(-most, most + 1)
        ]
        best = r.argmax(axis=1)
        likeness = r.max(axis=1)
        at = np.clip(near - most + vertex(r, best), before + most, len(x) - after - most - 1)
    lost = np.concatenate([[0], np.cumsum(gaps)])
    around = np.rint(at).astype(int)
    sure = (likeness >= limits.HALF * np.median(likeness)) & (lost[around + after] == lost[around - before])
    return Upstrokes(name, at[sure], likeness[sure])


def _beats(x: Array, length: float) -> Array:
    """Samples at which all channels (m, n) together resemble their mean beat, one a beat.

    Each beat has one such sample, even if it has several upstrokes. The upstroke with the median rise is the first
    template.
    """
    before, end, block = (max(2, round(part * length)) for part in (limits.BEFORE, limits.ANOTHER, 1.0))
    x = x / np.maximum(x.std(axis=1, keepdims=True), np.finfo(float).tiny)
    rise = np.sum([np.maximum(_rise(each, length), 0.0) for each in x], axis=0)
    starts = range(0, max(1, x.shape[1] - block + 1), block)
    tops = sorted((float(rise[i : i + block].max()), i + int(rise[i : i + block].argmax())) for i in starts)
    at = np.array([tops[len(tops) // 2][1]])
    padded = np.pad(x, ((0, 0), (before, end)), mode="edge")
    correlations = [_alike(each, before + end) for each in padded]
    for _ in range(3):
        windows = padded[:, at[:, None] + np.arange(before + end)]
        alike = np.mean([of(w.mean(axis=0)) for of, w in zip(correlations, windows, strict=True)], axis=0)
        usual = np.median([alike[i : i + block].max() for i in starts])
        at = _peaks(alike, limits.RESEMBLING * usual, round(limits.NEAREST * length))
        if not len(at):
            break
    return np.asarray(at)


def _peaks(x: Array, least: float, apart: int) -> Array:
    """Samples of the maxima of at least ``least``, the highest first: none is nearer than ``apart`` to a higher one."""
    at = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]) & (x[1:-1] >= least)) + 1
    left, right = np.searchsorted(at, at - apart, "right"), np.searchsorted(at, at + apart, "left")
    kept = np.ones(len(at), bool)
    for i in np.argsort(-x[at], kind="stable"):
        if kept[i]:
            kept[left[i] : i] = kept[i + 1 : right[i]] = False
    return np.asarray(at[kept])


def _rise(x: Array, length: float) -> Array:
    """By how much the mean after a sample is higher than that before it : (n,)."""
    half = max(1, round(limits.SEARCHED * length))
    total = np.concatenate([[0.0], np.cumsum(np.pad(x, half, mode="edge"))])
    j = np.arange(half, half + len(x))
    return np.asarray((total[j + half] - 2.0 * total[j] + total[j - half]) / half)


def _alike(x: Array, w: int) -> Callable[[Array], Array]:
    """The correlation of each stretch of w samples of x with a beat of as many."""
    x = x - x.mean()
    total, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (x, x * x))
    power = squares[w:] - squares[:-w] - (total[w:] - total[:-w]) ** 2 / w
    power = np.maximum(power, 1e-9 * w * float(x.var()))
    n = 1 << (len(x) - 1).bit_length()
    waves = np.fft.rfft(x, n)

    def of(beat: Array) -> Array:
        beat = beat - beat.mean()
        size = np.sqrt(power * max(float(beat @ beat), np.finfo(float).tiny))
        product = np.fft.irfft(waves * np.fft.rfft(beat, n).conj(), n)[: len(size)]
        return np.asarray(product / size)

    return of


def vertex(r: Array, at: Array) -> Array:
    """Place of the parabola through r : (m, n) at the samples (m,) and their neighbours; at the ends, the sample."""
    if r.shape[1] < 3:
        return at.astype(float)
    row, inner = np.arange(len(r)), np.clip(at, 1, r.shape[1] - 2)
    left, middle, right = (r[row, inner + i] for i in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    bent = (bend < 0.0) & (inner == at)
    return np.asarray(at + np.where(bent, 0.5 * (left - right) / np.where(bent, bend, 1.0), 0.0))


def lead(channels: Mapping[str, Array], at: Array, length: float) -> int:
    """Samples from an upstroke back to where, in the first of the channels, it begins: the end of diastole."""
    reach = round(0.45 * length)
    inside = np.rint(at[(at > reach + 1) & (at + reach < len(next(iter(channels.values()))) - 1)]).astype(int)
    leads = []
    for x in channels.values():
        mean = without_gaps(x)[inside[:, None] + np.arange(-reach, reach)].mean(axis=0)
        width = max(1, round(0.25 * limits.SEARCHED * length))
        slope = np.convolve(np.gradient(mean), np.ones(width) / width, mode="same")
        middle = slice(reach - reach // 2, reach + reach // 2)
        steepest = middle.start + int(slope[middle].argmax())
        flat = np.flatnonzero(slope[:steepest] < limits.FLAT_FOOT * slope[steepest])
        leads.append(reach - (int(flat[-1]) if len(flat) else 0))
    return max(leads)


def usual_range(x: Array) -> tuple[float, float]:
    """Between which a channel's values are, NaN in gaps: beyond, there are spikes."""
    low, high = np.nanquantile(x, limits.ORDINARY)
    return float(low - (high - low)), float(high + (high - low))


# --- beats that are cut at their upstrokes ----------------------------------------------------------------------------


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
    notes = tuple(_exclusion_notes(edges, near, odd, alike, dt))
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


def _exclusion_notes(edges: Array, near: Array, odd: Array, alike: Array, dt: float) -> Iterator[str]:
    """What was left out, in sentences."""
    times, lengths = edges * dt, np.diff(edges)
    first, last = int(alike[0]), int(alike[-1]) + 1
    used = lengths[alike]
    if np.abs(used - used.mean()).max() > limits.UNSTEADY * used.mean():
        yield (
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
            yield f"{_count(len(which))} left out, {why}; at {begin} s after the record's start."
    if outside := len(lengths) - (last - first):
        yield (
            f"used from {times[first]:.4g} to {times[last]:.4g} s after the record's start, the longest stretch with a "
            f"steady heart rate; {_count(outside)} before and after it left out."
        )


def _count(n: int) -> str:
    return f"{n} beat{'s' if n > 1 else ''}"
