"""The results that a study keeps of a beat: numbers at each site, and the waves of pressure and flow at 100 points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from solver.quantities.units import SIGNAL_UNITS

Array = np.ndarray

POINTS = 100  # of a kept beat, at times j T/100
WAVES = ("P", "Q")


def largest(beat: Array) -> Array:
    """The maximum of a periodic beat (…, N), by a parabola through the largest sample and its neighbours."""
    at = np.argmax(beat, axis=-1, keepdims=True)
    before, top, after = (np.take_along_axis(beat, (at + i) % beat.shape[-1], -1)[..., 0] for i in (-1, 0, 1))
    slope, bend = (after - before) / 2.0, 2.0 * top - before - after  # ≥ 0
    lift = np.divide(slope**2, 2.0 * bend, out=np.zeros_like(top), where=bend > 0.0)
    return np.asarray(top + lift)


def smallest(beat: Array) -> Array:
    """The minimum of a periodic beat, as :func:`largest`."""
    return -largest(-beat)


def _mean(beat: Array) -> Array:
    return np.asarray(beat.mean(axis=-1))


def _pulse(beat: Array) -> Array:
    return largest(beat) - smallest(beat)


# signal -> name of the number -> its function of a beat (…, N) [SI]
MEASURES: Mapping[str, Mapping[str, Callable[[Array], Array]]] = {
    "P": {"systolic": largest, "diastolic": smallest, "mean": _mean, "pulse": _pulse},
    "Q": {"mean": _mean, "max": largest, "min": smallest},
    "R": {"mean": _mean, "distension": _pulse},
}


def measures(sites: Sequence[str], signals: Sequence[str]) -> dict[str, str]:
    """The numbers of a study by name, ``CA.P.systolic``, and their SI units. signals : outputs of the model."""
    return {
        f"{site}.{signal}.{name}": SIGNAL_UNITS[signal]
        for site in sites
        for signal, numbers in MEASURES.items()
        if f"{site}.{signal}" in signals
        for name in numbers
    }


def measured(name: str, beats: Mapping[str, Array]) -> Array:
    """A number by its name, of beats (…, N) by channel [SI]."""
    channel, _, number = name.rpartition(".")
    return MEASURES[channel[-1]][number](beats[channel])
