"""Where beats begin: the upstrokes of a channel, found without the assumption that they come at equal intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

_NEAREST = 0.4  # of the period: two upstrokes are no closer
_RISE = 0.4  # of the usual upstroke's steepness, from which a rise is an upstroke
_WIDE = 0.08  # of the period: means on either side whose difference is the rise; the one after a notch is shorter
_SMOOTH = 0.04  # of the period, over which samples are averaged before slopes are taken
_BEFORE, _AFTER = 0.12, 0.28  # of the period: the part of a beat that tells its time
_SEARCHED = 0.08  # of the period, by which an upstroke may come earlier or later than its steepest sample says
_FLAT = 0.1  # of the steepest slope: where the foot is
_FEWEST = 3  # upstrokes
_SURE = 0.7  # of the usual likeness: what is less alike is an artefact


@dataclass(frozen=True)
class Upstrokes:
    """at : (n,) samples, fractions included, in order; likeness : (n,) correlation of each with their mean."""

    channel: str
    at: Array
    likeness: Array


def find_upstrokes(channels: Mapping[str, Array], length: float) -> Upstrokes | None:
    """The upstrokes of the channel whose upstrokes are most alike; length : samples a beat, or a multiple of it.

    None if no channel has three.
    """
    found = [each for name, x in channels.items() if (each := _of(name, x, length)) is not None]
    return max(found, key=lambda each: (round(float(np.median(each.likeness)), 2), len(each.at)), default=None)


def _of(name: str, values: Array, length: float) -> Upstrokes | None:
    x = without_gaps(values)
    at = _steepest(x, length)
    if len(at) < _FEWEST:
        return None
    length = float(np.median(np.diff(at)))  # a multiple no longer
    at = _steepest(x, length)
    before, after, most = (max(2, round(part * length)) for part in (_BEFORE, _AFTER, _SEARCHED))
    at = at[(at >= before + most) & (at < len(x) - after - most)].astype(float)
    if len(at) < _FEWEST:
        return None
    for _ in range(2):
        windows = np.stack([x[round(p) - before : round(p) + after] for p in at])
        moved = [_best(x, round(p), windows.mean(axis=0), before, after, most) for p in at]
        at = np.clip([p for p, _ in moved], before + most, len(x) - after - most - 1)
    likeness = np.array([each for _, each in moved])
    gaps = np.concatenate([[0], np.cumsum(np.isnan(values))])
    around = np.rint(at).astype(int)
    sure = (likeness >= _SURE * np.median(likeness)) & (gaps[around + after] == gaps[around - before])
    return Upstrokes(name, at[sure], likeness[sure]) if sure.sum() >= _FEWEST else None


def _steepest(x: Array, length: float) -> Array:
    """Samples about which x rises most, one a beat."""
    half = max(1, round(_WIDE * length))
    total = np.concatenate([[0.0], np.cumsum(x)])
    j = np.arange(half, len(x) - half)
    rise = total[j + half] - 2.0 * total[j] + total[j - half]
    block = max(1, round(length))
    blocks = [rise[i : i + block].max() for i in range(0, max(1, len(rise) - block + 1), block)] if len(rise) else []
    if not blocks:
        return np.zeros(0, int)
    from scipy.signal import find_peaks  # takes half a second

    peaks, _ = find_peaks(rise, height=_RISE * float(np.median(blocks)), distance=max(1, round(_NEAREST * length)))
    return np.asarray(peaks + half)


def _best(x: Array, p: int, template: Array, before: int, after: int, most: int) -> tuple[float, float]:
    """Where within ``most`` samples of p the template fits best, and the correlation there."""
    windows = np.lib.stride_tricks.sliding_window_view(x[p - before - most : p + after + most], before + after)
    windows = windows - windows.mean(axis=1, keepdims=True)
    template = template - template.mean()
    size = np.linalg.norm(windows, axis=1) * np.linalg.norm(template)
    r = windows @ template / np.maximum(size, np.finfo(float).tiny)
    best = int(r.argmax())
    offset = 0.0
    if 0 < best < len(r) - 1:
        bend = r[best - 1] - 2.0 * r[best] + r[best + 1]
        offset = 0.5 * (r[best - 1] - r[best + 1]) / bend if bend < 0.0 else 0.0
    return p - most + best + offset, float(r[best])


def lead(channels: Mapping[str, Array], at: Array, length: float) -> int:
    """Samples from an upstroke back to where, in the first of the channels, it begins: the end of diastole."""
    reach = round(0.45 * length)
    inside = np.rint(at[(at > reach + 1) & (at + reach < len(next(iter(channels.values()))) - 1)]).astype(int)
    leads = []
    for x in channels.values():
        filled = without_gaps(x)
        mean = np.mean([filled[p - reach : p + reach] for p in inside], axis=0)
        width = max(1, round(0.5 * _SMOOTH * length))
        slope = np.convolve(np.gradient(mean), np.ones(width) / width, mode="same")
        middle = slice(reach - reach // 2, reach + reach // 2)
        steepest = middle.start + int(slope[middle].argmax())
        flat = np.flatnonzero(slope[:steepest] < _FLAT * slope[steepest])
        leads.append(reach - (int(flat[-1]) if len(flat) else 0))
    return max(leads)


def without_gaps(x: Array) -> Array:
    """x with straight lines over its gaps."""
    there = ~np.isnan(x)
    if there.all():
        return x
    index = np.arange(len(x))
    return np.interp(index, index[there], x[there])
