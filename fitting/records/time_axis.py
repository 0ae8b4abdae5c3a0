"""The uniform time axis behind the printed times of a record."""

from __future__ import annotations

import numpy as np

from .sensors import UnusableRecord, refuse
from .tables.table import Place

Array = np.ndarray

_SHORTEST = 8  # samples
_LATEST = 1e10  # [s], times since 1970 included
_DOUBLE, _SINGLE = 2.3e-16, 1.2e-7  # relative rounding of numbers of 8 and of 4 bytes


def uniform(given: Array, factor: float, title: str, place: Place) -> Array:
    """The uniform time axis [s] behind printed times: the straight line through them.

    A printed time may be off by a unit of its last decimal, or of the last of its significant digits (%.6g): rounded it
    is off by half of one, cut off by a whole one, and a product such as 7 * 0.005 may lie on either side of a digit. Or
    by the rounding of single precision, if all are such numbers. Never by a quarter of a step where one is half as long
    again as the others: a lost sample bends the line by half a step. The unit must be less than half a step, else such
    a step tells nothing.
    """
    n = len(given)
    bad = np.flatnonzero(~np.isfinite(given))
    if len(bad):
        refuse(place, int(bad[0]), title, "the time is missing or not finite; every sample needs its time")
    if n < _SHORTEST:
        raise UnusableRecord(f"{place}: {n} samples are too few; a record holds several beats.")
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.diff(given)
        span = given[-1] - given[0]
        longest = max(abs(given[0]), abs(given[-1])) * factor
    if not (np.isfinite(span) and longest < _LATEST):
        refuse(place, 0, title, f"times beyond {_LATEST:g} s; check the unit, or start the record at zero")
    bad = np.flatnonzero(step <= 0.0)
    if len(bad):
        refuse(
            place, int(bad[0]) + 1, title, f"the time does not increase ({given[bad[0]]:g} to {given[bad[0] + 1]:g})"
        )
    index = np.arange(n) - (n - 1) / 2.0
    dt = (given - given[0]) @ index / (index @ index)
    line = given[0] + np.mean(given - given[0]) + dt * index
    decimal = _last_decimal(given)
    rounding = decimal + 1e-6 * dt + _DOUBLE * np.abs(given).max()
    worst = np.abs(given - line).max()
    if worst > rounding:
        rounding = max(rounding, _last_digit(given))
    if worst > rounding and _single(given):
        rounding += _SINGLE * np.abs(given).max()
    whole = rounding < 0.5 * dt and step.max() < 1.5 * dt  # no sample lost
    if not dt > 0.0 or worst > min(rounding, 0.5 * dt if whole else 0.25 * dt):
        usual = float(np.median(step))
        off = np.abs(step - usual)
        first = np.flatnonzero(off > min(max(1.01 * decimal, 2.0 * rounding), 0.999 * off.max()))
        at = int(first[0]) if len(first) else int(off.argmax())
        advice = "print the time with more decimals, " if 2.0 * decimal >= dt else ""
        why = (
            f"the sampling is not uniform: a step of {step[at]:.6g} where the usual one is {usual:.6g}; "
            f"{advice}resample the record, or fill lost samples with empty fields"
        )
        refuse(place, at + 1, title, why)
    return line * factor


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
