"""The source map as it is shown: harmonics become beats with a band, numbers get their values; plain frozen data.

Found before any effect of the catalogue is asked for (:mod:`fitting.inference.source_maps.source_map`): at some places
an unknown periodic term g(t) is added to the equations, or one of the subject's own numbers stands out from its kind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np

from fitting.inference.fit import Member
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

Array = np.ndarray

_SHAPES = ("uniform", "linear", "parabolic")  # by the degree of a wall's pressure
_SAMPLES = 400  # of a beat: all harmonics of a record are smooth on them
_BEGUN = 0.1  # of the height of the inflow: systole is where it is more
_MID = 0.5  # of that height: after the peak and above it, mid systole


@dataclass(frozen=True)
class OddNumber:
    """A number that stands out: the file's and this subject's [unit].

    beyond : what it differs by from what all of its kind have in common, a factor, or a shift [unit] if not ``factor``.
    display : the unit that people read it in, or None for the usual one. only : the only one of its kind.
    """

    file: float
    value: float
    beyond: float
    factor: bool
    display: str | None = None
    only: bool = False


@dataclass(frozen=True)
class Acting:
    """What acts at one place.

    unit : SI. mean, band : (N,) g at the times of the map and its standard deviation, of the source with the largest
    RMS where the place has several; ``sources`` says how many, ``part`` which of them. Of a number that stands out
    both are empty, and ``number`` is given. pulse : peak to peak of what was measured there, of ``channel``; or None.
    rivals : what this record cannot tell it from: the places that do nearly the same in its place, none where the
    record is nearly as probable without it. share : of the gap, as χ², that acts there; None where that was not asked.
    phase : of the beat, by the inflow, with most of its energy, and the part of it that it has (:func:`main_phase`).
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
        """Of g over a beat [unit], its mean included."""
        return float(np.sqrt(np.mean(self.mean**2)))

    @property
    def steady(self) -> bool:
        """Whether it hardly changes within a beat."""
        return float(np.ptp(self.mean)) < 0.2 * self.rms


@dataclass(frozen=True)
class SourceMapShown:
    """Everything that acts.

    time : (N,) [s] of one beat of the period T [s]. explains : whether no more than noise is left with it.
    chi2_per_datum : what is left; 1 is noise.
    """

    acting: tuple[Acting, ...]
    time: Array
    T: float
    explains: bool
    chi2_per_datum: float

    @property
    def left(self) -> dict[str, Any]:
        """What is left, as verdict.json has it."""
        return {"chi2_per_datum": self.chi2_per_datum, "explains": self.explains}

    @property
    def signals(self) -> tuple[Acting, ...]:
        """Those that act in time: not numbers that stand out."""
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


def shown_map(found: SourceMap, network: Network, beats: Beats, shares: Sequence[float] = ()) -> SourceMapShown:
    """What a map says of a record. beats : those that were fitted, whose channels tell the pulse at a place, and the
    phases of the beat. shares : of the gap, by place, where they are known."""
    time = np.arange(_SAMPLES) * (beats.T / _SAMPLES)
    acting = tuple(
        Acting(s.place, rivals=_rivals(s.place, found), share=share, **_told(s, found, time, network, beats))
        for s, share in zip(found.signals, shares or repeat(None, len(found.signals)), strict=False)
    )
    return SourceMapShown(acting, time, beats.T, found.explains, found.chi2 / found.n)


def beat_of(g: Array, time: Array, T: float) -> Array:
    """(N, q) x(t) = g_0 + 2 Re Σ g_k exp(2πikt/T) at times (N,) [s] of harmonics g : (K+1, q)."""
    k = np.arange(1, len(g))
    turn = np.exp(2j * np.pi * np.mod(np.multiply.outer(time / T, k), 1.0))
    return np.asarray(g[0].real + 2.0 * (turn @ g[1:]).real)


def band_of(sd: Array, n: int) -> Array:
    """(n, q) standard deviation of that beat, the same at every time: sqrt(sd_0² + 4 Σ sd_k²).

    sd : (K+1, q) of the real mean, and of the real and of the imaginary part of each harmonic, which are independent:
    2 Re(g_k e^iφ) has the variance 4 sd_k² whatever φ.
    """
    return np.broadcast_to(np.sqrt(sd[0] ** 2 + 4.0 * (sd[1:] ** 2).sum(axis=0)), (n, sd.shape[1]))


