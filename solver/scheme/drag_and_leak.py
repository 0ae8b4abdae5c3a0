"""A drag beside friction, as of a stenosis, and a leak through the wall, as of a side branch.

    ρ/A (∂Q/∂t + …) + ρ f(Q/A) = 0,     ∂A/∂t = -∂Q/∂x - g (P - P_sink)

A model without them has a term that is zero in their place, at no cost.
``since`` makes the term of a stage from the term of the model and the start of the stage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from ..laws.effect import Drag
from ..laws.wall import Wall

Array = np.ndarray

_LEAK_STEPS = 3  # Newton steps for ∂A/∂t: a leak takes little of the flow, and each step squares the error


@dataclass(frozen=True)
class NoForce:
    """No force on the flow beside friction."""

    memories = 0

    def since(self, history: Array, tau: float) -> NoForce:
        return self

    def add_to(self, R: Array, Q: Array, A: Array) -> None:
        return None

    def slopes(self, Q: Array, A: Array) -> tuple[float, float]:
        return 0.0, 0.0

    def history(self, before: Array, Q: Array, A: Array) -> Array:
        return before


@dataclass(frozen=True)
class DragForce:
    """ρ w J f(U) at the Lobatto points, f of :class:`~solver.laws.effect.Drag`, whose memory is a history z = y - U.

    mass : (B, n_e, N+1) ρ w J. quadratic : like mass. weight, rate : (B, m, n_e, N+1). at_lobatto : (N, N+1).
    Of a stage: passed = τ rate; linear, constant : like mass, of Σ weight y = linear U + constant.
    """

    mass: Array
    quadratic: Array
    weight: Array
    rate: Array
    at_lobatto: Array
    passed: Array = field(default_factory=lambda: np.zeros(0))
    linear: Array | float = 0.0
    constant: Array | float = 0.0

    MEMBER_AXIS: ClassVar[Mapping[str, int | None]] = {"at_lobatto": None}  # no batch axis; the others have it first

    @staticmethod
    def of(drag: Drag, mass: Array, at_lobatto: Array) -> DragForce:
        weight, rate = (np.moveaxis(array, 0, 1).copy() for array in (drag.weight, drag.rate))
        return DragForce(mass, drag.quadratic, weight, rate, at_lobatto)

    @property
    def memories(self) -> int:
        """m, the number of history variables at a point."""
        return self.rate.shape[1]

    def since(self, history: Array, tau: float) -> DragForce:
        """The force at the end of a stage of length tau [s] from z : (B, m, n_e, N+1) [m/s]."""
        # dz/dt = -rate (z + U) by backward Euler, solved exactly: y = z + U = (z_start + U)/(1 + τ rate)
        passed = tau * self.rate
        share = self.weight / (1.0 + passed)
        return replace(self, passed=passed, linear=share.sum(axis=1), constant=(share * history).sum(axis=1))

    def add_to(self, R: Array, Q: Array, A: Array) -> None:
        """Add the force of the flow Q through A to R, all (B, n_e, N+1)."""
        U = Q / A
        R += self.mass * (self.linear * U + self.constant + self.quadratic * U * np.abs(U))

    def slopes(self, Q: Array, A: Array) -> tuple[Array, Array]:
        """Its derivatives with respect to Q and A."""
        U = Q / A
        by_Q = self.mass * (self.linear + 2.0 * self.quadratic * np.abs(U)) / A
        return by_Q, -by_Q * U

    def history(self, before: Array, Q: Array, A: Array) -> Array:
        """The history at the end of the stage, from the history ``before`` at its start; A : (B, n_e, N)."""
        U = Q / (A @ self.at_lobatto)
        return (before - self.passed * U[:, None]) / (1.0 + self.passed)


Force = NoForce | DragForce


@dataclass(frozen=True)
class Tight:
    """∂A/∂t = -∂Q/∂x (`massConserv_AQ`)."""

    proportional: ClassVar[bool] = True  # areas grow in proportion to the net inflow

    def since(self, wall: Wall, A: Array, tau: float, P_venous: Array) -> Tight:
        return self

    def area_rate(self, supply: Array) -> Array:
        return supply

    def left_over(self, supply: Array, A: Array, A_t: Array) -> Array:
        return supply - A_t

    def slope(self, A: Array, A_t: Array) -> float:
        return 1.0


@dataclass(frozen=True)
class Leaking:
    """∂A/∂t = -∂Q/∂x - g (P - P_sink), P_sink the venous pressure of the outlet where the segment ends, else 0.

    leak : (B, n_e, N) g [m²/(Pa·s)]. sink : (n_e,) index of that outlet; the number of outlets if there is none.
    """

    proportional: ClassVar[bool] = False

    leak: Array
    sink: Array
    wall: Wall
    A: Array
    tau: float = 0.0
    P_sink: Array | float = 0.0

    def since(self, wall: Wall, A: Array, tau: float, P_venous: Array) -> Leaking:
        """The storage of a stage of length tau [s] from A, with the walls at that time."""
        pressures = np.concatenate([P_venous, np.zeros((*P_venous.shape[:-1], 1))], axis=-1)
        return replace(self, wall=wall, A=A, tau=tau, P_sink=pressures[..., self.sink, None])

    def area_rate(self, supply: Array) -> Array:
        """∂A/∂t at the end of a stage from supply = -∂Q/∂x, both (B, n_e, N) [m²/s]."""
        A_t = 0.0 * supply  # Newton steps from 0, which a long stage does not amplify: P depends on A and ∂A/∂t
        for _ in range(_LEAK_STEPS):
            A = self.A + self.tau * A_t
            A_t = A_t + self.left_over(supply, A, A_t) / (1.0 + self.leak * self._pressure_slope(A, A_t))
        return A_t

    def left_over(self, supply: Array, A: Array, A_t: Array) -> Array:
        """The residual of mass: inflow minus storage and leakage, for this area and ∂A/∂t, all (B, n_e, N) [m²/s]."""
        return supply - A_t - self.leak * (self.wall.pressure(A, A_t) - self.P_sink)

    def slope(self, A: Array, A_t: Array) -> Array:
        """d(∂A/∂t)/d supply, (B, n_e, N, 1)."""
        return (1.0 / (1.0 + self.leak * self._pressure_slope(A, A_t)))[..., None]

    def _pressure_slope(self, A: Array, A_t: Array) -> Array:
        """dP/d(∂A/∂t) with A = A_start + τ ∂A/∂t."""
        wall = self.wall
        return self.tau * (wall.stiffness(A) + wall.viscous_slope(A, A_t)) + wall.viscosity(A, A_t)


Storage = Tight | Leaking
