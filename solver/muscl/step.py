"""An output step, divided into as many steps as the CFL number requires."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from ..errors import InputError, NonPhysicalState
from ..mesh.element import lagrange
from ..scheme.sdirk import INFLOW_TIMES
from ..scheme.step import of_batch
from .flux import rates, speeds
from .implicit import Nodes, Solved, solve
from .model import MusclModel

Array = np.ndarray

_MOST_STEPS = 10_000  # in a step of the output


@dataclass(frozen=True)
class Level:
    """The solution at one time level: A, Q : (B, n_cells), P_C : (B, n_outlets) stored pressures of the outlets, and
    the rates of A and Q from the hyperbolic part."""

    A: Array
    Q: Array
    P_C: Array
    A_t: Array
    Q_t: Array


Arrays = TypeVar("Arrays", Level, Solved)


@dataclass(frozen=True)
class State:
    """Everything a step needs.

    A [m²], solved.Q [m³/s] : (B, n_cells). P_C : (B, n_outlets) [Pa]. before : the level before the last step, of
    length dt [s]; None at the start. halved : always 0, as steps are never halved.
    """

    t: float
    A: Array
    solved: Solved
    P_C: Array
    before: Level | None = None
    dt: float = 0.0
    halved: int = 0

    @property
    def y(self) -> Array:
        """One row for each member of the batch."""
        return self.A

    @property
    def H(self) -> Array:
        """(B, n_nodes) [Pa]."""
        return self.solved.H

    @property
    def Q(self) -> Array:
        """(B, n_cells) [m³/s]."""
        return self.solved.Q

    def members(self, index: Array | slice) -> State:
        """The state of some members of a batch."""
        return replace(
            self,
            A=self.A[index],
            solved=_some(self.solved, index),
            P_C=self.P_C[index],
            before=None if self.before is None else _some(self.before, index),
        )


def _some(arrays: Arrays, index: Array | slice) -> Arrays:
    """The same with some members of every array."""
    return replace(arrays, **{field.name: getattr(arrays, field.name)[index] for field in fields(arrays)})


def initial_state(model: MusclModel, t: float = 0.0) -> State:
    """Fluid at rest under the uniform pressure P_0."""
    c, grid = model.coefficients, model.mesh
    ends = np.zeros((c.B, *grid.nodes.shape))
    H = np.broadcast_to(c.P_0, (c.B, grid.topology.n_nodes)).copy()
    P_C = np.broadcast_to(c.P_0, (c.B, len(grid.topology.outlet_segment))).copy()
    return State(t, model.A_rest, Solved(0.0 * model.A_rest, ends, ends + c.P_0[..., None], H), P_C)


def adopt(model: MusclModel, state: State) -> State:
    """A state on this grid under other parameters; that of one member can start a whole batch.

    Raises ValueError for a batch of another size.
    """
    found: State = of_batch(state, model.coefficients.B)
    return found


def step(model: MusclModel, state: State, dt: float, drive: Array, P_venous: Array | None = None) -> State:
    """Advance by dt [s].

    drive : (n_inlets, 4) or (n_inlets, 4, B), the inflow [m³/s], or the pressure [Pa] of a pressure-driven inlet,
    at the times t + INFLOW_TIMES dt. P_venous : (n_outlets,) or (B, n_outlets)
    [Pa] during the step, default the parameters'.
    Raises NonPhysicalState if the result is not physical.
    """
    c, start = model.coefficients, state.t
    with np.errstate(all="ignore"):
        venous = c.P_venous if P_venous is None else c.venous(np.atleast_2d(P_venous))
        n = _steps(model, state, dt)
        between = lagrange(INFLOW_TIMES, np.arange(1, n + 1) / n)
        driven = np.matmul(between, drive.reshape(len(drive), len(INFLOW_TIMES), -1))
        for drives in np.broadcast_to(driven, (len(drive), n, c.B)).swapaxes(0, 1):
            state = _advance(model, state, dt / n, drives, venous)
        _check(model, state, start + dt)
    return replace(state, t=start + dt)


def _steps(model: MusclModel, state: State, dt: float) -> int:
    """The number of equal steps with (|U| + c) dt/dx <= cfl."""
    carried, root = speeds(model, model.wall, np.sqrt(state.A / model.wall.A0), state.Q / state.A)
    n = math.ceil(dt * float(np.max((np.abs(carried) + root) / model.dx)) / model.settings.cfl)
    if n > _MOST_STEPS:
        raise InputError(f"muscl settings: dt = {dt:g} s takes {n} steps, more than {_MOST_STEPS}; use longer cells.")
    return max(n, 1)


def _advance(model: MusclModel, s: State, dt: float, drives: Array, venous: Array) -> State:
    """One step, with drives : (n_inlets, B) at its end: (3/2 y - 2 y_1 + 1/2 y_2)/dt = 2 f_1 - f_2 + g for equal ones,
    f the hyperbolic, g the implicit part.

    r is the length of the step over that of the one before; the first step is an Euler step, r = 0.
    """
    now = Level(s.A, s.Q, s.P_C, *rates(model, s.A, s.Q, s.solved.Q_end, s.solved.P_end))
    before, r = (now, 0.0) if s.before is None else (s.before, dt / s.dt)
    lead, last, past = (1.0 + 2.0 * r) / (1.0 + r), 1.0 + r, -r * r / (1.0 + r)
    fast, slow = dt * (1.0 + r), -dt * r
    A = (last * now.A + past * before.A + fast * now.A_t + slow * before.A_t) / lead
    Q = last * now.Q + past * before.Q + fast * now.Q_t + slow * before.Q_t
    P_C = (last * now.P_C + past * before.P_C) / lead
    kinds, behind, charge = [], np.empty_like(P_C), np.empty_like(P_C)
    for ends in model.coefficients.outlets:
        load = ends.load(model.outlet_wall.at(ends.index), dt / lead)
        kinds.append((ends.index, load))
        behind[:, ends.index] = load.keep * P_C[:, ends.index] + load.give * venous[:, ends.index]
        charge[:, ends.index] = load.charge
    solved = solve(model, A, s.Q, Q / dt, lead / dt, Nodes(drives, tuple(kinds), behind, s.solved.H))
    outflow = solved.Q_end[:, 1, model.mesh.topology.outlet_segment]
    return State(s.t + dt, A, solved, behind + charge * outflow, now, dt)


def _check(model: MusclModel, state: State, t: float) -> None:
    """Raise NonPhysicalState unless A > 0, dP/dA > 0 and |U| < c in every cell."""
    carried, root = speeds(model, model.wall, np.sqrt(state.A / model.wall.A0), state.Q / state.A)
    for margin, reason, remedy in (
        (state.A, "the area fell to zero or below", "lower the inflow or check R0, E and h there"),
        (root, "the wall has no stiffness left (dP/dA <= 0)", "use a stiffer wall or a lower pressure"),
        (root - np.abs(carried), "the flow is supercritical (|Q/A| >= c)", "lower the inflow or stiffen the wall"),
    ):
        if not margin.min() > 0.0:
            b, cell = np.unravel_index(int(np.argmin(np.nan_to_num(margin, nan=-np.inf))), margin.shape)
            segment = model.network.segments[model.mesh.segment[cell]].name
            x = float(model.mesh.middle[cell] * model.coefficients.L[b, model.mesh.segment[cell]])
            member = f" in parameter set {b} of the batch" if model.coefficients.batched else ""
            raise NonPhysicalState(reason + member, segment, x, t, remedy)
