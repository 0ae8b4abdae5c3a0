"""What a sensor recorded beside the artery: while it was flushed, zeroed or calibrated, codes for none, and hum.

A line that is flushed or open to the air stands still for longer than any beat does, and it gets there in a jump, where
a beat declines. A code, such as -999, is one and the same impossible number wherever it stands. Both become gaps. The
hum of the mains is one line of the spectrum, where beats have one for each of their harmonics. It is subtracted.
"""

from __future__ import annotations

import numpy as np

from solver.quantities.units import of_signal

from .. import limits
from .sensors import KINDS, UnusableRecord, converter_step
from .table import Array, Place


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
    there = ~np.isnan(values)
    x = values if there.all() else np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])
    ranges = _range(x, wide)
    usual = float(np.median(ranges[ranges > 0.0])) if ranges.any() else 0.0
    quiet = max(limits.QUIET * usual, limits.STEPS * converter_step(values))  # rounded noise varies by two steps
    still = [(a, b) for a, b in _stretches(_range(x, long) < quiet, long, len(x)) if there[a:b].mean() > 0.5]
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
    there, said = ~np.isnan(values), list[str]()
    x = values if there.all() else np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])
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


def _stretches(quiet: Array, n: int, length: int) -> list[tuple[int, int]]:
    """Begin and end of what stretches of n samples cover that begin where ``quiet``."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(np.int8)))
    return [(int(a), min(int(b) - 1 + n, length)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _strange(x: Array, start: int, stop: int, ordinary: tuple[float, float], usual: float, near: int) -> bool:
    """Whether a still stretch is none of a beat: beyond what beats reach, or reached in a jump."""
    level, (low, high) = float(np.median(x[start:stop])), ordinary
    if level < low - limits.BEYOND * usual or level > high + limits.BEYOND * usual:
        return True
    return start > near and abs(float(x[start - near]) - level) > limits.JUMP * usual
