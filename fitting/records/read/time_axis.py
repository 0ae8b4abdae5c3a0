"""The uniform time axis behind the stamps of a record: its rate by regression, jitter and lost samples.

Stamps t_j of samples number m_j lie on a line t_j = t_0 + m_j/f + d_j. Where all |d_j| are within the resolution of the
stamps, the clock is uniform and its samples stay as they are. Otherwise the stamps are trusted: a cubic spline moves
the samples onto the line, once. Samples that are missing on the line become gaps. Stamps that go back are those of a
clock that jitters by more than a sample, since a converter takes its samples in order: the running median of t_j - j dt
takes their place, which keeps lost samples and a drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np

from solver.errors import InputError

from .. import limits
from .clock import span_text
from .sensors import UnusableRecord, refuse
from .table import Array, Place

_DOUBLE, _SINGLE = 2.3e-16, 1.2e-7  # relative rounding of numbers of 8 and of 4 bytes
_SEEN = 10  # stamps on either side of a wide step: their medians stand still where one stamp alone is late
_REPEATED = 2.0  # of the resolution: how far off repeated stamps may be
_EVENLY = 0.5 * (5.0**0.5 - 1.0)  # multiples of the golden ratio, modulo 1
_ROUNDS = 5  # of counting lost samples by the interval and finding the interval by them


@dataclass(frozen=True)
class Axis:
    """time : (n,) [s], uniform. stamps : (k,) [s] as given; number : (k,) of each of them on the axis, None where all
    stand for themselves. moved : whether samples are interpolated. said, told : the treatment of the stamps, as
    sentences and as plain data."""

    time: Array
    stamps: Array
    number: Array | None = None
    moved: bool = False
    said: tuple[str, ...] = ()
    told: Mapping[str, Any] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Time between samples [s]."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    def of(self, values: Array) -> Array:
        """A channel (k,) on the axis : (n,), NaN where a sample is lost."""
        if self.number is None:
            return values
        if self.moved:
            there, at = ~np.isnan(values), self.time[self.number]
            half = 0.5 * (self.time[1] - self.time[0])  # as far beyond the first and the last
            covered = there & (at > self.stamps[0] - half) & (at < self.stamps[-1] + half)
            values = np.where(covered, between(self.stamps[there], values[there], at), np.nan)
        found = np.full(len(self.time), np.nan)
        found[self.number] = values
        return found


def between(t: Array, x: Array, at: Array) -> Array:
    """x(t) at other times by a cubic spline; NaN of fewer than two samples."""
    from scipy.interpolate import CubicSpline  # takes a third of a second

    return CubicSpline(t, x)(at) if len(t) > 1 else np.full(len(at), np.nan)


def rows_of(
    given: Array, factor: float, origin: float, span: tuple[float, float], place: Place
) -> tuple[slice, tuple[str, ...]]:
    """The samples whose stamps, ``given`` times ``factor`` [s], lie in the span [s] from ``origin`` [s] on, and a note.

    Where times begin anew they go on from those before. Raises ValueError if there are none.
    """
    after = _going_on(given) * factor - origin
    blur = 4.0 * np.spacing(np.abs(after + origin).max())  # of a stamp at the edge
    inside = np.flatnonzero((after >= span[0] - blur) & (after < span[1] - blur))
    if len(inside) == 0:
        lasts = f"its samples are from {after.min():.6g} to {after.max():.6g} s after the first"
        raise InputError(f'{place}: --part "{span_text(span)}": {lasts}; give a part of these.')
    note = f"{place}: only {span_text(span)} of the record was read; times in notes count from there."
    return slice(int(inside[0]), int(inside[-1]) + 1), (note,)


def _going_on(given: Array) -> Array:
    """Stamps without gaps, none before the one before: a step back by more than jitter counts as a usual one."""
    there = np.isfinite(given)
    stamps = _steadied(given if there.all() else np.interp(np.arange(len(given)), np.flatnonzero(there), given[there]))
    step = np.diff(stamps)
    if step.min(initial=0.0) >= 0.0:
        return stamps
    return stamps[0] + np.concatenate([[0.0], np.cumsum(np.where(step < 0.0, np.median(step), step))])


def longest_block(given: Array, factor: float, place: Place) -> tuple[slice, tuple[str, ...]]:
    """The samples of the longest block of a file, and a note on the others; all samples of a file with one block.

    A recorder that is started again begins its times anew, or leaves a pause. Such a step parts blocks if the stamps
    have no axis together: they go back by more than jitter, or more samples are missing than are there.
    """
    whole: tuple[slice, tuple[str, ...]] = slice(0, len(given)), ()
    if len(given) < limits.FEWEST_SAMPLES or not np.isfinite(given).all():
        return whole
    step = np.diff(given)
    if np.diff(_steadied(given)).min() >= 0.0 and given[-1] - given[0] <= 2.0 * len(given) * np.median(step):
        return whole
    edges = [0, *(np.flatnonzero((step < 0.0) | (step * factor > limits.LONGEST)) + 1), len(given)]
    sizes = np.diff(edges)
    if sizes.min() < limits.FEWEST_SAMPLES or len(sizes) == 1:
        return whole
    start = int(edges[sizes.argmax()])
    block = slice(start, start + int(sizes.max()))
    return block, (
        f"{place} holds {len(sizes)} blocks, at which its times begin anew or pause; the longest, of "
        f"{(given[block.stop - 1] - given[start]) * factor:.4g} s from {place.of(start)} on, was read: --part reads "
        "another.",
    )


def time_axis(given: Array, factor: float, title: str, place: Place) -> Axis:
    """The uniform axis behind the stamps ``given`` : (k,), which ``factor`` makes seconds.

    A stamp may be off by a unit q of its last decimal, or of the last of its significant digits (%.6g): rounded it is
    off by half of one, cut off by a whole one, and a product such as 7 * 0.005 may lie on either side of a digit. Or by
    the rounding of single precision, if all are such numbers. Where one step is 1.5 times the usual one, by a quarter
    of an interval at most: a lost sample bends the line by half of one. But where q is half an interval or more and
    wide steps are many, they are of the rounding: 700 Hz in milliseconds has steps of 1 and 2. So are they if a stamp
    repeats the one before, as 1 kHz in milliseconds does by the rounding of i/1000 before it is cut off; such stamps,
    which define no time of a sample, may be off by 2 q. Where most stamps repeat the one before, as those of packets
    do, q is the time between those that differ.
    Raises ValueError, one sentence, for stamps that are missing, go back beyond their jitter, or have no rate.
    """
    _check(given, factor, title, place)
    printed, given = given, _steadied(given)
    shaken = float(np.abs(given - printed).max())
    back = (_shaken(printed, shaken * factor, place),) if shaken > 0.0 else ()
    t, n = given - given[0], len(given)
    step = np.diff(t)
    dt, off = _line(t, np.arange(n))
    q = _resolution(printed, dt, float(np.abs(off).max()))
    worst, usual = float(np.abs(off).max()), float(np.median(step))
    if usual == 0.0:
        q = max(q, float(np.median(step[step > 0.0])))  # a stamp for a packet of samples
    repeated = bool((step == 0.0).any())
    coarse = q >= 0.5 * dt and (repeated or np.mean(step >= limits.WIDE_STEP * usual) > limits.LOST)
    most = _REPEATED * q if repeated and coarse else q
    if dt > 0.0 and worst <= (most if coarse or step.max() < limits.WIDE_STEP * dt else min(q, 0.25 * dt)):
        coarse_note = _coarse(q, dt, t, factor, place) if coarse and worst > 1e-6 * q else ()
        return Axis((given[0] + t - off) * factor, given * factor, said=(*back, *coarse_note))
    if step.min() <= 0.0:
        _refuse_back(printed, title, place)
    number = _numbered(t, q, shaken)
    dt, off = _line(t, number)
    lost = int(number[-1]) + 1 - n
    _check_regular(step, np.diff(number), dt, lost, title, place)
    worst, rms = float(np.abs(off).max()) * factor, float(np.sqrt(np.mean(off**2))) * factor
    moved = worst > max(q if q < 0.5 * dt else 0.25 * dt, shaken) * factor
    start = given[0] + (t - off - dt * number)[0]
    sampling = {"rate": {"value": 1.0 / (dt * factor), "unit": "Hz"}, "lost": lost, "resampled": moved}
    sampling |= {f"jitter_{name}": {"value": value, "unit": "s"} for name, value in (("rms", rms), ("max", worst))}
    notes = (*back, _resampling_note(place, 1.0 / (dt * factor), rms, worst, lost, n, moved))
    time = (start + dt * np.arange(n + lost)) * factor
    return Axis(time, given * factor, number, moved, notes, {"sampling": sampling})


def _check(given: Array, factor: float, title: str, place: Place) -> None:
    """Raise ValueError for times that are missing, too few, too late or end before they begin."""
    bad = np.flatnonzero(~np.isfinite(given))
    if len(bad):
        refuse(place, int(bad[0]), title, "the time is missing or not finite; every sample needs its time")
    if len(given) < limits.FEWEST_SAMPLES:
        raise UnusableRecord(f"{place}: {len(given)} samples are too few; a record holds several beats.")
    with np.errstate(over="ignore"):
        longest = float(np.abs(given).max()) * factor
    if not longest < limits.LATEST:
        refuse(place, 0, title, f"times beyond {limits.LATEST:g} s; check the unit, or start the record at zero")
    if given[-1] <= given[0]:
        _refuse_back(given, title, place)


def _refuse_back(given: Array, title: str, place: Place) -> NoReturn:
    """Raise ValueError at the first stamp that is not later than the one before."""
    at = int(np.argmax(np.diff(given) <= 0.0))
    why = f"the time does not increase ({given[at]:g} to {given[at + 1]:g}); correct the line, or begin the file there"
    refuse(place, at + 1, title, why)


def _steadied(given: Array) -> Array:
    """Stamps as they are if none goes back; else i dt plus the running median of t_i - i dt over so many stamps that
    no step is shorter than half of dt. If one is over a quarter of the record, too, as where a file begins anew, they
    stay as they are."""
    if np.diff(given).min() >= 0.0:
        return given
    from scipy.ndimage import median_filter  # takes a tenth of a second

    number = np.arange(len(given))
    dt, _ = _line(given - given[0], number)
    line = dt * number
    # rounded stamps are spread over their last decimal, evenly: their median is then finer than that
    level = given - line + _last_decimal(given) * (_EVENLY * number % 1.0 - 0.5)
    width = 2 * _SEEN + 1
    while width <= len(given) // 4:
        found = line + median_filter(level, width, mode="nearest")
        if np.diff(found).min() > 0.5 * dt:
            return np.asarray(found)
        width *= 2
    return given


def _check_regular(step: Array, numbers: Array, dt: float, lost: int, title: str, place: Place) -> None:
    """Raise ValueError where steps have no interval in common, or most samples are missing."""
    odd = np.abs(step / dt - numbers) > 0.5
    if odd.mean() > limits.IRREGULAR:
        at = int(np.flatnonzero(odd)[0])
        why = (
            f"the sampling is not uniform: {odd.mean():.0%} of the steps are off by more than half of the usual one, "
            f"{dt:.6g}, such as {step[at]:.6g}, and {limits.IRREGULAR:.0%} can be resampled; resample the record, or "
            "export it at the rate of its sensors"
        )
        refuse(place, at + 1, title, why)
    if lost > len(step):
        at = int(step.argmax())
        why = (
            f"{lost} samples are missing and {len(step) + 1} are there, the longest step is {step[at]:.6g}; at least "
            "half must be there: read the part on one side of the pause with --part"
        )
        refuse(place, at + 1, title, why)


def _line(t: Array, number: Array) -> tuple[float, Array]:
    """Interval of the regression of t on the number of the sample, and how far each t is off its line."""
    index = number - number.mean()
    dt = float(t @ index / (index @ index))
    return dt, t - t.mean() - dt * index


def _numbered(t: Array, q: float, shaken: float) -> Array:
    """The number of each stamp's sample : (k,), which leaves out those that are lost.

    Over a wide step the level t - i dt of the stamps i rises by an interval for each lost sample, and by none where a
    stamp was late. Levels are medians of a few stamps on either side.
    """
    step, i, number = np.diff(t), np.arange(len(t)), np.arange(len(t))
    dt = float(np.median(step))
    # of stamps in steps of q the median is but one of their steps
    dt = float(step[step <= limits.WIDE_STEP * dt + q].mean())
    for _ in range(_ROUNDS):
        wide, level = np.flatnonzero(step > limits.WIDE_STEP * dt + shaken) + 1, t - dt * i
        lost = np.zeros(len(t), int)
        for before, at, after in zip([0, *wide], wide, [*wide[1:], len(t)], strict=False):
            rise = np.median(level[at : min(after, at + _SEEN)]) - np.median(level[max(before, at - _SEEN) : at])
            lost[at] = max(0, round(float(rise) / dt))
        found = i + np.cumsum(lost)
        dt, _ = _line(t, found)
        if np.array_equal(found, number):
            break
        number = found
    return found


# --- what is said -------------------------------------------------------------------------------------------------


def _coarse(q: float, dt: float, t: Array, factor: float, place: Place) -> tuple[str, ...]:
    """Of stamps too coarse to show single samples. An error of up to q/2 of all stamps moves the slope of their line by
    at most Σ|i| q/2 / Σi² = 1.5 q/(n dt) of itself. Raises ValueError where that is too much."""
    error = 1.5 * q / t[-1]
    if error > limits.IRREGULAR:
        raise UnusableRecord(
            f"{place}: its times are printed in steps of {q * factor:g} s, which over {t[-1] * factor:.4g} s leave the "
            f"rate open by {error:.0%}, and {limits.IRREGULAR:.0%} is allowed; print the time with more decimals, or "
            "record longer."
        )
    return (
        f"the times of {place} are printed in steps of {q * factor:g} s: the line through them has "
        f"{1.0 / (dt * factor):.6g} Hz, to {error:.1g} of that; a lost sample would not be seen.",
    )


def _shaken(printed: Array, most: float, place: Place) -> str:
    back = np.flatnonzero(np.diff(printed) < 0.0)
    return (
        f"the times of {place} go back {len(back)} times, first in {place.of(int(back[0]) + 1)}: the samples were "
        "taken in their order, at the running median of the times. These are off by at most "
        f"{1e3 * most:.3g} ms; fewer lost samples than that would not be seen."
    )


def _resampling_note(place: Place, rate: float, rms: float, worst: float, lost: int, n: int, moved: bool) -> str:
    done = "the channels were resampled once onto the line through the times" if moved else "no sample was moved"
    gaps = f"; of {n + lost} samples {lost} lost, which became gaps" if lost else ""
    jitter = f", jitter {1e3 * rms:.3g} ms rms and {1e3 * worst:.3g} ms at most" if moved else ""
    return f"the sampling of {place} is uneven: {rate:.6g} Hz{jitter}{gaps}; {done}."


# --- the resolution of printed times ------------------------------------------------------------------------------


def _resolution(given: Array, dt: float, worst: float) -> float:
    """By how much a printed time may be off; coarser readings only where ``worst`` is beyond the finer."""
    size = np.abs(given).max()
    q = _last_decimal(given) + 1e-6 * dt + _DOUBLE * size
    if worst > q:
        q = max(q, _last_digit(given))
    return float(q + _SINGLE * size if worst > q and _single(given) else q)


def _single(values: Array) -> bool:
    """Whether all are numbers of single precision, exact or as such numbers are printed (the first ones)."""
    with np.errstate(over="ignore"):
        some = values[:1000].astype(np.float32)
    return bool((some == values[:1000]).all() or (some.astype(str).astype(float) == values[:1000]).all())


def _last_digit(values: Array) -> float:
    """The last digit of the largest if all, of the first and the last, have the same 4 to 9 significant digits."""
    some = np.abs(np.concatenate([values[:1000], values[-1000:]]))
    some = some[some > 0.0]
    size = np.floor(np.log10(some)) + 1.0
    for digits in range(4, 10):
        scaled = some * 10.0 ** (digits - size)
        if np.abs(scaled - np.round(scaled)).max() < 1e-6:
            return float(10.0 ** (size.max() - digits))
    return 0.0


def _last_decimal(values: Array) -> float:
    """The rounding of printing: the largest power of ten that all are multiples of, as far as doubles can tell."""
    size = float(np.abs(values).max())
    for digits in range(-3, 16):
        blur = 2.0 * _DOUBLE * size * 10.0**digits
        scaled = values * 10.0**digits
        if blur > 0.01 or np.abs(scaled - np.round(scaled)).max() < 1e-4 + blur:
            return float(10.0**-digits)
    return 0.0
