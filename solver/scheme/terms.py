"""The momentum equation divided by A/ρ, one physical term a function, its derivative beside it.

    ρ/A (∂Q/∂t + C_f Q/A) + ∂/∂x (P + ½ρα U²) + ρα (U/A) ∂Q/∂x + ρ f(U) = 0,     U = Q/A

It is tested with the Lobatto polynomials v; the pressure enters as natural boundary flux: at the ends of an element it
is the pressure H of its nodes, of :class:`~solver.scheme.step.State`. A term is (B, n_e, N+1) [Pa]; its derivative with
respect to the flows of its element, A following Q by ∂A/∂t = -∂Q/∂x, is (B, n_e, N+1, N+1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..laws.wall import Wall
from .drag_and_leak import Force, Storage
from .model import Model

Array = np.ndarray


class Start(NamedTuple):
    """The start of an implicit stage of length tau [s], with the laws of wall and fluid for it.

    y : the state vector there; A, Q its parts. inertia : like Q, ρ w J/τ.
    """

    model: Model
    tau: float
    y: Array
    A: Array
    Q: Array
    inertia: Array
    wall: Wall
    force: Force
    storage: Storage

    def area(self, A_t: Array) -> Array:
        """A at the end of the stage, (B, n_e, N) [m²]."""
        return self.A + self.tau * A_t

    def supply(self, Q: Array) -> Array:
        """-∂Q/∂x, the net inflow per length where the flow is Q : (B, n_e, N) [m²/s]."""
        return (Q @ self.model.mesh.element.d_xi) * self.model.minus_J_inverse

    def area_rate(self, Q: Array) -> Array:
        """∂A/∂t at the end of the stage, where the flow is Q : (B, n_e, N) [m²/s]."""
        return self.storage.area_rate(self.supply(Q))


class Flow(NamedTuple):
    """An iterate: Q [m³/s], A_end [m²] and U_end = Q/A_end at the Lobatto points; dQ = ∂Q/∂ξ, A_t, A, U and ½ρα U at
    the Gauss points."""

    Q: Array
    A_end: Array
    U_end: Array
    dQ: Array
    A_t: Array
    A: Array
    U: Array
    kinetic: Array


class Change(NamedTuple):
    """Derivatives of an iterate with respect to Q : (B, n_e, points, N+1)."""

    A_end: Array
    A_t: Array
    A: Array
    U: Array


def flow(s: Start, Q: Array) -> Flow:
    """The quantities that follow from Q."""
    m, el = s.model, s.model.mesh.element
    dQ = Q @ el.d_xi
    A_t = s.storage.area_rate(dQ * m.minus_J_inverse)
    A = s.tau * A_t
    A += s.A
    U = Q @ el.at_gauss
    U /= A
    A_end = A @ el.at_lobatto
    return Flow(Q, A_end, Q / A_end, dQ, A_t, A, U, m.kinetic * U)


def still(s: Start) -> Flow:
    """The state at the start of a stage with ∂A/∂t = 0, about which small waves are linearised."""
    el, A_end = s.model.mesh.element, s.A @ s.model.mesh.element.at_lobatto
    U = s.Q @ el.at_gauss / s.A
    return Flow(s.Q, A_end, s.Q / A_end, s.Q @ el.d_xi, 0.0 * s.A, s.A, U, s.model.kinetic * U)


def change(s: Start, f: Flow) -> Change:
    """The derivatives of an iterate with respect to Q."""
    el = s.model.mesh.element
    A_t = s.model.minus_J_inverse[..., None] * el.derivative * s.storage.slope(f.A, f.A_t)
    A = s.tau * A_t
    U = (el.to_gauss - f.U[..., None] * A) / f.A[..., None]
    return Change(np.einsum("gi,begj->beij", el.at_lobatto, A), A_t, A, U)


def residual(s: Start, Q: Array, H: Array) -> Array:
    """The momentum that is left over, (B, n_e, N+1) [Pa]; H : (B, n_nodes) [Pa]."""
    f = flow(s, Q)
    R = pressure(s, f)
    R += convection(s, f)
    R += inertia(s, f)
    R += friction(s, f)
    s.force.add_to(R, f.Q, f.A_end)  # the drag of effects; nothing where there is none
    s.model.damping.add_to(R, f.Q)  # of what elements do not resolve; nothing where walls do it
    R += ends(s, f, H)
    return R


def jacobian(s: Start, f: Flow) -> Array:
    """Its derivative with respect to Q, (B, n_e, N+1, N+1)."""
    d = change(s, f)
    K = d_pressure(s, f, d)
    K += d_convection(s, f, d)
    K += d_inertia(s, f, d)
    K += d_friction(s, f, d)
    K += d_force(s, f, d)
    K += s.model.damping.slope(f.Q)
    K += d_ends(s, f, d)
    return K


def pressure(s: Start, f: Flow) -> Array:
    """∂/∂x (P + ½ρα U²), as -∫ (P + ½ρα U²) ∂v/∂x."""
    P = s.wall.pressure(f.A, f.A_t)
    P += f.kinetic * f.U
    return P @ s.model.mesh.element.minus_d_test


def d_pressure(s: Start, f: Flow, d: Change) -> Array:
    stiffness = s.wall.stiffness(f.A) + s.wall.viscous_slope(f.A, f.A_t)
    viscosity = s.wall.viscosity(f.A, f.A_t)
    dP = stiffness[..., None] * d.A + viscosity[..., None] * d.A_t + (2.0 * f.kinetic)[..., None] * d.U
    return np.einsum("gi,begj->beij", s.model.mesh.element.minus_d_test, dP)


def convection(s: Start, f: Flow) -> Array:
    """ρα (U/A) ∂Q/∂x, twice ½ρα U ∂Q/∂ξ/A."""
    C = f.kinetic * f.dQ
    C /= f.A
    return C @ s.model.mesh.element.twice_test


def d_convection(s: Start, f: Flow, d: Change) -> Array:
    el = s.model.mesh.element
    dC = f.dQ[..., None] * d.U + f.U[..., None] * el.derivative - (f.U * f.dQ / f.A)[..., None] * d.A
    return np.einsum("gi,begj->beij", el.twice_test, (s.model.kinetic / f.A)[..., None] * dC)


def inertia(s: Start, f: Flow) -> Array:
    """ρ/A ∂Q/∂t."""
    return s.inertia * (f.Q - s.Q) / f.A_end


def d_inertia(s: Start, f: Flow, d: Change) -> Array:
    return _diagonal(s.inertia / f.A_end) - (inertia(s, f) / f.A_end)[..., None] * d.A_end


def friction(s: Start, f: Flow) -> Array:
    """ρ/A C_f Q/A."""
    return s.model.friction * f.U_end / f.A_end


def d_friction(s: Start, f: Flow, d: Change) -> Array:
    by_Q = s.model.friction / f.A_end**2
    return _diagonal(by_Q) - (2.0 * by_Q * f.U_end)[..., None] * d.A_end


def d_force(s: Start, f: Flow, d: Change) -> Array:
    by_Q, by_A = (np.broadcast_to(slope, f.Q.shape) for slope in s.force.slopes(f.Q, f.A_end))
    return _diagonal(by_Q) + by_A[..., None] * d.A_end


def ends(s: Start, f: Flow, H: Array) -> Array:
    """[v H'] at the ends of the element, H' = H + ½ρ(α - k) U²: static pressure, and the kinetic one H leaves out."""
    mesh = s.model.mesh
    flux = H.take(mesh.outer_nodes, 1)
    flux *= mesh.outward
    flux += s.model.end_kinetic * (f.U_end * f.U_end)
    return flux


def d_ends(s: Start, f: Flow, d: Change) -> Array:
    by_U = 2.0 * s.model.end_kinetic * f.U_end / f.A_end
    return _diagonal(by_U) - (by_U * f.U_end)[..., None] * d.A_end


def _diagonal(x: Array) -> Array:
    """(..., n, n) with x : (..., n) on the diagonal."""
    return x[..., None] * np.eye(x.shape[-1])
