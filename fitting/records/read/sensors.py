"""What a channel of a record may be, the channels that no fit can use (dead, clipped, out of range, swapped), and what
sensors record beside the artery: while they are flushed, zeroed or calibrated, codes for none, and hum.

A flow alone may be constant, for an outlet may be closed; it is then no channel of the record, see ``Record.resting``.
A line that is flushed or open to the air stands still for longer than any beat does, and it gets there in a jump, where
a beat declines. A code, such as -999, is one and the same impossible number wherever it stands. Both become gaps. The
hum of the mains is one line of the spectrum, where beats have one for each of their harmonics. It is subtracted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from solver.errors import InputError
from solver.quantities.units import SIGNAL_UNITS, display_factor, of_signal

from .. import limits
from . import table
from .table import Array, Place


@dataclass(frozen=True)
class Kind:
    """What a channel measures: its noun, SI unit, the unit a sentence proposes, and the range of any artery."""

    noun: str
    unit: str
    example: str
    low: float = -np.inf
    high: float = np.inf


KINDS: dict[str, Kind] = {
    "P": Kind("pressure", SIGNAL_UNITS["P"], "mmHg", -1e5, 1e6),
    "Q": Kind("flow", SIGNAL_UNITS["Q"], "mL/s", -1.0, 1.0),
    "R": Kind("radius", SIGNAL_UNITS["R"], "mm", 1e-5, 0.2),
    "D": Kind("diameter", SIGNAL_UNITS["R"], "mm", 2e-5, 0.4),
}

TIME = Kind("time", "s", "s")


class UnusableRecord(InputError):
    """A file that can be read, and a recording that no fit can use."""


refuse = partial(table.refuse, error=UnusableRecord)  # a sample, or a column


def check_numbers(values: Array, title: str, place: Place) -> None:
    """Rejects infinite values and a channel of gaps only."""
    low, high = _extremes(values)
    if np.isinf(low) or np.isinf(high):
        why = "the value is infinite; leave the field empty for a gap"
        refuse(place, int(np.flatnonzero(np.isinf(values))[0]), title, why)
    if np.isnan(low):
        raise UnusableRecord(f"{place}: column {title!r}: it holds gaps only; remove the column.")


def constant_value(values: Array) -> float | None:
    """The value of a channel that does not pulsate, None of one that does."""
    low, high = _extremes(values)
    return high if high / 2.0 - low / 2.0 <= limits.FLAT * max(abs(low), abs(high)) / 2.0 else None  # lest it overflow


def without_plateaus(values: Array, name: str, title: str, place: Place, dt: float) -> tuple[Array, tuple[str, ...]]:
    """A channel with gaps where its sensor was saturated for a while, and notes on them. dt [s].

    Raises UnusableRecord where that is in most stretches of the longest beat.
    """
    kind, notes = KINDS[name.rpartition(".")[2]], list[str]()
    long, margin = max(1, round(limits.LONGEST / dt)), round(limits.AROUND / dt)
    while found := _plateaus(values, kind.noun):
        starts, stops, word, top = found
        at = f"it rests at its {word} value, {top * display_factor(kind.example):.6g} {kind.example}"
        if 2 * len(set(starts // long)) > len(values) / long:
            why = (
                f"the channel is clipped: {at}; widen the sensor's range, or leave these fields empty, or the channel "
                f'out: --map "{title}="'
            )
            refuse(place, int(starts[0]), title, why)
        values = values.copy()
        for start, stop in zip(starts, stops, strict=True):
            values[max(0, start - margin) : stop + margin] = np.nan
        notes.append(f"{name} was saturated for a while, {at}: these samples were taken for gaps.")
    return values, tuple(notes)


def _plateaus(values: Array, noun: str) -> tuple[Array, Array, str, float] | None:
    """Begins and ends of plateaus at an extreme that a sensor enters and leaves steeply, its word and value.

    Rounding makes plateaus too, but beside one of n samples a rounded smooth signal is a few quanta lower at n/4
    samples from it; noise makes none. A flow may rest at zero.
    """
    low, high = _extremes(values)
    for sign, top, word in ((1.0, high, "highest"), (-1.0, -low, "lowest")):
        if noun == "flow" and abs(top) < limits.VALVE * (high - low):
            continue
        if np.count_nonzero(values == sign * top) < limits.PLATEAU:
            continue
        y = sign * values
        start, stop = _runs(y == top)
        beside = np.maximum(2, (stop - start) // 4)
        whole = (stop - start >= limits.PLATEAU) & (start - beside >= 0) & (stop - 1 + beside < len(y))
        start, stop, beside = start[whole], stop[whole], beside[whole]
        fall = np.minimum(top - y[start - beside], top - y[stop - 1 + beside])
        there = np.isfinite(fall)
        steps = np.abs(np.diff(values))  # between neighbouring values: small for a continuous signal
        if there.any() and np.median(fall[there]) > limits.QUANTA * np.quantile(steps[steps > 0.0], 0.01):
            return start[there], stop[there], word, sign * top
    return None


def without_gaps(x: Array) -> Array:
    """x with straight lines over its gaps."""
    there = ~np.isnan(x)
    if there.all():
        return x
    index = np.arange(len(x))
    return np.interp(index, index[there], x[there])


def _runs(flags: Array) -> tuple[Array, Array]:
    """Begins and ends of the runs of samples that are flagged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2]


