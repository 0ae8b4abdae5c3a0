"""How much of the gap acts at each place of the source map, and when in the beat."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fitting.inference.fit import Member
from fitting.inference.network import NetworkProblem
from fitting.inference.source_map import SourceMap

Array = np.ndarray

_BEGUN = 0.1  # of the height of the inflow: systole is where it is more
_MID = 0.5  # of that height: after the peak and above it, mid systole


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
