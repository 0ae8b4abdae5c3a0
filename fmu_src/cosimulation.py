"""The component without FMI: parameters by name, a fixed internal time grid, any communication step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver.network import Network
from solver.outputs import reporter
from solver.scheme.model import Model, Settings, build
from solver.scheme.sdirk import INFLOW_TIMES, SDIRK3
from solver.scheme.step import State, adopt, initial_state, step

# communication points nearer to the grid than this part of dt count as on it
_ON_GRID = 1e-6


@dataclass(frozen=True)
class _Piece:
    """The inflow of one communication step: linear in time from ``Q_start`` to ``Q_end`` [m³/s]."""

    start: float
    end: float
    Q_start: float
    Q_end: float

    def __call__(self, t: float) -> float:
        slope = (self.Q_end - self.Q_start) / (self.end - self.start)
        return self.Q_end if t == self.end else self.Q_start + slope * (t - self.start)


class CoSimulation:
    """Internal steps lie at t0 + n·dt whatever the communication points; outputs off the grid come from a short step
    that is then discarded.

    The inflow of a communication step is held, or linear from the value of the step before to the present one. An
    outlet's P_venous and changed parameters count from the last grid point on.
    """

    def __init__(self, network: Network, settings: Settings) -> None:
        self.network, self.settings = network, settings
        self.parameters = tuple(network.parameters())
        self.venous = [f"{outlet.segment}.outlet.P_venous" for outlet in network.outlets]

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Build the solver at rest from variable values by name; raises ValueError if they do not fit together."""
        laws = {"elastic_law": values["network.elastic_law"], "viscous_law": values["network.viscous_law"]}
        settings = replace(self.settings, dt=values["solver.dt"], element_length=values["solver.element_length"])
        parameters = {name: values[name] for name in self.parameters}
        self._use(build(replace(self.network, **laws), parameters, settings))
        self.dt = settings.dt
        self.holds = values["inlet.interpolation"] == "hold"
        self.state = self.shown = initial_state(self.model, t0)
        self.t0, self.n, self.time = t0, 0, t0
        self.Q_before = values["inlet.Q"]
        self.pieces: list[_Piece] = []  # the inflow since the last grid point

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Take over values that were changed between steps, by name; raises ValueError and keeps the old ones if bad.

        Of the inputs those that are parameters too (P_venous) matter: the Jacobian at rest is made with them.
        """
        self._use(self.model.with_parameters({name: v for name, v in changed.items() if name in self.parameters}))
        self.state = adopt(self.model, self.state)

    def _use(self, model: Model) -> None:
        self.model, self.report = model, reporter(model)

    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Advance from t to t + h [s] with the inputs in ``values``.

        Raises ValueError, NonPhysicalState; the component is then as before.
        """
        self._check_time(t, h)
        Q = values["inlet.Q"]
        P_venous = np.array([values[name] for name in self.venous])
        end = self._snapped(t + h)
        pieces = [*self.pieces, _Piece(self.time, end, Q if self.holds else self.Q_before, Q)]
        state, n = self.state, self.n
        while self._grid(n + 1) <= end:
            state = replace(self._advance(state, n, 1.0, pieces, P_venous), t=self._grid(n + 1))
            n += 1
        shown = state
        if end > self._grid(n):
            part = round((end - self._grid(n)) / self.dt, 9)  # rounded: the operators are kept per length
            shown = self._advance(_ready_for(state, part), n, part, pieces, P_venous)
        self.state, self.n, self.shown, self.time = state, n, shown, end
        self.Q_before = Q
        self.pieces = [piece for piece in pieces if piece.end > self._grid(n)]

    def outputs(self) -> list[float]:
        """The outputs at the last communication point, in the order of the variable table."""
        return self.report(self.shown)[0].tolist()

    def _grid(self, n: float) -> float:
        return self.t0 + n * self.dt

    def _snapped(self, t: float) -> float:
        """The grid point at t if there is one, so that round-off of communication points makes no short steps."""
        nearest = self._grid(round((t - self.t0) / self.dt))
        return nearest if abs(t - nearest) <= _ON_GRID * self.dt else t

    def _advance(self, state: State, n: int, part: float, pieces: list[_Piece], P_venous: np.ndarray) -> State:
        """One step from grid point n, over ``part`` of the internal step."""
        times = [self._grid(n + part * c) for c in INFLOW_TIMES.tolist()]
        inflow = [next((piece for piece in pieces if t <= piece.end), pieces[-1])(t) for t in times]
        return step(self.model, state, part * self.dt, np.array(inflow), P_venous)

    def _check_time(self, t: float, h: float) -> None:
        if not (np.isfinite(h) and h > 0.0):
            raise ValueError(f"communication step of {h:g} s: must be positive.")
        if not abs(t - self.time) <= 2 * _ON_GRID * self.dt + 1e-12 * abs(t):
            raise ValueError(
                f"step from t = {t:.9g} s, but the component stands at {self.time:.9g} s; step on from there or reset."
            )


def _ready_for(state: State, part: float) -> State:
    """The state at a grid point, ready for a step that is only ``part`` of the last one.

    The iterations of a step start from the stage values of the last two steps, at their times. For another length the
    values at the end of these steps are extrapolated to the new times; a plain restart leaves fifty times the error.
    """
    ahead = part * SDIRK3.sum(axis=1)
    last, before = state.unknowns[-1], state.unknowns_before[-1]
    unknowns = last + np.multiply.outer(ahead, last - before)
    return replace(state, unknowns=unknowns, unknowns_before=unknowns)
