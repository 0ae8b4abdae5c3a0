"""The default scheme: staggered spectral elements in space, unsplit and implicit in time.

`massConserv_AQ` and `momentumConserv_AQ` with the wall of `sheep_constitutive`, the momentum divided by A/ρ:

    ∂A/∂t = -∂Q/∂x
    ρ/A ∂Q/∂t + ∂/∂x (P + ½ρα U²) + ρα (U/A) ∂Q/∂x + ρ C_f Q/A² = 0,     U = Q/A
    P = P_ref + P_el(A) + ν_s ∂A/∂t + ν_NL (∂A/∂t)²                       (the *total* pressure, pointwise)

Q lives at Lobatto points (degree N), A and P at Gauss points (degree N - 1), so ∂A/∂t = -∂Q/∂x holds pointwise and
mass is conserved to round-off. The momentum is tested with the Lobatto polynomials; pressure enters as natural
boundary flux. At every node one pressure H is the Lagrange multiplier that enforces ΣQ = 0. Outlets load the total
pressure. Time: the three-stage, third-order, L-stable and stiffly accurate SDIRK method of Alexander (1977). Each
stage is solved by chord iterations with the Jacobian at rest, factorised once per (parameters, dt): elements are
condensed onto the nodes. Why not Crank–Nicolson: one L-stable scheme serves elastic and viscous walls alike, so the
answer is continuous as φ0 → 0, and it does not ring when an input is held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .mesh import Parameters, build_mesh, coefficients
from .network import Network
from .wall import Wall

Array = np.ndarray

# Alexander (1977), SIAM J. Numer. Anal. 14, 1006: γ is the root of γ³ - 3γ² + 3γ/2 - 1/6 in (1/6, 1/2).
GAMMA = 0.43586652150845967
SDIRK3 = np.array(
    [
        [GAMMA, 0.0, 0.0],
        [(1.0 - GAMMA) / 2.0, GAMMA, 0.0],
        [-1.5 * GAMMA**2 + 4.0 * GAMMA - 0.25, 1.5 * GAMMA**2 - 5.0 * GAMMA + 1.25, GAMMA],
    ]
)
STAGES = len(SDIRK3)

# The inflow of a step is given at these parts of it: a cubic, which enters the stages as the method integrates its
# derivative. Imposing its values at the stages instead would cost the inlet pressure an order and a half (stage order).
INFLOW_TIMES = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_POWERS = np.arange(4)
_STAGE_POWERS = np.column_stack(
    [np.ones(STAGES), *(k * SDIRK3 @ SDIRK3.sum(axis=1) ** (k - 1) for k in _POWERS[1:])]
)  # ∫ k s^(k-1) ds = s^k, by the method: exact at the end of the step
INFLOW_AT_STAGES = _STAGE_POWERS @ np.linalg.inv(INFLOW_TIMES[:, None] ** _POWERS)

CORRECTIONS = 8  # chord iterations before the Jacobian is refreshed
REFRESHES = 5  # fresh Jacobians before the step is given up
_FLOW_FLOOR = 1e-14  # of A0 c0: updates below this are round-off of a network at rest


class NonPhysicalState(ArithmeticError):
    """The solution left what the equations describe. ``segment``, ``x`` [m] and ``t`` [s] say where and when."""

    def __init__(self, reason: str, segment: str, x: float, t: float, remedy: str) -> None:
        self.reason, self.segment, self.x, self.t = reason, segment, x, t
        super().__init__(f"segment {segment} at x = {100 * x:.3g} cm, t = {t:.6g} s: {reason}; {remedy}.")


@dataclass(frozen=True)
class Settings:
    """Numerical settings, chosen once: they do not depend on the wall, so that answers are continuous in φ0.

    dt : time step [s]. element_length : longest element [m]. degree : N of the flow polynomial.
    tolerance : last correction of Q in a stage, relative to the largest Q.
    """

    dt: float = 1e-3
    element_length: float = 0.05
    degree: int = 3
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        for name, low, high in (("dt", 1e-7, 0.1), ("element_length", 1e-4, 10.0), ("tolerance", 1e-13, 0.1)):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or not low <= value <= high:
                raise ValueError(f"settings: {name} = {value!r} must be a number in [{low:g}, {high:g}].")
        if not isinstance(self.degree, int) or not 1 <= self.degree <= 12:
            raise ValueError(f"settings: degree = {self.degree!r} must be an integer from 1 to 12.")


@dataclass(frozen=True)
class State:
    """Everything a step needs.

    A : (B, n_e, N) [m²]; Q : (B, n_e, N+1) [m³/s]; H : (B, n_nodes) [Pa]; P_C : (B, n_outlets) [Pa].

    rates, heads hold the stage values (∂Q/∂t and H) of the last step, the ``_before`` ones of the step before:
    they start the next iterations.
    """

    t: float
    A: Array
    Q: Array
    H: Array
    P_C: Array
    rates: Array  # (STAGES, B, n_e, N+1)
    heads: Array  # (STAGES, B, n_nodes)
    rates_before: Array
    heads_before: Array

    def restarted(self) -> State:
        """The same state without the memory of earlier steps, for a step of another length."""
        rates = np.broadcast_to(self.rates[-1], self.rates.shape)
        heads = np.broadcast_to(self.H, self.heads.shape)
        return replace(self, rates=rates, heads=heads, rates_before=rates, heads_before=heads)


@dataclass(frozen=True)
class Operators:
    """The factorised Jacobian of a stage of length τ = γ dt.

    inertia : (B, n_e, N+1) ρ w J/τ. K_inverse : (B, n_e, N+1, N+1) inverse momentum Jacobian of each element; K_left,
    K_right : (B, n_e, N+1) response of Q to the pressures at its ends. minus_G_inverse : (B, n_nodes, n_nodes), of the
    condensed nodal system.
    Outlets : node_scale Q = κ A w(A) + p_scale (P - P_0), P_0 = keep P_C + give P_venous; P_C becomes P_0 + charge Q.
    """

    dt: float
    tau: float
    inertia: Array
    K_inverse: Array
    K_left: Array
    K_right: Array
    minus_G_inverse: Array
    node_scale: Array
    p_scale: Array
    keep: Array
    give: Array
    charge: Array


class Staggered:
    """The scheme on one network with one parameter set, or with a batch of B of them (leading axis of every array).

    Raises ValueError for parameters that are not allowed.
    """

    def __init__(
        self, network: Network, parameters: Parameters | None = None, settings: Settings | None = None
    ) -> None:
        self.network = network
        self.settings = settings or Settings()
        self.coefficients = coefficients(network, parameters)
        L = self.coefficients.L.max(axis=0)
        self.mesh = build_mesh(network, L, self.settings.element_length, self.settings.degree)
        self._prepare()

    def with_parameters(self, parameters: Parameters) -> Staggered:
        """The same mesh with other coefficients: for parameters that change while a simulation runs."""
        other = object.__new__(Staggered)
        other.network, other.settings, other.mesh = self.network, self.settings, self.mesh
        other.coefficients = coefficients(self.network, parameters)
        other._prepare()
        return other

    def _prepare(self) -> None:
        """Arrays that every step uses, spread from segments (B, n_segments) to points (B, n_e, N) and (B, n_e, N+1)."""
        c, mesh, el = self.coefficients, self.mesh, self.mesh.element
        self.wall = c.wall.at(mesh.segment).spread(el.N)
        self.outlet_wall = c.wall.at(mesh.topology.outlet_segment)
        # full contiguous arrays: broadcasting over a last axis of length N is several times slower
        gauss, lobatto = (c.B, mesh.n_elements, el.N), (c.B, mesh.n_elements, el.N + 1)
        J = (c.L / mesh.count)[:, mesh.segment, None] / 2.0
        rho, alpha = c.rho[..., None], c.alpha[..., None]
        self.minus_J_inverse = np.broadcast_to(-1.0 / J, gauss).copy()
        self.mass = np.broadcast_to(rho * el.w_lobatto * J, lobatto).copy()
        self.friction = self.mass * c.C_f[..., None]
        self.kinetic = np.broadcast_to(0.5 * rho * alpha, gauss).copy()
        self.derivative = np.ascontiguousarray(el.derivative.T)
        self.to_gauss = np.ascontiguousarray(el.to_gauss.T)
        self.to_lobatto = np.ascontiguousarray(el.to_lobatto.T)
        self.pressure_flux = -el.w_gauss[:, None] * el.derivative
        self.convection = 2.0 * el.w_gauss[:, None] * el.to_gauss
        self.both_ends = slice(None, None, el.N)
        self.end_flux = np.zeros((2, el.N + 1))
        self.end_flux[0, 0], self.end_flux[1, -1] = -1.0, 1.0
        node_kinetic = np.zeros((c.B, mesh.n_nodes))
        node_kinetic[:, : mesh.topology.n_nodes] = 0.5 * c.rho * (c.alpha - mesh.topology.k)
        self.end_kinetic = node_kinetic[:, mesh.ends]
        self.incidence = np.ascontiguousarray(mesh.incidence.T)
        self.reflects, self.stores = bool(c.reflects.any()), bool(c.stores.any())
        self.A_rest = np.broadcast_to(self.wall.area(c.P_0[..., None]), gauss).copy()
        self._refuse_unreachable_pressure()
        self.flow_floor = _FLOW_FLOOR * float(np.min(self.wall.A0 * self.wall.wave_speed(self.wall.A0)))
        self._operators: dict[float, Operators] = {}

    def _refuse_unreachable_pressure(self) -> None:
        bad = ~(self.A_rest[..., 0] > 0.0)
        if bad.any():
            name = self.network.segments[self.mesh.segment[np.argwhere(bad)[0][1]]].name
            raise ValueError(
                f"network.P_0: the wall of segment {name} cannot carry the start pressure under the "
                f"{self.network.elastic_law} law; lower network.P_0 or raise {name}.E or {name}.h."
            )

    # --- operators ------------------------------------------------------------------------------------------------

    def operators(self, dt: float) -> Operators:
        """The factorised Jacobian at rest for steps of length dt [s]; made once per dt and kept."""
        if dt not in self._operators:
            if len(self._operators) >= 16:
                self._operators.clear()
            Q = np.zeros_like(self.mass)
            H = np.broadcast_to(self.coefficients.P_0, (self.coefficients.B, self.mesh.n_nodes))
            self._operators[dt] = self.condense(dt, self.jacobian(GAMMA * dt, self.A_rest, Q, Q), H, None)
        return self._operators[dt]

    def jacobian(self, tau: float, A: Array, Q: Array, Q_base: Array) -> Array:
        """∂R/∂Q : (B, n_e, N+1, N+1) of the momentum residual of a stage of length τ; A follows Q."""
        D, N = self.derivative.T, self.mesh.element.N
        A_t, U, Q_xi = self.area_rate(Q), (Q @ self.to_gauss) / A, Q @ self.derivative
        nu = self.wall.viscosity(A, A_t)
        dA_t = self.minus_J_inverse[..., None] * D
        dA = tau * dA_t
        dU = (self.to_gauss.T - U[..., None] * dA) / A[..., None]
        stiffness = self.wall.stiffness(A) - nu * A_t / A
        dP = stiffness[..., None] * dA + nu[..., None] * dA_t + (2.0 * self.kinetic * U)[..., None] * dU
        dC = Q_xi[..., None] * dU + U[..., None] * D - (U * Q_xi / A)[..., None] * dA
        dC *= (self.kinetic / A)[..., None]
        K = np.einsum("gi,begj->beij", self.pressure_flux, dP) + np.einsum("gi,begj->beij", self.convection, dC)
        A_end, dA_end = A @ self.to_lobatto, np.einsum("gi,begj->beij", self.to_lobatto, dA)
        inertia = self.mass / tau
        K -= ((inertia * (Q - Q_base) + 2.0 * self.friction * Q / A_end) / A_end**2)[..., None] * dA_end
        diagonal = np.arange(N + 1)
        K[:, :, diagonal, diagonal] += (inertia + self.friction / A_end) / A_end
        for end, sign in ((0, -1.0), (1, 1.0)):
            U_end = (Q / A_end)[..., -end]
            slope = (2.0 * sign * self.end_kinetic[..., end] * U_end / A_end[..., -end])[..., None]
            K[:, :, -end] -= slope * U_end[..., None] * dA_end[:, :, -end]
            K[:, :, -end, -end] += slope[..., 0]
        return K

    def condense(self, dt: float, K: Array, H: Array, venous: Array | None) -> Operators:
        """Invert the element Jacobians K and condense them onto the nodes; outlets linearised at H : (B, n_nodes)."""
        c, mesh, tau = self.coefficients, self.mesh, GAMMA * dt
        K_inverse = np.linalg.inv(K)
        K_left = np.ascontiguousarray(K_inverse[..., 0])
        K_right = np.ascontiguousarray(-K_inverse[..., -1])

        # a Windkessel's P_C over an SDIRK stage is a backward Euler step of length τ
        store = np.where(c.stores, tau / c.C, 0.0)
        keep = np.where(c.stores, 1.0 / (1.0 + store / c.R2), 0.0)
        give = np.where(c.stores, keep * store / c.R2, 1.0)
        impedance = c.R1 + keep * store
        wall = self.outlet_wall
        characteristic = c.rho * wall.c0 / wall.A0
        p_scale = np.where(c.reflects, 0.0, 1.0 / characteristic)
        node_scale = np.ones((c.B, mesh.n_nodes))
        node_scale[:, mesh.topology.outlets] = np.where(c.reflects, 1.0, impedance / characteristic)

        response = np.zeros((c.B, 2 * mesh.n_elements, mesh.n_nodes))
        e = np.arange(mesh.n_elements)
        for column, K_end in enumerate((K_left, K_right)):
            response[:, 2 * e, mesh.ends[:, column]] += K_end[..., 0]
            response[:, 2 * e + 1, mesh.ends[:, column]] += K_end[..., -1]
        G = node_scale[..., None] * (mesh.incidence @ response)
        out = np.arange(mesh.n_nodes)[mesh.topology.outlets]
        A = wall.area(H[:, mesh.topology.outlets] - (c.P_venous if venous is None else venous))
        # d(A w)/dP = (w + c)/(dP/dA)
        slope = c.kappa * (wall.riemann_velocity(A) + wall.wave_speed(A)) / wall.stiffness(A)
        G[:, out, out] -= np.where(c.reflects, slope, p_scale)
        return Operators(
            dt=dt,
            tau=tau,
            inertia=self.mass / tau,
            K_inverse=K_inverse,
            K_left=K_left,
            K_right=K_right,
            minus_G_inverse=-np.linalg.inv(G),
            node_scale=node_scale,
            p_scale=p_scale,
            keep=keep,
            give=give,
            charge=keep * store,
        )

    # --- time -----------------------------------------------------------------------------------------------------

    def initial_state(self, t: float = 0.0) -> State:
        """Fluid at rest under the uniform pressure P_0."""
        c, mesh, n = self.coefficients, self.mesh, self.mesh.element.N + 1
        Q = np.zeros((c.B, mesh.n_elements, n))
        H = np.broadcast_to(c.P_0, (c.B, mesh.n_nodes)).copy()
        P_C = np.broadcast_to(c.P_0, c.C.shape) * c.stores
        rates, heads = np.zeros((STAGES, *Q.shape)), np.broadcast_to(H, (STAGES, *H.shape))
        return State(t, self.A_rest, Q, H, P_C, rates, heads, rates, heads)

    def step(self, state: State, dt: float, inflow: Array, P_venous: Array | None = None) -> State:
        """Advance by dt [s].

        inflow : (4,) or (4, B) [m³/s] at the times t + INFLOW_TIMES dt. P_venous : (n_outlets,) or
        (B, n_outlets) [Pa] during the step, default the parameters'.
        Raises NonPhysicalState if the result is not physical.
        """
        operators = self.operators(dt)
        Q_in = INFLOW_AT_STAGES @ inflow
        venous = self.coefficients.P_venous if P_venous is None else P_venous
        guess_rates = 2.0 * state.rates - state.rates_before
        guess_heads = 2.0 * state.heads - state.heads_before
        rates, heads = np.empty_like(guess_rates), np.empty_like(guess_heads)
        # the last two stage values, extrapolated, leave so little to correct that one iteration is the rule
        A_t: list[Array] = []
        C_t: list[Array] = []
        size = np.maximum(np.abs(state.Q).max(axis=(1, 2)), np.abs(Q_in[-1]))
        small = self.settings.tolerance * size + self.flow_floor
        with np.errstate(all="ignore"):
            for i in range(STAGES):
                A, Q, P_C = state.A, state.Q, state.P_C
                for j in range(i):
                    weight = dt * SDIRK3[i, j]
                    A = A + weight * A_t[j]
                    Q = Q + weight * rates[j]
                    P_C = P_C + weight * C_t[j]
                stage = _Stage(self, operators, A, Q, P_C, Q_in[i], venous, state.t + dt)
                Q_i, heads[i], A_t_i = stage.solve(Q + operators.tau * guess_rates[i], guess_heads[i], small)
                A_t.append(A_t_i)
                rates[i] = (Q_i - Q) / operators.tau
                charged = stage.charge(Q_i) if self.stores else P_C
                C_t.append((charged - P_C) / operators.tau)
            A_new = A + operators.tau * A_t_i
            self.check(A_new, A_t_i, Q_i, state.t + dt)
        return State(state.t + dt, A_new, Q_i, heads[-1], charged, rates, heads, state.rates, state.heads)

    def area_rate(self, Q: Array) -> Array:
        """∂A/∂t = -∂Q/∂x at the Gauss points (`massConserv_AQ`) : (B, n_e, N) [m²/s]."""
        return (Q @ self.derivative) * self.minus_J_inverse

    def check(self, A: Array, A_t: Array, Q: Array, t: float, converged: bool = True) -> None:
        """Raise NonPhysicalState unless A > 0, effective viscosity > 0, |U| < c, and the iteration converged."""
        if not np.min(A) > 0.0:
            where = np.where(np.isnan(A), -np.inf, A)
            self._fail(where, t, "the area fell to zero or below", "lower the inflow or check R0, E and h there")
        if self.wall.nonlinear:
            relative = self.wall.relative_viscosity(A, A_t)
            if not np.min(relative) > 0.0:
                rate = self.wall.strain_rate(A, A_t).ravel()[np.argmin(relative)]
                reason = (
                    f"the effective wall viscosity phi0 + 2 phiNL * rate turned negative at strain rate {rate:.3g} 1/s"
                )
                self._fail(relative, t, reason, 'use viscous_law = "monotone" or a smaller |phiNL/phi0|')
        U = (Q @ self.to_gauss) / A
        speed = self.wall.wave_speed(A)
        if not np.min(speed) > 0.0:
            where = np.where(np.isnan(speed), -np.inf, speed)
            self._fail(
                where, t, "the wall has no stiffness left (dP/dA <= 0)", "use a smaller |ENL/E| or a lower pressure"
            )
        subcritical = speed - np.abs(U)
        if not np.min(subcritical) > 0.0:
            self._fail(subcritical, t, "the flow is supercritical (|Q/A| >= c)", "lower the inflow or stiffen the wall")
        if not converged:
            # the least stretched margin is as good a place as any to look at
            self._fail(subcritical, t, "the step did not converge", "use a smaller dt or check the parameters there")

    def _fail(self, margin: Array, t: float, reason: str, remedy: str) -> None:
        """Raise NonPhysicalState at the point (b, e, g) where ``margin`` : (B, n_e, N) is smallest."""
        b, e, g = np.unravel_index(int(np.nanargmin(margin)), margin.shape)
        s = self.mesh.segment[e]
        place = (e - self.mesh.first[s] + (self.mesh.element.x_gauss[g] + 1.0) / 2.0) / self.mesh.count[s]
        name = self.network.segments[s].name
        if self.coefficients.batched:
            reason += f" in parameter set {b} of the batch"
        raise NonPhysicalState(reason, name, float(place * self.coefficients.L[b, s]), t, remedy)


class _Stage:
    """One implicit stage: given A, Q, P_C at its base, find Q and the nodal pressures H at its end."""

    def __init__(
        self,
        scheme: Staggered,
        operators: Operators,
        A: Array,
        Q: Array,
        P_C: Array,
        inflow: Array,
        venous: Array,
        t: float,
    ) -> None:
        self.scheme, self.operators, self.t = scheme, operators, t
        self.A, self.Q, self.P_C, self.inflow, self.venous = A, Q, P_C, inflow, venous
        self.P_0 = operators.keep * P_C + operators.give * venous

    def solve(self, Q: Array, H: Array, small: Array) -> tuple[Array, Array, Array]:
        """Chord iterations from a guess until Q changes by less than ``small`` : (B,); returns Q, H and ∂A/∂t."""
        jacobian, done, guess = self.operators, None, (Q, H)
        for _ in range(1 + REFRESHES):
            for _ in range(CORRECTIONS):
                Q_new, H_new = self.correct(jacobian, Q, H)
                change = np.abs(Q_new - Q).max(axis=(1, 2))
                if done is not None:  # a member of a batch that has converged stays what it is alone
                    Q_new = np.where(done[:, None, None], Q, Q_new)
                    H_new = np.where(done[:, None], H, H_new)
                    change = np.where(done, 0.0, change)
                Q, H = Q_new, H_new
                done = change <= small
                if done.all():
                    return Q, H, self.scheme.area_rate(Q)
                if not np.isfinite(change).all():
                    break
            A, failed = self.area(Q), Q
            if not np.min(A) > 0.0:  # thrown off: start again from the guess, with the Jacobian there
                (Q, H), done = guess, None
                A = self.area(Q)
                if not np.min(A) > 0.0:
                    break
            K = self.scheme.jacobian(self.operators.tau, A, Q, self.Q)
            jacobian = self.scheme.condense(self.operators.dt, K, H, self.venous)
        A_t = self.scheme.area_rate(failed)
        self.scheme.check(self.area(failed), A_t, failed, self.t, converged=False)
        raise AssertionError("check raises when the iteration did not converge")

    def charge(self, Q: Array) -> Array:
        """P_C of the Windkessels at the end of the stage."""
        Q_out = Q[:, self.scheme.mesh.outlet_element, -1]
        return self.P_0 + self.operators.charge * Q_out

    def area(self, Q: Array) -> Array:
        """A at the Gauss points at the end of the stage."""
        return self.A + self.operators.tau * self.scheme.area_rate(Q)

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
        A_t = dQ * scheme.minus_J_inverse
        A = self.A + operators.tau * A_t
        U = (Q @ scheme.to_gauss) / A
        kinetic = scheme.kinetic * U
        P = scheme.wall.pressure(A, A_t)
        P += kinetic * U
        R = P @ scheme.pressure_flux  # -∫ (P + ½ρα U²) ∂v/∂x
        R += (kinetic * dQ / A) @ scheme.convection  # ∫ ρα (U/A) ∂Q/∂x v
        A_end = A @ scheme.to_lobatto
        R += (operators.inertia * (Q - self.Q) + scheme.friction * Q / A_end) / A_end
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


# --- what is reported ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reporter:
    """Turns states into the outputs, in the order of ``names``: the FMU's variables and the columns of a result."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    report: Callable[[State], Array]

    def __call__(self, state: State) -> Array:
        """(B, n_outputs) SI values."""
        return self.report(state)


