"""What a channel of a record may be, and the channels that no fit can use: dead, clipped, out of range, swapped.

A flow alone may be constant, for an outlet may be closed; it is then no channel of the record, see ``Record.resting``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from solver.errors import InputError
from solver.quantities.units import SIGNAL_UNITS, display_factor

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
        edges = np.flatnonzero(np.diff(np.concatenate([[False], y == top, [False]]).astype(np.int8)))
        start, stop = edges[::2], edges[1::2]
        beside = np.maximum(2, (stop - start) // 4)
        whole = (stop - start >= limits.PLATEAU) & (start - beside >= 0) & (stop - 1 + beside < len(y))
        start, stop, beside = start[whole], stop[whole], beside[whole]
        fall = np.minimum(top - y[start - beside], top - y[stop - 1 + beside])
        there = np.isfinite(fall)
        steps = np.abs(np.diff(values))  # between neighbouring values: small for a continuous signal
        if there.any() and np.median(fall[there]) > limits.QUANTA * np.quantile(steps[steps > 0.0], 0.01):
            return start[there], stop[there], word, sign * top
    return None


def _extremes(values: Array) -> tuple[float, float]:
    """Lowest and highest value that is not a gap; NaN if there is none."""
    low, high = float(values.min()), float(values.max())
    if np.isnan(low):  # gaps are rare, so look for them only where they show
        values = values[~np.isnan(values)]
        low, high = (float(values.min()), float(values.max())) if len(values) else (np.nan, np.nan)
    return low, high


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
