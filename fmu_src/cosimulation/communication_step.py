"""One communication step of the arteries as a frozen object, so that it can be tried and repeated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver.scheme.model import Model
from solver.scheme.outputs import volume_entered, volume_weights
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import State, adopt, parts

Array = np.ndarray
Number = Any  # one, or (n,)
Drive = Callable[[Array], Array]  # of the inlets at times (n, 4) [s], as (n, n_inlets, 4) [m³/s or Pa]


def rounded(dt: float) -> float:
    """An internal step [s] in nine digits: the operators are kept per length."""
    return float(f"{dt:.9g}")


@dataclass(frozen=True)
class Position:
    """A position of the arteries: a state of a model, the drives of the inlets, and the volume V_in [m³] that has
    entered.

    drive : (n_inlets,) the flow [m³/s], or where an inlet's causality is pressure, that [Pa]. A position may be several
    of one model: then drive is (n_inlets, n) and V_in (n,), if they differ.
    """

    model: Model
    state: State
    drive: Array
    V_in: Number

    def copies(self, n: int) -> Position:
        """n copies."""
        return replace(self, state=self.state.members(np.zeros(n, int)))

    def under(self, model: Model) -> Position:
        """The same position with other parameters. A change of volume by another compliance counts as entered."""
        if model is self.model:
            return self
        after = replace(self, model=model, state=adopt(model, self.state))
        return replace(after, V_in=self.V_in + after.volume() - self.volume())

    def volume(self) -> float:
        """Blood in the arteries and Windkessels [m³]."""
        return float(volume_weights(self.model)[0] @ self.state.y[0])


@dataclass(frozen=True)
class CommunicationStep:
    """A communication step of length h [s]: internal steps of length dt [s], with P_venous [Pa] held: (n_outlets,), or
    (n, n_outlets) for n positions."""

    model: Model
    h: float
    steps: int
    dt: float
    P_venous: Array

    def as_long_as(self, other: CommunicationStep) -> bool:
        """True if another one has the same internal steps of the same model."""
        return (self.steps, self.dt) == (other.steps, other.dt) and self.model is other.model

    def in_at_most(self, steps: int) -> CommunicationStep:
        """The same with at most this number of internal steps."""
        return self if self.steps <= steps else replace(self, steps=steps, dt=rounded(self.h / steps))

    def run(self, at: Position, start: Array, end: Array) -> Position:
        """The position at its end, with the inlets driven along straight lines [m³/s or Pa], both ends (n_inlets,) or
        (n_inlets, n).

        Raises NonPhysicalState.
        """
        rise, by_flow = (end - start) / self.steps, self.model.inlets.by_flow
        lines = (
            start[:, None] + np.moveaxis(np.multiply.outer(i + INFLOW_TIMES, rise), 0, 1) for i in range(self.steps)
        )
        entered = 0.5 * self.steps * self.dt * (start + end)[by_flow].sum(axis=0)
        return self._run(at, lines, end, entered, ~by_flow)

    def run_along(self, at: Position, t: float, drive: Drive) -> Position:
        """The same with the inlets driven from the time t [s] by a function of time, as INFLOW_TIMES takes it."""
        steps = np.arange(self.steps)[:, None] + INFLOW_TIMES
        curves = drive(t + steps * self.dt)
        return self._run(at, curves, curves[-1, :, -1], np.zeros(()), np.ones(curves.shape[1], bool))

    def _run(self, at: Position, drives: Iterable[Array], end: Array, entered: Array, counted: Array) -> Position:
        """The drives of each internal step, and of the last one at its end; ``entered`` is the volume that enters
        elsewhere than at the ``counted`` inlets."""
        state = at.state
        for drive in drives:
            for after in parts(self.model, state, self.dt, drive, self.P_venous):
                if counted.any():
                    V = volume_entered(self.model, state, after)[:, counted].sum(axis=1)
                    entered = entered + (V if len(V) > 1 else V[0])
                state = after
        return Position(self.model, state, end, at.V_in + (entered if entered.ndim else float(entered)))
