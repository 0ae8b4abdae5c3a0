"""Where beats begin: the upstrokes of a channel, found without the assumption that they come at equal intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
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