def _extremes(values: Array) -> tuple[float, float]:
    """Lowest and highest value that is not a gap; NaN if there is none."""
    return float(np.fmin.reduce(values)), float(np.fmax.reduce(values))


def check_ranges(channels: Mapping[str, Array], titles: Mapping[str, str], place: Place) -> None:
    """Rejects values that no artery has: the unit is wrong, or P and R of a site are swapped."""
    for name, values in channels.items():
        site, _, letter = name.rpartition(".")
        kind = KINDS[letter]
        if letter in "PR" and _swapped(channels.get(f"{site}.P"), channels.get(f"{site}.R")):
            refuse(place, None, titles[name], f"P and R of {site} seem swapped; exchange the two names")
        low, high = _extremes(values)
        if low < kind.low or high > kind.high:
            bad = int(np.flatnonzero((values < kind.low) | (values > kind.high))[0])
            factor = display_factor(kind.example)
            value, lowest, highest = (f"{factor * x:.4g}" for x in (float(values[bad]), kind.low, kind.high))
            why = (
                f"a {kind.noun} of {value} {kind.example} is outside {lowest} to {highest} {kind.example}, where those "
                "of all arteries lie; check the unit, or leave the field empty where the sensor failed"
            )
            refuse(place, bad, titles[name], why)


def _swapped(P: Array | None, R: Array | None) -> bool:
    """Whether P is a radius and R a pressure: out of range both, or R too wide for its small pressure and livelier."""
    if P is None or R is None:
        return False
    low, high = KINDS["R"].low, KINDS["R"].high
    (small, large), (narrow, wide) = _extremes(P), _extremes(R)
    middle = 0.5 * (narrow + wide)
    if low <= small and large <= high and (middle > high or middle < low):
        return True
    livelier = wide - narrow > middle * (large - small) / max(abs(small), abs(large))
    return bool(middle > limits.WIDE and 0.0 < small and large < 3e3 and livelier)


def converter_step(values: Array) -> float:
    """The step between neighbouring values of a digitised channel, 0 of one that is not.

    Differences of neighbouring samples are whole multiples of the smallest of them.
    """
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    if len(steps) < limits.STEP_FEWEST:
        return 0.0
    span = float(np.nanmax(values) - np.nanmin(values))
    step = float(np.quantile(steps, limits.STEP_SHARE))
    if not step > limits.STEP_FINEST * span:
        return 0.0
    near = steps[(steps > 0.5 * step) & (steps < limits.STEP_NEAR * step)]
    if len(near) < limits.STEP_FEWEST:
        return 0.0
    step = float(np.median(near / np.rint(near / step)))
    return step if np.quantile(np.abs(near / step - np.rint(near / step)), 0.9) < limits.STEP_WHOLE else 0.0


