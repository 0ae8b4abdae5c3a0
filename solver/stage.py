"""One implicit stage of the staggered scheme: what it starts from, the weak momentum, the nodes, and the iteration that
meets both."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .staggered import Operators, Staggered

Array = np.ndarray

Memory = tuple[Array | None, Array | None]  # viscous stress and flow history, as in State

CORRECTIONS = 8  # chord iterations before the Jacobian is refreshed
REFRESHES = 5  # fresh Jacobians before the step is given up
_LEAK_STEPS = 3  # Newton steps for ∂A/∂t: a leak takes little of the flow, and each step squares the error


class Base:
    """What a stage of length τ starts from: A, Q and memory, and the laws of wall and fluid that these make for it.

    Memory is integrated like everything else: a backward Euler step of length τ from its base, whose relaxation is
    solved for exactly.
    """

    def __init__(
        self,
        scheme: Staggered,
        tau: float,
        A: Array,
        Q: Array,
        stress: Array | None = None,
        history: Array | None = None,
        venous: Array | None = None,
    ) -> None:
        self.scheme, self.tau, self.A, self.Q, self.history = scheme, tau, A, Q, history
        self.wall = scheme.wall if stress is None else scheme.wall.remembering(stress, tau)
        if history is not None:
            assert scheme.drag is not None
            # y = z + U with z from dz/dt = -rate (z + U): y = (z_base + U)/(1 + τ rate)
            share = scheme.drag.weight / (1.0 + tau * scheme.drag.rate)
            self.linear, self.constant = share.sum(axis=0), (share * history).sum(axis=0)
        if self.wall.leak is not None:
            P = scheme.coefficients.P_venous if venous is None else venous
            self.P_sink = np.concatenate([P, np.zeros((*P.shape[:-1], 1))], axis=-1)[..., scheme.sink, None]

    def area_rate(self, Q: Array) -> Array:
        """∂A/∂t at the Gauss points at the end of the stage : (B, n_e, N) [m²/s]."""
        return self.leaking(self.scheme.area_rate(Q))

    def leaking(self, supply: Array) -> Array:
        """∂A/∂t = supply - g (P - P_venous), supply = -∂Q/∂x, by Newton steps: P depends on both A and ∂A/∂t."""
        A_t, wall = supply, self.wall
        if wall.leak is None:
            return A_t
        for _ in range(_LEAK_STEPS):
            A = self.A + self.tau * A_t
            rest = A_t - supply + wall.leak * (wall.pressure(A, A_t) - self.P_sink)
            slope = self.tau * (wall.stiffness(A) + wall.viscous_slope(A, A_t)) + wall.viscosity(A, A_t)
            A_t = A_t - rest / (1.0 + wall.leak * slope)
        return A_t

    def drag(self, U: Array) -> Array:
        """Force per mass on the flow [m/s²] at the Lobatto points."""
        assert self.scheme.drag is not None
        return self.linear * U + self.constant + self.scheme.drag.quadratic * U * np.abs(U)

    def drag_slope(self, U: Array) -> Array:
        """d drag/dU [1/s]."""
        assert self.scheme.drag is not None
        return self.linear + 2.0 * self.scheme.drag.quadratic * np.abs(U)

    def memory(self, Q: Array, A_t: Array) -> Memory:
        """Viscous stress and flow history at the end of the stage."""
        A, stress, history = self.A + self.tau * A_t, None, self.history
        if self.wall.past is not None:
            stress = self.wall.viscous_stress(A, A_t)
        if history is not None:
            assert self.scheme.drag is not None
            passed = self.tau * self.scheme.drag.rate
            history = (history - passed * (Q / (A @ self.scheme.to_lobatto))) / (1.0 + passed)
        return stress, history


class Stage:
    """One implicit stage: given its base and P_C there, find Q and the nodal pressures H at its end."""

    def __init__(
        self,
        scheme: Staggered,
        operators: Operators,
        base: Base,
        P_C: Array,
        inflow: Array,
        venous: Array,
        t: float,
    ) -> None:
        self.scheme, self.operators, self.base, self.t = scheme, operators, base, t
        self.A, self.Q, self.P_C, self.inflow, self.venous = base.A, base.Q, P_C, inflow, venous
        self.P_0 = operators.keep * P_C + operators.give * venous

    def solve(self, Q: Array, H: Array, small: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Chord iterations from a guess until Q and H change by no more than ``small`` : two (B,).

        Returns Q, H and ∂A/∂t. A member of a batch that has converged stays what it is alone, whatever its neighbours
        do. One that was thrown off starts again from the guess, with the Jacobian there.
        Raises NonPhysicalState, located from the last finite iterate.
        """
        small_Q, small_H = small
        jacobian, guess = self.operators, (Q, H)
        done, before = np.zeros(len(Q), bool), Q
        for _ in range(1 + REFRESHES):
            for _ in range(CORRECTIONS):
                Q_new, H_new = self.correct(jacobian, Q, H)
                change_Q = np.abs(Q_new - Q).reshape(len(Q), -1).max(axis=1)
                change_H = np.abs(H_new - H).max(axis=1)
                near = (change_Q <= small_Q) & (change_H <= small_H)
                if near.all() and not done.any():
                    return Q_new, H_new, self.base.area_rate(Q_new)
                moves = ~done & np.isfinite(change_Q) & np.isfinite(change_H)
                if moves.all():
                    before, Q, H = Q, Q_new, H_new
                else:
                    before = np.where(moves[:, None, None], Q, before)
                    Q, H = np.where(moves[:, None, None], Q_new, Q), np.where(moves[:, None], H_new, H)
                done = done | (moves & near)
                if done.all():
                    return Q, H, self.base.area_rate(Q)
                if not (moves & ~done).any():
                    break
            last, lost = (Q, H), ~done & ~((self.area(Q) > 0.0).all(axis=(1, 2)) & moves)
            Q, H = np.where(lost[:, None, None], guess[0], Q), np.where(lost[:, None], guess[1], H)
            try:
                K = self.scheme.jacobian(self.base, Q)
                jacobian = self.scheme.condense(self.operators.dt, K, H, self.venous)
            except np.linalg.LinAlgError:  # a state without a Jacobian: nothing to go on with
                break
        changes = np.abs(last[0] - before).max(axis=2)
        A_t = self.base.area_rate(last[0])
        A = self.A + self.operators.tau * A_t
        self.scheme.refuse(A, A_t, *last, changes, self.venous, done, self.t)

    def charge(self, Q: Array) -> Array:
        """P_C of the Windkessels at the end of the stage."""
        Q_out = Q[:, self.scheme.mesh.outlet_element, -1]
        return self.P_0 + self.operators.charge * Q_out

    def area(self, Q: Array) -> Array:
        """A at the Gauss points at the end of the stage."""
        return self.A + self.operators.tau * self.base.area_rate(Q)

    def correct(self, jacobian: Operators, Q: Array, H: Array) -> tuple[Array, Array]:
        """One chord iteration: momentum residual, condensation onto the nodes, nodal pressures, flow."""
        R = self.momentum_residual(Q, H)
        Q_free = Q - np.einsum("beij,bej->bei", jacobian.K_inverse, R)
        net = self.node_residual(Q_free, H)
        dH = np.matmul(jacobian.minus_G_inverse, net[..., None])[..., 0]
        at_ends = dH.take(self.scheme.mesh.ends, axis=1)
        Q_free += jacobian.K_left * at_ends[..., :1]
        Q_free += jacobian.K_right * at_ends[..., 1:]
        return Q_free, H + dH

    def momentum_residual(self, Q: Array, H: Array) -> Array:
        """Weak momentum per Lobatto point : (B, n_e, N+1) [Pa]."""
        scheme, operators = self.scheme, self.operators
        dQ = Q @ scheme.derivative  # ∂Q/∂ξ = J ∂Q/∂x
        A_t = self.base.leaking(dQ * scheme.minus_J_inverse)
        A = self.A + operators.tau * A_t
        U = (Q @ scheme.to_gauss) / A
        kinetic = scheme.kinetic * U
        P = self.base.wall.pressure(A, A_t)
        P += kinetic * U
        R = P @ scheme.pressure_flux  # -∫ (P + ½ρα U²) ∂v/∂x
        R += (kinetic * dQ / A) @ scheme.convection  # ∫ ρα (U/A) ∂Q/∂x v
        A_end = A @ scheme.to_lobatto
        R += (operators.inertia * (Q - self.Q) + scheme.friction * Q / A_end) / A_end
        if scheme.drag is not None:
            R += scheme.mass * self.base.drag(Q / A_end)
        U_end = Q[..., scheme.both_ends] / A_end[..., scheme.both_ends]
        flux = H.take(scheme.mesh.ends, axis=1)  # static pressure plus what the node does not keep of the kinetic one
        flux += scheme.end_kinetic * (U_end * U_end)
        R += flux @ scheme.end_flux
        return R

    def node_residual(self, Q: Array, H: Array) -> Array:
        """ΣQ at the nodes; inflow at the inlet; flow minus load at the outlets : (B, n_nodes) [m³/s]."""
        scheme, operators = self.scheme, self.operators
        outlets = scheme.mesh.topology.outlets
        ends = Q[..., scheme.both_ends].reshape(len(Q), -1)
        net = operators.node_scale * (ends @ scheme.incidence)
        net[:, 0] += self.inflow
        P = H[:, outlets]
        load = operators.p_scale * (P - self.P_0)
        if scheme.reflects:
            wall = scheme.outlet_wall
            A = wall.area(P - self.venous)
            load += scheme.coefficients.kappa * A * wall.riemann_velocity(A)
        net[:, outlets] -= load
        return net
