"""The component without FMI: parameters by name, a fixed internal time grid, any communication step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from solver.network import Network
from solver.staggered import INFLOW_TIMES, Settings, Staggered, reporter

# communication points nearer to the grid than this part of dt count as on it
_ON_GRID = 1e-6


class CoSimulation:
    """Internal steps lie at t0 + n·dt whatever the communication points; outputs off the grid come from a short step
    that is then discarded.

    The inflow of a communication step is held, or linear from the value of the step before to the present one.
    Values are kept by variable name; changing them takes effect at the next step.
    """

    def __init__(self, network: Network, settings: Settings) -> None:
        self.network, self.settings = network, settings
        self.interpolation = "hold"
        self.parameters: dict[str, float] = network.parameters()

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Build the solver at rest from variable values by name; raises ValueError if they do not fit together."""
        laws = {"elastic_law": values["network.elastic_law"], "viscous_law": values["network.viscous_law"]}
        self.interpolation = values["inlet.interpolation"]
        settings = replace(self.settings, dt=values["solver.dt"], element_length=values["solver.element_length"])
        self.dt = settings.dt
        self.parameters = {name: values[name] for name in self.network.parameters()}
        self.scheme = Staggered(replace(self.network, **laws), self.parameters, settings)
        self.report = reporter(self.scheme)
        self.state = self.scheme.initial_state(t0)
        self.shown = self.state
        self.t0, self.n, self.time = t0, 0, t0
        self.Q_before = values["inlet.Q"]
        # pieces of the inflow since the last grid point: end time, start time, values at both
        self.pieces: list[tuple[float, float, float, float]] = []

    def retune(self, values: Mapping[str, Any]) -> None:
        """Take over parameters that were changed between steps; raises ValueError and keeps the old ones if bad."""
        parameters = {name: values[name] for name in self.parameters}
        scheme = self.scheme.with_parameters(parameters)
        self.scheme, self.parameters = scheme, parameters
        self.report = reporter(scheme)

    def step(self, t: float, h: float, Q: float) -> None:
        """Advance from t to t + h [s] with inlet.Q = Q. Raises ValueError, NonPhysicalState; the state is then as before."""
        self._check_time(t, h)
        end = t + h
        before = self.Q_before if self.interpolation == "linear" else Q
        pieces = [*self.pieces, (end, t, before, Q)]
        state, n = self.state, self.n
        while self.t0 + (n + 1) * self.dt <= end + _ON_GRID * self.dt:
            state = replace(self._advance(state, self.t0 + n * self.dt, self.dt, pieces), t=self.t0 + (n + 1) * self.dt)
            n += 1
        rest = round((end - self.t0 - n * self.dt) / self.dt, 9) * self.dt  # rounded: the operators are kept per length
        on_grid = rest <= _ON_GRID * self.dt
        shown = state if on_grid else self._advance(state.restarted(), self.t0 + n * self.dt, rest, pieces)
        self.state, self.n, self.shown = state, n, shown
        self.pieces = [piece for piece in pieces if piece[0] > self.t0 + n * self.dt]
        self.time, self.Q_before = end, Q

    def outputs(self) -> list[float]:
        """The outputs at the last communication point, in the order of the variable table."""
        return self.report(self.shown)[0].tolist()

    def _advance(self, state: Any, t: float, dt: float, pieces: list[tuple[float, float, float, float]]) -> Any:
        inflow = np.array([_inflow(pieces, t + c * dt, _ON_GRID * dt) for c in INFLOW_TIMES])
        return self.scheme.step(state, dt, inflow)

    def _check_time(self, t: float, h: float) -> None:
        if not (np.isfinite(h) and h > 0.0):
            raise ValueError(f"communication step of {h:g} s: must be positive.")
        if not abs(t - self.time) <= 1e-6 * self.dt + 1e-12 * abs(t):
            raise ValueError(
                f"step from t = {t:.9g} s, but the component stands at {self.time:.9g} s; step on from there or reset."
            )


def _inflow(pieces: list[tuple[float, float, float, float]], t: float, slack: float) -> float:
    """Inflow at time t: of the first piece that ends at or after t."""
    end, start, Q_start, Q_end = next((piece for piece in pieces if t <= piece[0] + slack), pieces[-1])
    return Q_start + (Q_end - Q_start) * (t - start) / (end - start)
