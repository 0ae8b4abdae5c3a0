"""The source map for display: harmonics as beats with a band, parameters as values; plain frozen data.

The map precedes all effects of the catalogue (:mod:`fitting.inference.source_maps.source_map`). At some places an
unknown periodic term g(t) is added to the equations, or one of the subject's own parameters is an outlier of its kind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import Any

import numpy as np

from fitting.inference.fit import Array, Member
from fitting.inference.models.network import NetworkProblem
from fitting.inference.places import Place
from fitting.inference.source_maps.source_map import Rival, Signal, SourceMap
from fitting.inference.unknown import parameter_values
from fitting.records.alignment.beats import Beats
from solver.laws.effect import ALL_PLACES, OUTLET
from solver.mesh.sources import Drop, Source, Step, WallPressure
from solver.network.description import Network
from solver.quantities.coordinate import SCALE
from solver.quantities.units import INFLOW, SIGNAL_UNITS

from .. import thresholds

_SHAPES = ("uniform", "linear", "parabolic")  # by the degree of a wall's pressure
_SAMPLES = 400  # per beat: they resolve all harmonics of a record
_BEGUN = 0.1  # of the height of the inflow: systole is above it
_MID = 0.5  # of that height: mid systole is above it after the peak


@dataclass(frozen=True)
class OddNumber:
    """An outlying parameter: of the file and of this subject [unit].

    beyond : deviation from the common value of its kind, a factor, or a shift [unit] if not ``factor``.
    display : display unit, None for the usual one. only : the only parameter of its kind.
    """

    file: float
    value: float
    beyond: float
    factor: bool
    display: str | None = None
    only: bool = False


@dataclass(frozen=True)
class Acting:
    """The source at one place.

    unit : SI. mean, band : (N,) g at the times of the map and its standard deviation, for the source with the largest
    RMS if the place has several; ``sources`` is their number, ``part`` names that one. For an outlying parameter both
    are empty, and ``number`` is given. pulse : peak to peak of the measured ``channel`` at the place, or None.
    rivals : places that this record cannot distinguish from it, with nearly the same evidence in its stead; empty if
    the record is nearly as probable without it. share : of the gap, as χ²; None if not computed. phase : phase of the
    beat, by the inflow, with most of its energy, and its fraction of that (:func:`main_phase`).
    """

    place: Place
    unit: str
    mean: Array
    band: Array
    sources: int = 1
    part: str = ""
    channel: str = ""
    pulse: float | None = None
    number: OddNumber | None = None
    rivals: tuple[Rival, ...] = ()
    share: float | None = None
    phase: tuple[str, float] | None = None

    @property
    def rms(self) -> float:
        """RMS of g over a beat [unit], mean included."""
        return float(np.sqrt(np.mean(self.mean**2)))

    @property
    def steady(self) -> bool:
        """True if it hardly changes within a beat."""
        return float(np.ptp(self.mean)) < 0.2 * self.rms


@dataclass(frozen=True)
class SourceMapShown:
    """All sources of a map.

    time : (N,) [s] of one beat of the period T [s]. explains : no more than noise is left with them.
    chi2_per_datum : of the residual; 1 is noise. recording : the label of the recording to which the map
    belongs if there are several, else "".
    """

    acting: tuple[Acting, ...]
    time: Array
    T: float
    explains: bool
    chi2_per_datum: float
    recording: str = ""

    @property
    def left(self) -> dict[str, Any]:
        """The residual, in the form of verdict.json."""
        return {"chi2_per_datum": self.chi2_per_datum, "explains": self.explains}

    @property
    def signals(self) -> tuple[Acting, ...]:
        """The time-dependent sources, without outlying parameters."""
        return tuple(a for a in self.acting if a.number is None)


def map_json(shown: SourceMapShown) -> list[dict[str, Any]]:
    """The plain content of verdict.json for each place."""
    found = []
    for a in shown.acting:
        where = {"kind": a.place.kind, "where": a.place.name, "x": a.place.at, "label": a.place.label, "unit": a.unit}
        size = {"rms": a.rms} if a.number is None else {"rms": None, "value": a.number.value, "file": a.number.file}
        rivals = [{"labels": [place.label for place in rival.places], "above": rival.above} for rival in a.rivals]
        phase = a.phase and {"name": a.phase[0], "part": a.phase[1]}
        found.append({**where, **size, "share": a.share, "phase": phase, "rivals": rivals})
    return found


def shown_map(
    found: SourceMap, network: Network, beats: Beats, shares: Sequence[float] = (), recording: str = ""
) -> SourceMapShown:
    """The map of a record for display. beats : the fitted ones, with the pulse at a place and the phases of the beat.
    shares : of the gap, by place, if known. recording : its label, if there are several."""
    time = np.arange(_SAMPLES) * (beats.T / _SAMPLES)
    acting = tuple(
        replace(_acting(s, found, time, network, beats), rivals=_rivals(s.place, found), share=share)
        for s, share in zip(found.signals, shares or repeat(None, len(found.signals)), strict=False)
    )
    return SourceMapShown(acting, time, beats.T, found.explains, found.chi2 / found.n, recording)


def beat_of(g: Array, time: Array, T: float) -> Array:
    """(N, q) x(t) = g_0 + 2 Re Σ g_k exp(2πikt/T) at times (N,) [s] from harmonics g : (K+1, q)."""
    k = np.arange(1, len(g))
    turn = np.exp(2j * np.pi * np.mod(np.multiply.outer(time / T, k), 1.0))
    return np.asarray(g[0].real + 2.0 * (turn @ g[1:]).real)


def band_of(sd: Array, n: int) -> Array:
    """(n, q) standard deviation of that beat, constant in time: sqrt(sd_0² + 4 Σ sd_k²).

    sd : (K+1, q) of the real mean, and of the independent real and imaginary parts of each harmonic: 2 Re(g_k e^iφ) has
    the variance 4 sd_k² for every φ.
    """
    return np.broadcast_to(np.sqrt(sd[0] ** 2 + 4.0 * (sd[1:] ** 2).sum(axis=0)), (n, sd.shape[1]))


def _acting(signal: Signal, found: SourceMap, time: Array, network: Network, beats: Beats) -> Acting:
    """The signal at a place, or the value of its parameter."""
    place = signal.place
    if place.unknown is not None:
        unit, odd = _number(place, found, network)
        return Acting(place, unit, np.zeros(0), np.zeros(0), number=odd)
    each = beat_of(signal.g, time, beats.T)
    largest = int(np.argmax((each**2).mean(axis=0)))
    unit = place.sources[largest].unit if place.sources else SIGNAL_UNITS[place.name[-1]]
    channel = _channel(place, largest, unit, network, beats)
    part = _part(place.sources[largest]) if place.columns > 1 else ""
    pulse = float(np.ptp(beats.mean(channel))) if channel else None
    g, band = each[:, largest], band_of(signal.sd, len(each))[:, largest]
    phase = main_phase(g, beats.mean(INFLOW))
    return Acting(place, unit, g, band, place.columns, part, channel, pulse, phase=phase)


def _number(place: Place, found: SourceMap, network: Network) -> tuple[str, OddNumber]:
    """The value of an outlying parameter, beside the common value of its kind."""
    i = [u.name for u in found.unknowns].index(place.unknown.name if place.unknown else "")
    own, step = found.unknowns[i], found.unknowns[i].size * float(found.x[i])
    value = float(parameter_values(found.unknowns, network, found.x)[place.name])
    file, quantity = network.parameters()[place.name], network.parameter_quantities()[place.name]
    factor, kind = own.kind == SCALE, place.name.partition(".")[2]
    same = {name for u in found.unknowns for name in u.variables if name.partition(".")[2] == kind}
    beyond = math.exp(step) if factor else step
    return quantity.unit, OddNumber(file, value, beyond, factor, quantity.display, len(same) == 1)


def _part(source: Source) -> str:
    """The name of one of several sources of a place."""
    match source:
        case WallPressure(place=name, degree=degree):
            return f"{_SHAPES[degree]} along {name}"
        case Step(place=name):
            return f"between {name} and the junction"
        case Drop(place=name, start=0.0, end=1.0):
            return f"along {name}"
        case Drop(place=name, start=start, end=end):
            return f"between x/L = {start:g} and {end:g} of {name}"
    return f"of {source.place}"


def _channel(place: Place, i: int, unit: str, network: Network, beats: Beats) -> str:
    """The nearest measured channel that shows the quantity of a source at a place; "" if there is none."""
    if not place.sources or place.name == INFLOW:
        return place.name if place.name in beats.values else ""
    x = 1.0 if place.kind == OUTLET else 0.5 if place.at is None else place.at
    letter = next(key for key, each in SIGNAL_UNITS.items() if each == unit)
    there = sorted((s for s in network.sites if s.segment == place.sources[i].place), key=lambda s: abs(s.position - x))
    names = [f"{site.name}.{letter}" for site in there if place.name != ALL_PLACES]
    return next((name for name in names if name in beats.values), "")


def _rivals(place: Place, found: SourceMap) -> tuple[Rival, ...]:
    """Alternatives to a place: the places that replace it in sets of nearly the same evidence."""
    known = {p.key for p in found.places}
    return tuple(
        Rival(tuple(p for p in rival.places if p.key not in known), rival.above)
        for rival in found.rivals
        if rival.above < thresholds.RULED_OUT and place.key not in {p.key for p in rival.places}
    )


# --- how much of the gap acts there, and when -------------------------------------------------------------------------


def gap_shares(problem: NetworkProblem, found: SourceMap) -> tuple[float, ...]:
    """The share of the gap, as χ², of every place of a map, in the order of its signals.

    Let y be the whitened residual of the map's walls alone, and y_i that of the walls with place i alone. Place i
    removes c_i = y - y_i, and its share is yᵀc_i/|y|²; the shares of all places and of the residual add up to 1. A
    share is negative if the place compensates another one. Empty if a simulation breaks down.
    """
    at = problem.at((), found.unknowns, found.x)

    def residual(*which: int) -> Array | None:
        there = found.standing_out(which)
        (X,) = found.forced(at, which).observe([Member((), there.unknowns, there.x)])
        return None if X is None else at.residual(X)

    y, each = residual(), [residual(i) for i in range(len(found.signals))]
    if y is None or any(alone is None for alone in each):
        return ()
    return tuple(float(y @ (y - alone) / (y @ y)) for alone in each if alone is not None)


def phases_of(inflow: Array) -> Mapping[str, Array]:
    """(N,) masks of the phases of a beat, from the mean inflow : (N,) at even times of the beat.

    Its height h is measured from its least value, or from 0 if that is negative. Systole is the interval around the
    peak with h > 0.1 of the peak's: early systole up to the peak, mid systole after it while h >= 0.5 of the peak's,
    then late systole. The rest of the beat is diastole.
    """
    h = inflow - max(float(inflow.min()), 0.0)
    n, peak = len(h), int(np.argmax(h))
    there, level = np.roll(h, -peak), float(h[peak])  # the peak first
    low = np.flatnonzero(there <= _BEGUN * level)
    end, begin = int(low[0]), int(low[-1]) + 1  # the least value is one of them
    k = np.arange(n)
    fallen = int(np.flatnonzero(np.append(there[:end] < _MID * level, True))[0])
    parts = {
        "early systole": (k >= begin) | (k == 0),
        "mid systole": (k > 0) & (k < fallen),
        "late systole": (k >= fallen) & (k < end),
        "diastole": (k >= end) & (k < begin),
    }
    return {name: np.roll(part, peak) for name, part in parts.items()}


def main_phase(g: Array, inflow: Array) -> tuple[str, float]:
    """The phase of the beat with most of ∫ g² dt, and its fraction of that.

    g : (M,) at even times of the beat. inflow : (N,) likewise.
    """
    wave = np.interp(np.arange(len(g)) / len(g), np.arange(len(inflow)) / len(inflow), inflow, period=1.0)
    energy = {name: float((g[there] ** 2).sum()) for name, there in phases_of(wave).items()}
    name = max(energy, key=lambda each: energy[each])
    return name, energy[name] / max(sum(energy.values()), 1e-300)
