"""One communication step of the arteries, whatever comes of it: frozen, so that it can be tried and repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.scheme.model import Model
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import State, adopt, step

Array = np.ndarray


@dataclass(frozen=True)
class Position:
    """Where the arteries stand: their state, the inflow Q [m³/s] there, and the volume V_in [m³] that came in."""

    state: State
    Q: float
    V_in: float

    def under(self, model: Model) -> Position:
        """The same under other parameters."""
        return self if self.state.layout is model.layout else replace(self, state=adopt(model, self.state))


@dataclass(frozen=True)
class Stretch:
    """A communication step of length h [s]: internal steps of length dt [s], with P_venous : (n_outlets,) [Pa] held."""

    model: Model
    h: float
    steps: int
    dt: float
    P_venous: Array

    def run(self, at: Position, Q_start: float, Q_end: float) -> Position:
        """The position at its end, with an inflow along the straight line from Q_start to Q_end [m³/s].

        Raises NonPhysicalState.
        """
        state, rise = at.state, (Q_end - Q_start) / self.steps
        for i in range(self.steps):
            state = step(self.model, state, self.dt, Q_start + rise * (i + INFLOW_TIMES), self.P_venous)
        return Position(state, Q_end, at.V_in + 0.5 * self.steps * self.dt * (Q_start + Q_end))
