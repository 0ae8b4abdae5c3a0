"""A start state near the periodic one, which saves about ten beats.

It comes from the harmonic balance (:mod:`~solver.periodic.harmonic_balance`) after a few corrections. If the waves
would make the state non-physical, it is the steady state.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..mesh.sources import Forcing
from ..scheme.guards import NonPhysicalState, check
from ..scheme.model import Model
from ..scheme.sdirk import SDIRK3
from ..scheme.step import State
from .harmonic_balance import Drive, balanced, spectrum, steady, storable
from .waves import Waves

Array = np.ndarray

_MOST, _SUFFICIENT, _FEWEST = 32, 16, 4  # harmonics: default, for any tolerance of beats, and in a large network
_LEFT = 0.4  # K harmonics leave a gap of 0.14/K³ after 5/4 beats (measured on the sheep); here with a margin of 3
_CORRECTIONS = 6
_SMALL = 1e-4  # of the waves: a smaller correction is the last
_FADES = 10.0  # the last correction in tolerances of beats: 5/4 beats remove at least this factor of a difference


def periodic_state(
    model: Model, drive: Drive, T: float, t: float = 0.0, dt: float | None = None, backend: str = "numpy",
    tolerance: float = 0.0,
) -> State:  # fmt: skip
    """A state at time t [s] near the periodic state under the drive of the inlet.

    drive : Q(t) [m³/s] for an array of times, or P(t) [Pa] if the inlet's causality is pressure; (n,) or per member
    (n, B); for several inlets (n, n_inlets) or (n, n_inlets, B). T : its period [s]. dt : the next step [s], default
    the settings'. backend : for the balance, as in :func:`~solver.beat_harmonics`. tolerance : of beats that are to
    repeat after a beat and a quarter, for which fewer harmonics and corrections suffice; default: the most of both.
    Raises ValueError if the network has no steady state with the mean of the drive.
    """
    most = int(np.clip((_LEFT / tolerance) ** (1.0 / 3.0), _SUFFICIENT, _MOST)) if tolerance else _MOST
    harmonics = spectrum(model, drive, T, int(np.clip(storable(model), _FEWEST, most)), t)
    small = max(_SMALL, _FADES * tolerance)
    forcing = Forcing.of(model, *model.tables.beside((), None, T, len(harmonics), t), len(harmonics))
    found = None
    with np.errstate(all="ignore"):
        if backend != "numpy":
            from .native_balance import waves_by  # an FMU's code has no engine

            found = waves_by(backend, model, harmonics, T, small, _CORRECTIONS, forcing)
        if found is None:
            rest = steady(model, harmonics[0].real)
            found = rest, balanced(model, rest, harmonics, T, small, _CORRECTIONS, forcing=forcing)[0]
        rest, waves = found
        return _state(model, waves, rest, t, dt or model.settings.dt)


def _state(model: Model, waves: Waves, rest: State, t: float, dt: float) -> State:
    """The state at the start of the period, with the stage values for the initial guesses of the next steps."""
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