# --- what sensors record beside the artery ----------------------------------------------------------------------------


def without_codes(values: Array, name: str, scale: float) -> tuple[Array, tuple[str, ...]]:
    """A channel with gaps in place of the one impossible number that it holds, if all are the same; what was done.

    scale : SI over the unit of the file, in which the number is told.
    """
    kind = KINDS[name.rpartition(".")[2]]
    beyond = (values < kind.low) | (values > kind.high)
    count = int(np.count_nonzero(beyond))
    if not 1 < count < len(values) / 2 or np.ptp(values[beyond]) > 0.0:
        return values, ()
    said = (
        f"{name}: {count} samples are {values[beyond][0] / scale:.6g}, which no artery has; they were taken for gaps."
    )
    return np.where(beyond, np.nan, values), (said,)


def without_still(values: Array, name: str, dt: float, place: Place) -> tuple[Array, tuple[str, ...]]:
    """A channel with gaps where its sensor stood still, and what was done.

    Still is a stretch of STILL in which it varies by less than QUIET of its usual range over ANY_BEAT. Of a beat such
    may be the end of diastole, or a flow that rests, but not for ANY_BEAT; and the end of a diastole is reached at a
    decline, and lies in the range of the others. dt [s].
    Raises UnusableRecord where that is most of the record.
    """
    long, wide = round(limits.STILL / dt), round(limits.ANY_BEAT / dt)
    if long < limits.FEWEST_SAMPLES or len(values) < 2 * wide:
        return values, ()
    there, x = ~np.isnan(values), without_gaps(values)
    ranges = _range(x, wide)
    usual = float(np.median(ranges[ranges > 0.0])) if ranges.any() else 0.0
    quiet = max(limits.QUIET * usual, limits.STEPS * converter_step(values))  # rounded noise varies by two steps
    starts, stops = _runs(_range(x, long) < quiet)
    ends = np.minimum(stops - 1 + long, len(x))
    still = [(a, b) for a, b in zip(starts.tolist(), ends.tolist(), strict=True) if there[a:b].mean() > 0.5]
    beats = np.ones(len(x), bool)
    for start, stop in still:
        beats[start:stop] = False
    if usual == 0.0 or not still or not beats.any():
        return values, ()
    low, high = np.quantile(x[beats], limits.ORDINARY)
    rests, near = name.endswith(".Q"), round(limits.STEEP_FOR / dt)
    strange = [(a, b) for a, b in still if b - a >= wide or not rests and _strange(x, a, b, (low, high), usual, near)]
    if not strange:
        return values, ()
    found, margin = values.copy(), round(limits.AROUND / dt)
    for start, stop in strange:
        found[max(0, start - margin) : stop + margin] = np.nan
    share = float(np.isnan(found).mean())
    unit, shown = of_signal(name)
    levels = ", ".join(f"{shown * float(np.median(x[a:b])):.4g}" for a, b in strange[: limits.NAMED])
    where = f"{name} stands still at {levels} {unit} for {dt * sum(b - a for a, b in strange):.3g} s"
    if share > 0.5:
        raise UnusableRecord(f"{place}: {where}, most of the record; read the part where it was measured with --part.")
    return found, (f"{where}, as a sensor that is flushed, zeroed or dead: these samples were taken for gaps.",)


