"""A state to start from that is near the periodic one, so that nobody waits ten beats for it.

It is that of the harmonic balance (:mod:`~solver.balance`) after a few corrections. Waves so large that the state would
not be physical are left out: it is then the steady one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .balance import Drive, Waves, balanced, spectrum, steady, storable
from .scheme.guards import NonPhysicalState, check
from .scheme.model import Model
from .scheme.sdirk import SDIRK3
from .scheme.step import State
from .sources import Forcing

Array = np.ndarray

_MOST, _FEWEST = 32, 4  # harmonics
_CORRECTIONS = 6
_SMALL = 1e-4  # a correction of this part of the waves is the last


def periodic_state(model: Model, drive: Drive, T: float, t: float = 0.0, dt: float | None = None) -> State:
    """A state at time t [s] near that of the beats which repeat under what drives the inlet.

    drive : Q(t) [m³/s] for an array of times, or P(t) [Pa] where the inlet's causality is pressure; (n,) or of each
    member (n, B); of several inlets (n, n_inlets) or (n, n_inlets, B). T : its period [s]. dt : the step [s] to come,
    default the settings'.
    Raises ValueError where the network has no steady state with the mean of the drive.
    """
    harmonics = spectrum(model, drive, T, int(np.clip(storable(model), _FEWEST, _MOST)), t)
    with np.errstate(all="ignore"):
        rest = steady(model, harmonics[0].real)
        forcing = Forcing.of(model, *model.tables.beside((), None, T, len(harmonics), t), len(harmonics))
        waves, _ = balanced(model, rest, harmonics, T, _SMALL, _CORRECTIONS, forcing=forcing)
        return _state(model, waves, rest, t, dt or model.settings.dt)


def _state(model: Model, waves: Waves, rest: State, t: float, dt: float) -> State:
    """The state at the start of the period, with the stage values from which the next steps are guessed."""
    layout, at = model.layout, dt * SDIRK3.sum(axis=1)
    (y, H), (rate, _) = waves.at(0.0), waves.at(0.0, derivative=True)
    A_t = layout.part(rate, "A").copy()
    try:
        check(model, layout.part(y, "A"), A_t, layout.part(y, "Q"), t)
    except NonPhysicalState:
        return replace(rest, t=t)
    unknowns, before = (_stage_values(waves, rest, at - n * dt) for n in (1, 2))
    return replace(rest, t=t, y=y, H=H, A_t=A_t, unknowns=unknowns, unknowns_before=before, dt=dt)


def _stage_values(waves: Waves, rest: State, times: Array) -> Array:
    """∂Q/∂t and H at the times [s] of the stages of a step : (STAGES, B, m)."""
    found = []
    for s in times:
        (rates, _), (_, H) = waves.at(s, derivative=True), waves.at(s)
        found.append(rest.guess.join(rest.layout.part(rates, "Q"), H))
    return np.array(found)