def _told(signal: Signal, found: SourceMap, time: Array, network: Network, beats: Beats) -> dict[str, Any]:
    """What acts at a place, or which value its number has."""
    place = signal.place
    if place.unknown is not None:
        unit, odd = _number(place, found, network)
        return {"unit": unit, "mean": np.zeros(0), "band": np.zeros(0), "number": odd}
    each = beat_of(signal.g, time, beats.T)
    largest = int(np.argmax((each**2).mean(axis=0)))
    unit = place.sources[largest].unit if place.sources else SIGNAL_UNITS[place.name[-1]]
    channel = _channel(place, largest, unit, network, beats)
    return {
        "unit": unit,
        "mean": each[:, largest],
        "band": band_of(signal.sd, len(each))[:, largest],
        "sources": place.columns,
        "part": _part(place.sources[largest]) if place.columns > 1 else "",
        "channel": channel,
        "pulse": float(np.ptp(beats.mean(channel))) if channel else None,
        "phase": main_phase(each[:, largest], beats.mean(INFLOW)),
    }


def _number(place: Place, found: SourceMap, network: Network) -> tuple[str, OddNumber]:
    """The value of a number that stands out, beside what all of its kind have in common."""
    i = [u.name for u in found.unknowns].index(place.unknown.name if place.unknown else "")
    own, step = found.unknowns[i], found.unknowns[i].size * float(found.x[i])
    value = float(parameter_values(found.unknowns, network, found.x)[place.name])
    file, quantity = network.parameters()[place.name], network.parameter_quantities()[place.name]
    factor, kind = own.kind == SCALE, place.name.partition(".")[2]
    same = {name for u in found.unknowns for name in u.variables if name.partition(".")[2] == kind}
    beyond = math.exp(step) if factor else step
    return quantity.unit, OddNumber(file, value, beyond, factor, quantity.display, len(same) == 1)


def _part(source: Source) -> str:
    """Which of several sources of a place."""
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
    """The measured channel that shows the same quantity at a place, the nearest of several; "" where there is none."""
    if not place.sources or place.name == INFLOW:
        return place.name if place.name in beats.values else ""
    x = 1.0 if place.kind == OUTLET else 0.5 if place.at is None else place.at
    letter = next(key for key, each in SIGNAL_UNITS.items() if each == unit)
    there = sorted((s for s in network.sites if s.segment == place.sources[i].place), key=lambda s: abs(s.position - x))
    names = [f"{site.name}.{letter}" for site in there if place.name != ALL_PLACES]
    return next((name for name in names if name in beats.values), "")


def _rivals(place: Place, found: SourceMap) -> tuple[Rival, ...]:
    """What this record cannot tell from a place: what stands in its stead in sets that are nearly as probable."""
    known = {p.key for p in found.places}
    return tuple(
        Rival(tuple(p for p in rival.places if p.key not in known), rival.above)
        for rival in found.rivals
        if rival.above < thresholds.RULED_OUT and place.key not in {p.key for p in rival.places}
    )


# --- how much of the gap acts there, and when -------------------------------------------------------------------------


def gap_shares(problem: NetworkProblem, found: SourceMap) -> tuple[float, ...]:
    """The share of the gap, as χ², that acts at every place of a map, in the order of its signals.

    With the whitened residual y of the map's walls alone and y_i of these with place i alone, place i takes c_i = y -
    y_i out of it, and its share is yᵀc_i/|y|²: those of all places and of what is left add up to 1. A place may have
    less than 0, where it makes good what another one does. Empty where a simulation breaks down.
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
    """(N,) where each phase of a beat is, by the mean inflow : (N,) at even times of the beat.

    Its height h is counted from its least value, or from 0 where that is negative. Systole is the stretch around the
    peak where h > 0.1 of the peak's: early systole up to the peak, mid systole after it while h >= 0.5 of the peak's,
    late systole what follows. The rest of the beat is diastole.
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
    """The phase of the beat with most of ∫ g² dt, and the part of it that it has.

    g : (M,) at even times of the beat. inflow : (N,) likewise.
    """
    wave = np.interp(np.arange(len(g)) / len(g), np.arange(len(inflow)) / len(inflow), inflow, period=1.0)
    energy = {name: float((g[there] ** 2).sum()) for name, there in phases_of(wave).items()}
    name = max(energy, key=lambda each: energy[each])
    return name, energy[name] / max(sum(energy.values()), 1e-300)