def reporter(scheme: Staggered) -> Reporter:
    """Outputs of a network: inlet.P, <site>.P, .Q, .R and <outlet>.outlet.P, .Q.

    At a site A and ∂Q/∂x are interpolated and P follows from the wall law; the nodal pressures are the multipliers H.
    """
    network, mesh = scheme.network, scheme.mesh
    index = {segment.name: i for i, segment in enumerate(network.segments)}
    segment = np.array([index[site.segment] for site in network.sites], int)
    position = np.array([site.position for site in network.sites])
    gauss, lobatto = mesh.sample_gauss(segment, position).T, mesh.sample_lobatto(segment, position).T
    wall: Wall = scheme.coefficients.wall.at(segment)
    n, B = len(segment), scheme.coefficients.B
    outlets, outlet_element = mesh.topology.outlets, mesh.outlet_element
    names, units = output_variables(network)
    sites = slice(1, 1 + 3 * n)

    def report(state: State) -> Array:
        result = np.empty((B, len(names)))
        result[:, 0] = state.H[:, 0]
        A_t = scheme.area_rate(state.Q).reshape(B, -1) @ gauss
        A = state.A.reshape(B, -1) @ gauss
        at_sites = result[:, sites].reshape(B, n, 3)
        at_sites[..., 0] = wall.pressure(A, A_t)
        at_sites[..., 1] = state.Q.reshape(B, -1) @ lobatto
        at_sites[..., 2] = np.sqrt(A / np.pi)
        result[:, sites] = at_sites.reshape(B, -1)
        result[:, 1 + 3 * n :: 2] = state.H[:, outlets]
        result[:, 2 + 3 * n :: 2] = state.Q[:, outlet_element, -1]
        return result

    return Reporter(names, units, report)


def output_variables(network: Network) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and SI units of the outputs of a network."""
    rows = [("inlet.P", "Pa")]
    for site in network.sites:
        rows += [(f"{site.name}.P", "Pa"), (f"{site.name}.Q", "m^3/s"), (f"{site.name}.R", "m")]
    for outlet in network.outlets:
        rows += [(f"{outlet.segment}.outlet.P", "Pa"), (f"{outlet.segment}.outlet.Q", "m^3/s")]
    return tuple(name for name, _ in rows), tuple(unit for _, unit in rows)
