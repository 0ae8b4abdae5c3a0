"""Samples at which a sensor did not measure the artery: while it was flushed, zeroed or calibrated, and codes for none.

A line that is flushed or open to the air stands still for longer than any beat does, and it gets there in a jump, where
a beat declines. A code, such as -999, is one and the same impossible number wherever it stands. Both become gaps.
"""

from __future__ import annotations

import numpy as np

from solver.quantities.units import of_signal

from .. import limits as limit
from .sensors import KINDS, UnusableRecord, converter_step
from .table import Place

Array = np.ndarray


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
    long, wide = round(limit.STILL / dt), round(limit.ANY_BEAT / dt)
    if long < limit.FEWEST_SAMPLES or len(values) < 2 * wide:
        return values, ()
    there = ~np.isnan(values)
    x = values if there.all() else np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])
    ranges = _range(x, wide)
    usual = float(np.median(ranges[ranges > 0.0])) if ranges.any() else 0.0
    quiet = max(limit.QUIET * usual, limit.STEPS * converter_step(values))  # rounded noise varies by two steps
    still = [(a, b) for a, b in _stretches(_range(x, long) < quiet, long, len(x)) if there[a:b].mean() > 0.5]
    beats = np.ones(len(x), bool)
    for start, stop in still:
        beats[start:stop] = False
    if usual == 0.0 or not still or not beats.any():
        return values, ()
    low, high = np.quantile(x[beats], limit.ORDINARY)
    rests, near = name.endswith(".Q"), round(limit.STEEP_FOR / dt)
    strange = [(a, b) for a, b in still if b - a >= wide or not rests and _strange(x, a, b, (low, high), usual, near)]
    if not strange:
        return values, ()
    found, margin = values.copy(), round(limit.AROUND / dt)
    for start, stop in strange:
        found[max(0, start - margin) : stop + margin] = np.nan
    share = float(np.isnan(found).mean())
    unit, shown = of_signal(name)
    levels = ", ".join(f"{shown * float(np.median(x[a:b])):.4g}" for a, b in strange[: limit.NAMED])
    where = f"{name} stands still at {levels} {unit} for {dt * sum(b - a for a, b in strange):.3g} s"
    if share > 0.5:
        raise UnusableRecord(f"{place}: {where}, most of the record; cut the file to where it was measured.")
    return found, (f"{where}, as a sensor that is flushed, zeroed or dead: these samples were taken for gaps.",)


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
    if level < low - limit.BEYOND * usual or level > high + limit.BEYOND * usual:
        return True
    return start > near and abs(float(x[start - near]) - level) > limit.JUMP * usual