def without_hum(values: Array, name: str, dt: float) -> tuple[Array, tuple[str, ...]]:
    """A channel without the hum of the mains and its harmonics, where there is any, and what was done. dt [s].

    Left in, it would time upstrokes, and would be no noise of the mean beat, which is estimated from neighbouring
    harmonics: hum is in one of them. What no beat shows stays.
    """
    there, x, said = ~np.isnan(values), without_gaps(values), list[str]()
    for usual in sorted(k * mains for mains in limits.MAINS for k in range(1, limits.HUMS + 1)):
        f = _line(x, usual, dt)
        if f is None:
            continue
        hum = _hum(x, there, f, dt)
        size, (low, high) = float(np.sqrt(2.0 * np.mean(hum[there] ** 2))), np.quantile(x[there], limits.RANGE)
        if size < limits.VISIBLE * (high - low):
            continue
        x = x - hum
        unit, shown = of_signal(name)
        said.append(f"{shown * size:.2g} {unit} at {f:.4g} Hz")
    if not said:
        return values, ()
    return np.where(there, x, np.nan), (f"{name} has hum of the mains, {' and '.join(said)}: it was subtracted.",)


def _line(x: Array, f: float, dt: float) -> float | None:
    """The frequency of a line near f [Hz], None if there is none: it has AS_MUCH times the power of any other within
    the rate of the fastest heart, for of beats the next harmonics are nearly as high."""
    n = min(len(x), round(limits.SCREENED / dt))
    part = x[(len(x) - n) // 2 :][:n]
    power = np.abs(np.fft.rfft((part - part.mean()) * np.hanning(n))) ** 2
    at = np.fft.rfftfreq(n, dt)
    off, near = np.abs(at - f), limits.MAINS_OFF * f
    line, others = off <= near, (off > 2.0 * near) & (off <= 1.0 / limits.SHORTEST + 2.0 * near)
    # of less than HUM_FOLLOWED a line is wider than that: a Hann window makes it two bins of 1/(n dt)
    if f > 0.5 / dt - near or n * dt < limits.HUM_FOLLOWED or not others.any():
        return None
    top = int(np.where(line, power, -1.0).argmax())
    return float(at[top]) if power[top] > limits.AS_MUCH * float(power[others].max()) else None


def _hum(x: Array, there: Array, f: float, dt: float) -> Array:
    """The hum of x : (n,) at f [Hz], 0 in gaps. there : where x is none.

    Its amplitude and phase are the means of exp(-i 2 pi f t) times x, less the mean of x over a cycle, in a Hann window
    of HUM_FOLLOWED.
    """
    from scipy.signal import oaconvolve  # takes half a second

    number = np.arange(len(x))
    turn = np.exp(-2j * np.pi * f * dt * number)
    half = max(1, round(0.5 / (f * dt)))
    cycle = np.concatenate([[0.5], np.ones(2 * half - 1), [0.5]]) / (2.0 * half)
    kept = 1.0 - float(np.real(cycle @ turn[: len(cycle)] * turn[half].conj()))  # of the hum: 1 for a whole cycle
    fast = x - oaconvolve(np.pad(x, half, mode="reflect"), cycle, mode="valid")
    part = min(round(limits.HUM_FOLLOWED / dt), len(x) // 2)
    window = np.hanning(2 * (part // 2) + 3)[1:-1]
    level = oaconvolve(np.where(there, fast, 0.0) * turn, window, mode="same")
    weight = np.maximum(oaconvolve(there.astype(float), window, mode="same"), 1.0)  # each sample has its own, 1
    return np.where(there, 2.0 / kept * np.real(level * turn.conj()) / weight, 0.0)


def _range(x: Array, n: int) -> Array:
    """(N - n + 1,) the range of x : (N,) over each stretch of n samples."""
    high, low, covered = x, x, 1
    while covered < n:  # of stretches of ``covered`` samples, those that are longer by up to as much
        more = min(covered, n - covered)
        high, low = np.maximum(high[:-more], high[more:]), np.minimum(low[:-more], low[more:])
        covered += more
    return np.asarray(high - low)


def _strange(x: Array, start: int, stop: int, ordinary: tuple[float, float], usual: float, near: int) -> bool:
    """Whether a still stretch is none of a beat: beyond what beats reach, or reached in a jump."""
    level, (low, high) = float(np.median(x[start:stop])), ordinary
    if level < low - limits.BEYOND * usual or level > high + limits.BEYOND * usual:
        return True
    return start > near and abs(float(x[start - near]) - level) > limits.JUMP * usual
