"""The period of a record: the shortest lag after which all channels repeat.

A stretch of one lag L, in all channels, is compared with the signal one, two and three lags later, shifted to the best
fit. Each channel is scaled by its own power. If any channel repeats worse after L than after 2 L or 3 L, then L is a
part of a beat. Stretches may come early or late, so that a heart whose rate varies also has a period; the timing of the
beats gives a strict one (:mod:`fitting.records.alignment.equal_beats`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.errors import InputError

from .. import limits
from ..read.sensors import without_gaps
from .variable_beats import Array, find_upstrokes, usual_range, vertex

_FINE = 5e-3  # [s], the time step of the search
_EXACT, _FINEST = 1e-12, 1e-3  # of the power: of no stretch, and of a difference that a shift by half a sample makes
_SAMPLES, _STRETCHES = 40, 80  # of a stretch; of a record


@dataclass(frozen=True)
class PeriodFound:
    """A period [s], and sentences on its doubts.

    other : the period [s] if several beats are one or a beat is several, as they differ in turn; else NaN.
    """

    T: float
    other: float = np.nan
    said: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Later:
    """How n stretches go on some time later.

    alike : (m,) the usual correlation, weighted by power. unlike : (m, n) the power by which they differ over the mean
    power. shift : (n,) samples after which they fit best. power : (n,) of the stretches.
    """

    alike: Array
    unlike: Array
    shift: Array
    power: Array

    @property
    def lag(self) -> float:
        """The usual shift."""
        return float(np.median(self.shift))


def usual_period(channels: Mapping[str, Array], dt: float, source: str) -> PeriodFound:
    """The period of all channels together to some thousandths, steady or not.

    Raises ValueError if nothing repeats, or not twice, or too few samples show a beat.
    """
    span = len(next(iter(channels.values()))) * dt
    if span < 2.0 * limits.SHORTEST:
        raise InputError(
            f"{source}: {span:.3g} s of record cannot hold two beats of {limits.SHORTEST:g} s, the shortest; check the "
            f"unit of its time column, or record longer."
        )
    if limits.FEWEST_SAMPLES * dt > limits.LONGEST:
        raise InputError(
            f"{source}: a sample every {dt:.4g} s is fewer than {limits.FEWEST_SAMPLES} in {limits.LONGEST:.3g} s, the "
            "longest beat; check the unit of its time column, or record at a higher rate."
        )
    names, x, step = _screened(channels, dt)
    candidates = _candidates(x, step)
    tried: list[_Later] = []  # stretches of the shortest lag after each, until all channels go on alike after one
    for each in _later(x, candidates[0], candidates) if len(candidates) else ():
        tried.append(each)
        if (each.alike >= limits.GOES_ON).all() and _whole(x, each.lag, candidates):
            break
    best = np.max([each.alike for each in tried], axis=0) if tried else np.zeros(len(names))
    votes = best >= limits.HALF
    if not votes.any():
        raise InputError(
            f"{source}: no periodicity found between {limits.SHORTEST:g} and {limits.LONGEST:.2g} s in {span:.4g} s of "
            f"record (best correlation {best.max():.2f}, in {names[int(best.argmax())]}); check the unit of its time "
            f"column, record at least two whole beats of {limits.FEWEST_SAMPLES} samples or more each, or give the "
            "period."
        )
    scores = [float((each.alike / best)[votes].min()) for each in tried]
    lags = [each.lag for each, score in zip(tried, scores, strict=True) if score >= min(limits.GOES_ON, max(scores))]
    lag = next((lag for lag in lags if _whole(x[votes], lag, candidates)), lags[0])
    T = lag * step
    if 2.0 * T > span * 1.02:
        raise InputError(
            f"{source}: one beat only: {span:.4g} s of record with a period of about {T:.3g} s; "
            f"record at least two whole beats of {limits.FEWEST_SAMPLES} samples or more each."
        )
    found = _judged([names[i] for i in np.flatnonzero(votes)], x[votes], lag, candidates, step)
    for each in tried:
        if _irregular(x[votes], each.lag, found.T / step):
            note = (
                f"the heart is irregular: beats about {each.lag * step:.3g} s apart come at intervals that do not "
                f"repeat, as in atrial fibrillation; if {round(found.T / step / each.lag)} upstrokes are one beat, of "
                f"{found.T:.3g} s, give that period."
            )
            return PeriodFound(each.lag * step, found.T, (note,))
    passed = list(zip([each.lag for each in tried], scores, strict=True))
    return found if found.said else _passed_over(found, x[votes], passed, candidates, step)


def repeats(values: Array, dt: float, T: float) -> tuple[float, float]:
    """The time near T [s] after which stretches of T of one channel usually go on, NaN if they do not go on alike, and
    its standard error: of a median of stretches, which overlap by half, so that half count.

    A channel may go on alike after less, too: a pulse that rings has several upstrokes a beat.
    """
    _, x, step = _screened({"": values}, dt)
    if not len(x) or 2.0 * T > x.shape[1] * step * 1.02:
        return np.nan, np.nan
    (later,) = _later(x, T / step, (T / step,))
    error = float(np.std(later.shift)) * np.sqrt(0.5 * np.pi / max(0.5 * len(later.shift), 1.0))
    return later.lag * step if later.alike[0] >= limits.HALF else np.nan, error * step


def _whole(x: Array, lag: float, candidates: Array) -> bool:
    """Whether stretches as long as the lag go on alike, too: two thirds of a beat of three upstrokes do not."""
    first, *more = _around(x, lag, candidates)
    return all((first.alike >= limits.HALF * each.alike).all() for each in more)


def _around(x: Array, lag: float, candidates: Array) -> list[_Later]:
    """The continuation of stretches of one lag [samples], in the middle of the record, after one and up to four lags.

    An intervention in the middle may change the rate: if stretches go on less alike there than at the beginning or the
    end, where they are those of one steady heart, the part is taken from there.
    """
    most = round(_STRETCHES * 0.45 * lag)
    last = max(0, x.shape[1] - most)
    starts = (last // 2, 0, last)
    likeness = [float(next(_later(x[:, at : at + most], lag, (lag,))).alike.min()) for at in starts]
    best = int(np.argmax(likeness))
    start = starts[best if likeness[best] >= limits.SAME > likeness[0] / likeness[best] else 0]
    part = x[:, start : start + most]
    longest = min(4.5, part.shape[1] / lag - 2.0)
    return list(_later(part, lag, (lag, *(each for each in candidates if 1.5 < each / lag < longest))))


def _judged(names: Sequence[str], x: Array, lag: float, candidates: Array, step: float) -> PeriodFound:
    """The period: this lag [samples], or two to four of it if successive stretches of one lag differ in turn.

    If they also differ in timing, or differ much, the lag is a part of a beat. Otherwise a part of a beat is
    indistinguishable from a heart that alternates: the lag is taken for a whole beat, with a note.
    """
    T, (first, *more) = lag * step, _around(x, lag, candidates)
    differ = [(*_differ(first, each), each, round(each.lag / lag)) for each in more]
    differ = [each for each in differ if each[0] > (limits.IN_TURN if each[-1] <= limits.UPSTROKES else limits.MUCH)]
    if not differ:
        return PeriodFound(T)
    most = max(times for times, *_ in differ)
    times, which, sure, other, count = next(each for each in differ if each[0] >= most / limits.AS_MUCH)
    together, another_part = other.lag * step, first.alike[which] < limits.SAME * other.alike[which]
    next_one, as_many = (_change(first, beats) for beats in (1, count))
    timely = next_one <= max(limits.NEAR * lag, limits.UNTIMELY * as_many)
    if count <= limits.UPSTROKES and (another_part or not timely):
        note = (
            f"the period may be {T:.3g} s: what comes every {T:.3g} s differs in turn, but too few times to be sure; "
            f"either a beat of {together:.3g} s has {count} upstrokes, or beats alternate. If these are beats, give "
            "their period."
        )
        return PeriodFound(together, T, () if sure else (note,))
    far = {2: "second", 3: "third", 4: "fourth"}[count]
    note = (
        f"the period may be {together:.3g} s: beats of {T:.3g} s differ {times:.2g} times as much from the next one as "
        f"from the {far} next in {names[which]}; either they alternate, or {count} upstrokes are one beat. If so, give "
        "its period."
    )
    return PeriodFound(T, together, (note,))


def _passed_over(
    found: PeriodFound, x: Array, passed: Sequence[tuple[float, float]], candidates: Array, step: float
) -> PeriodFound:
    """With a note where the period is several of the lags [samples] that were tried before, or short for a heart.

    Two or three upstrokes may be one beat if a channel shows that successive lags differ in turn. Four are no beat:
    they are beats of one breath, if half of the power repeats after one lag.
    """
    for lag, score in passed:
        count = round(found.T / (lag * step))
        if count < 2 or abs(found.T / (lag * step) - count) > limits.ELASTIC:
            continue
        first, *more = _around(x, lag, candidates)
        alike = any(round(each.lag / lag) == count and _differ(first, each)[0] < limits.IN_TURN for each in more)
        if score >= limits.HALF if count > limits.UPSTROKES else alike:
            note = (
                f"the period may be {lag * step:.3g} s: all channels go on nearly as they do after {found.T:.3g} s; "
                f"either rate or stroke vary, or a beat has {count} upstrokes. If they are beats, give their period."
            )
            return PeriodFound(found.T, lag * step, (note,))
    if found.T < limits.FASTEST_HEART:
        note = (
            f"the period of {found.T:.3g} s is that of {60.0 / found.T:.0f} beats a minute, which only hearts of "
            "rodents reach; if it is a part of a beat, give the period."
        )
        return replace(found, said=(note,))
    return found


def _irregular(x: Array, lag: float, T: float) -> bool:
    """Whether upstrokes about a lag [samples] apart are beats of a fibrillating heart, not the parts of one beat of T.

    Then no beat of T comes at equal intervals, and after as many upstrokes the intervals do not come again. The longer
    lag fits better all the same, as its stretches may come early or late by more.
    """
    count, channels = round(T / lag), {str(i): each for i, each in enumerate(x)}
    if count < 2:
        return False
    found, together = (find_upstrokes(channels, length) for length in (lag, T))
    if found is None or together is None or len(found.at) <= count + limits.FEWEST_BEATS:
        return False
    intervals, apart = np.diff(found.at), np.diff(together.at)
    again = float(np.median(np.abs(intervals[count:] - intervals[:-count])))
    equal = float(np.median(np.abs(apart - np.median(apart))))
    alike = float(np.median(found.likeness)) >= limits.GOES_ON
    return alike and again > limits.ELASTIC * lag and equal > 0.5 * limits.ELASTIC * T


def _change(one: _Later, beats: int) -> float:
    """By how many samples the shift of a stretch usually differs from that some beats later; stretches are half a beat
    apart."""
    later = 2 * beats
    change = np.abs(one.shift[later:] - one.shift[:-later])[None]
    power = np.minimum(one.power[later:], one.power[:-later])[None]
    return float(_weighted_median(change, power)[0]) if change.size else 0.0


def _differ(first: _Later, other: _Later) -> tuple[float, int, bool]:
    """How many times as much stretches differ from the next as from the other, at most, in which channel, and whether
    for certain; 0 where that is no more often so than by chance. Of stretches, which overlap by half, half count."""
    n = min(first.unlike.shape[1], other.unlike.shape[1])
    a, b = first.unlike[:, :n], other.unlike[:, :n]
    often = (2.0 * (a > b).mean(axis=1) - 1.0) * np.sqrt(n / 2.0)
    times = np.median(a, axis=1) / np.maximum(np.median(b, axis=1), _FINEST)
    times = np.where(often >= min(limits.FIVE_PERCENT, 0.99 * np.sqrt(n / 2.0)), times, 0.0)
    which = int(times.argmax())
    return float(times[which]), which, bool(often[which] >= limits.SURE)


def _screened(channels: Mapping[str, Array], dt: float) -> tuple[list[str], Array, float]:
    """The channels that were measured, x : (m, n) without wander, gaps and spikes, of size 1; and its time step [s]."""
    n = round(limits.SCREENED / dt)
    length = len(next(iter(channels.values())))
    parts = [slice(i, i + n) for i in range(0, max(1, length - n // 2), max(1, n))]
    gaps = [sum(int(np.isnan(x[part]).sum()) for x in channels.values()) for part in parts]
    part = parts[int(np.argmin(gaps))]
    few = max(1, int(_FINE / dt * (1.0 + 1e-9)))
    names, found = [], []
    for name, values in channels.items():
        there = ~np.isnan(values[part])
        if np.count_nonzero(there) < max(2 * limits.FEWEST_SAMPLES, 0.5 * len(there)):
            continue
        x = without_gaps(values[part])
        x = np.clip(x, *usual_range(x))
        x = _without_wander(x[: len(x) // few * few].reshape(-1, few).mean(axis=1), few * dt)
        names.append(name)
        found.append(x / max(float(x.std()), np.finfo(float).tiny))
    return names, np.array(found), few * dt


def _without_wander(x: Array, step: float) -> Array:
    """Without its straight line, and without frequencies below any heart rate that the record can resolve."""
    index = np.arange(len(x)) - (len(x) - 1) / 2.0
    x = x - x.mean()
    x = x - index * (index @ x) / (index @ index)
    if len(x) * step * limits.WANDER >= 2.0:
        spectrum = np.fft.rfft(x)
        spectrum[np.fft.rfftfreq(len(x), step) < limits.WANDER] = 0.0
        x = np.fft.irfft(spectrum, len(x))
    return x


def _candidates(x: Array, step: float) -> Array:
    """Lags [samples] at which the mean correlation of the channels is the highest near by, in order."""
    count = min(int(limits.LONGEST / step) + 2, int(0.75 * x.shape[1]))
    n = x.shape[1]
    power = (np.abs(np.fft.rfft(x, 2 * n, axis=1)) ** 2).mean(axis=0)
    r = np.fft.irfft(power)[:count] / (n - np.arange(count))  # the mean of x_j x_{j+L}
    first = max(int(limits.SHORTEST / step * 0.97), 1)
    lags = np.arange(first + 1, len(r) - 1)
    lags = lags[(r[lags] > 0.0) & (r[lags] >= np.maximum(r[lags - 1], r[lags + 1]))]
    highest = [r[int(lag * (1.0 - limits.ELASTIC)) : int(lag * (1.0 + limits.ELASTIC)) + 1].max() for lag in lags]
    lags = lags[r[lags] == highest]
    return vertex(np.broadcast_to(r, (len(lags), len(r))), lags)


def _later(x: Array, length: float, lags: Iterable[float]) -> Iterator[_Later]:
    """How stretches of x : (m, n), of one length and half of it apart, go on after each of the lags [samples]."""
    h = max(1.0, length / _SAMPLES)
    edges, samples = np.arange(int(x.shape[1] / h) + 1) * h, np.arange(x.shape[1] + 1)
    sums = np.array([np.interp(edges, samples, np.concatenate([[0.0], np.cumsum(each)])) for each in x])
    y, w = np.diff(sums, axis=1) / h, round(length / h)  # means over h samples
    windows = np.lib.stride_tricks.sliding_window_view(y, w, axis=1)
    means = windows.mean(axis=2)
    powers = np.maximum((windows**2).sum(axis=2) - w * means**2, _EXACT)
    for lag in lags:
        there, reach = round(lag / h), round(limits.ELASTIC * lag / h)
        last = powers.shape[1] - 1 - there - reach
        if last < w:  # as far as the record is long
            last = max(0, powers.shape[1] - 1 - there)
        t = np.arange(0, last + 1, max(w // 2, -(-last // _STRETCHES)))
        shifts = there + np.arange(-reach, reach + 1)
        after = y[:, np.minimum(t[:, None] + np.arange(shifts[0], shifts[-1] + w), y.shape[1] - 1)]
        own = powers[:, t]
        other = powers[:, np.minimum(t[:, None] + shifts, powers.shape[1] - 1)]
        first = windows[:, t] - means[:, t, None]
        products = np.matmul(np.lib.stride_tricks.sliding_window_view(after, w, axis=2), first[..., None])
        r = products[..., 0] / np.sqrt(own[..., None] * other)
        part = own / own.mean(axis=1, keepdims=True)
        joint = np.einsum("cts,ct->ts", r, np.sqrt(part))
        row, best = np.arange(len(t)), joint.argmax(axis=1)
        offset = vertex(joint, best) - best
        left, r, right = (r[:, row, np.clip(best + i, 0, len(shifts) - 1)] for i in (-1, 0, 1))
        r = r + 0.5 * offset * (right - left) + 0.5 * offset**2 * (left - 2.0 * r + right)  # on the parabola, too
        other = other[:, row, best]
        size = np.sqrt(own * other)
        unlike = (own + other - 2.0 * r * size) / (2.0 * own.mean(axis=1, keepdims=True))
        yield _Later(_weighted_median(r, size), unlike, (shifts[best] + offset) * h, part.sum(axis=0))


def _weighted_median(r: Array, weights: Array) -> Array:
    """Along the last axis."""
    order = np.argsort(r, axis=1)
    total = np.cumsum(np.take_along_axis(weights, order, axis=1), axis=1)
    middle = (total < 0.5 * total[:, -1:]).sum(axis=1)
    return np.take_along_axis(r, np.take_along_axis(order, middle[:, None], axis=1), axis=1)[:, 0]
