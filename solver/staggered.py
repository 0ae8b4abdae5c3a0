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

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from .effect import Drag, Effect, Points
from .mesh import Parameters, build_mesh, coefficients
from .network import Network
from .sdirk import GAMMA, INFLOW_AT_STAGES, SDIRK3, STAGES
from .stage import Base, Memory, Stage

Array = np.ndarray

_PRESSURES = 10.0  # nodal pressures, which follow the flows' rates, may be off by this much more than the flows
_ROUND_OFF = 1e-13  # of A0 c0 and of the wall stiffness: smaller corrections are round-off of a network at rest


class NonPhysicalState(ArithmeticError):
    """The solution left what the equations describe. ``segment``, ``x`` [m] and ``t`` [s] say where and when."""

    def __init__(self, reason: str, segment: str, x: float, t: float, remedy: str) -> None:
        self.reason, self.segment, self.x, self.t = reason, segment, x, t
        super().__init__(f"segment {segment} at x = {100 * x:.3g} cm, t = {t:.6g} s: {reason}; {remedy}.")


@dataclass(frozen=True)
class Settings:
    """Numerical settings, chosen once: they do not depend on the wall, so that answers are continuous in φ0.

    dt : time step [s]. element_length : longest element [m]. degree : N of the flow polynomial.
    tolerance : last correction of the flows in a stage, relative to the largest; of the nodal pressures ten times that.
    """

    dt: float = 1e-3
    element_length: float = 0.05
    degree: int = 3
    tolerance: float = 3e-5

    def __post_init__(self) -> None:
        limits = (("dt", "s", 1e-7, 0.1), ("element_length", "m", 1e-4, 10.0), ("tolerance", "", 1e-13, 0.1))
        for name, unit, low, high in limits:
            value = getattr(self, name)
            if not isinstance(value, (int, float, np.number)) or not low <= value <= high:
                allowed = f"[{low:g}, {high:g}] {unit}".rstrip()
                raise ValueError(f"settings: {name} = {value!r} must be a number in {allowed}.")
        if not isinstance(self.degree, (int, np.integer)) or not 1 <= self.degree <= 12:
            raise ValueError(f"settings: degree = {self.degree!r} must be an integer from 1 to 12.")


@dataclass(frozen=True)
class State:
    """Everything a step needs.

    A : (B, n_e, N) [m²]; Q : (B, n_e, N+1) [m³/s]; H : (B, n_nodes) [Pa]; P_C : (B, n_outlets) [Pa].

    rates, heads hold the stage values (∂Q/∂t and H) of the last step, the ``_before`` ones of the step before:
    they start the next iterations. A_t : like A, ∂A/∂t at the end of the step. Memory, None where no wall and no fluid
    has one: stress : like A, viscous stress [Pa]; history : (m, B, n_e, N+1) [m/s], y - U of each
    :class:`~solver.effect.Drag` term.
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
    A_t: Array
    stress: Array | None = None
    history: Array | None = None

    def members(self, index: Array | slice) -> State:
        """The state of some members of a batch."""
        changed: dict[str, Any] = {}
        for name, batch_axis in _STATE_AXES.items():
            array = getattr(self, name)
            if array is not None:
                changed[name] = array[index] if batch_axis == 0 else array[:, index]
        return replace(self, **changed)


_STATE_AXES = {"A": 0, "Q": 0, "H": 0, "P_C": 0, "A_t": 0, "stress": 0}
_STATE_AXES |= {"rates": 1, "heads": 1, "rates_before": 1, "heads_before": 1, "history": 1}


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


def _ahead(memory: Memory, weight: float, rates: Memory, scale: float = 1.0) -> Memory:
    """scale (memory + weight rates), where there is memory."""
    if memory[0] is None and memory[1] is None:
        return memory
    stress, history = (
        None if m is None or r is None else scale * (m + weight * r) for m, r in zip(memory, rates, strict=True)
    )
    return stress, history


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
        cuts = self.coefficients.cuts
        self.mesh = build_mesh(network, L, self.settings.element_length, self.settings.degree, cuts)
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
        x = mesh.positions(el.x_gauss)
        self.wall = c.wall_at(np.repeat(mesh.segment, el.N), x.ravel()).shaped(x.shape)
        self.outlet_wall = c.wall_at(mesh.topology.outlet_segment, np.ones(len(mesh.topology.outlet_segment)))
        # full contiguous arrays: broadcasting over a last axis of length N is several times slower
        gauss, lobatto = (c.B, mesh.n_elements, el.N), (c.B, mesh.n_elements, el.N + 1)
        J = (c.L[:, mesh.segment] / mesh.parts)[..., None] / 2.0
        rho, alpha = c.rho[..., None], c.alpha[..., None]
        self.minus_J_inverse = np.broadcast_to(-1.0 / J, gauss).copy()
        self.mass = np.broadcast_to(rho * el.w_lobatto * J, lobatto).copy()
        self.friction = self.mass * c.C_f[..., None]
        self.drag = self._drag()
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
        node_kinetic[:, : mesh.topology.n_nodes] = 0.5 * c.rho * (c.alpha - c.k)
        self.end_kinetic = node_kinetic[:, mesh.ends]
        self.incidence = np.ascontiguousarray(mesh.incidence.T)
        self.inlet_element = mesh.inlet_element
        self.reflects, self.stores = bool(c.reflects.any()), bool(c.stores.any())
        self.A_rest = np.broadcast_to(self.wall.area(c.P_0[..., None]), gauss).copy()
        self._refuse_unreachable_pressure()
        # scales per member, so that nobody's neighbour matters: ρc0/A0 turns flow into pressure
        self.flow_floor = _ROUND_OFF * np.min(self.wall.A0 * self.wall.c0, axis=(1, 2))
        self.pressure_floor = _ROUND_OFF * np.max(np.abs(self.wall.K), axis=(1, 2))
        self.impedance = np.min(self.wall.rho * self.wall.c0 / self.wall.A0, axis=(1, 2))
        # the outlet whose venous pressure a leak of each element meets; one more that stands for 0 Pa
        sink = np.full(c.L.shape[1], len(mesh.topology.outlet_segment))
        sink[mesh.topology.outlet_segment] = np.arange(len(mesh.topology.outlet_segment))
        self.sink = sink[mesh.segment]
        self._operators: dict[float, Operators] = {}

    def _drag(self) -> Drag | None:
        """The forces on the flow of the effects that are on, together."""
        c, mesh, el = self.coefficients, self.mesh, self.mesh.element
        if not any(type(term.effect).drag is not Effect.drag for term in c.terms):
            return None
        x = mesh.positions(el.x_lobatto)
        wall = c.wall_at(np.repeat(mesh.segment, el.N + 1), x.ravel()).shaped(x.shape)
        centre = mesh.positions(np.zeros(1))
        points = Points(x, centre, np.sqrt(wall.A0 / np.pi), c.L[:, mesh.segment, None], c.nu[..., None])
        found = None
        for term in c.terms:
            values = term.at(mesh.segment) if term.effect.owner == "segment" else term.values
            drag = term.effect.drag({key: value[..., None] for key, value in values.items()}, points)
            found = drag if found is None else found if drag is None else found + drag
        return found

    def _refuse_unreachable_pressure(self) -> None:
        c, law = self.coefficients, self.network.elastic_law
        bad = ~(self.A_rest[..., 0] > 0.0)
        if bad.any():
            name = self.network.segments[self.mesh.segment[np.argwhere(bad)[0][1]]].name
            raise ValueError(
                f"network.P_0: the wall of segment {name} cannot carry the start pressure under the "
                f"{law} law; lower network.P_0 or raise {name}.E or {name}.h."
            )
        bad = c.reflects & ~(self.outlet_wall.area(c.P_0 - c.P_venous) > 0.0)
        if bad.any():
            name = self.network.outlets[np.argwhere(bad)[0][1]].segment
            raise ValueError(
                f"{name}.outlet.P_venous: the wall at the outlet cannot carry P_0 - P_venous under the {law} law; "
                f"bring {name}.outlet.P_venous nearer to network.P_0."
            )

    # --- operators ------------------------------------------------------------------------------------------------

    def operators(self, dt: float) -> Operators:
        """The factorised Jacobian at rest for steps of length dt [s]; made once per dt and kept."""
        if dt not in self._operators:
            if len(self._operators) >= 16:
                self._operators.clear()
            H = np.broadcast_to(self.coefficients.P_0, (self.coefficients.B, self.mesh.n_nodes))
            rest = Base(self, GAMMA * dt, self.A_rest, np.zeros_like(self.mass), *self._rest_memory())
            self._operators[dt] = self.condense(dt, self.jacobian(rest, rest.Q), H, None)
        return self._operators[dt]

    def jacobian(self, base: Base, Q: Array) -> Array:
        """∂R/∂Q : (B, n_e, N+1, N+1) of the momentum residual of a stage from ``base``; A follows Q."""
        D, N, tau, wall = self.derivative.T, self.mesh.element.N, base.tau, base.wall
        A_t = base.area_rate(Q)
        A = base.A + tau * A_t
        U, Q_xi = (Q @ self.to_gauss) / A, Q @ self.derivative
        nu = wall.viscosity(A, A_t)
        stiffness = wall.stiffness(A) + wall.viscous_slope(A, A_t)
        dA_t = self.minus_J_inverse[..., None] * D
        if wall.leak is not None:
            dA_t = dA_t / (1.0 + wall.leak * (tau * stiffness + nu))[..., None]
        dA = tau * dA_t
        dU = (self.to_gauss.T - U[..., None] * dA) / A[..., None]
        dP = stiffness[..., None] * dA + nu[..., None] * dA_t + (2.0 * self.kinetic * U)[..., None] * dU
        dC = Q_xi[..., None] * dU + U[..., None] * D - (U * Q_xi / A)[..., None] * dA
        dC *= (self.kinetic / A)[..., None]
        K = np.einsum("gi,begj->beij", self.pressure_flux, dP) + np.einsum("gi,begj->beij", self.convection, dC)
        A_end, dA_end = A @ self.to_lobatto, np.einsum("gi,begj->beij", self.to_lobatto, dA)
        inertia = self.mass / tau
        slope = (inertia * (Q - base.Q) + 2.0 * self.friction * Q / A_end) / A_end**2
        diagonal = np.arange(N + 1)
        K[:, :, diagonal, diagonal] += (inertia + self.friction / A_end) / A_end
        if self.drag is not None:
            dF = self.mass * base.drag_slope(Q / A_end) / A_end
            slope += dF * Q / A_end
            K[:, :, diagonal, diagonal] += dF
        K -= slope[..., None] * dA_end
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
        A_t = np.zeros_like(self.A_rest)
        return State(t, self.A_rest, Q, H, P_C, rates, heads, rates, heads, A_t, *self._rest_memory())

    def _rest_memory(self) -> Memory:
        """Memory of a fluid and walls that have been at rest for ever."""
        return (
            None if self.wall.tau is None else np.zeros_like(self.A_rest),
            None if self.drag is None else np.zeros((len(self.drag.rate), *self.mass.shape)),
        )

    def adopt(self, state: State) -> State:
        """A state of this mesh under other parameters, ready for these: memory is added where it lacks, or dropped.

        The stress of a wall that had no memory is that of its strain rate, the history of a fluid none. The state of
        one member serves a whole batch. Raises ValueError for a batch of another size.
        """
        B, members = self.coefficients.B, len(state.Q)
        if members not in (1, B):
            raise ValueError(f"the state is one of {members} parameter sets, not of {B}; take one member of it.")
        if members != B:
            state = state.members(np.zeros(B, int))
        stress, history = self._rest_memory()
        if stress is not None:
            stress = self.wall.viscous_stress(state.A, state.A_t) if state.stress is None else state.stress
        if history is not None:
            kept = state.history is not None and state.history.shape == history.shape
            history = state.history if kept else np.broadcast_to(-state.Q / (state.A @ self.to_lobatto), history.shape)
        return replace(state, stress=stress, history=history)

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
        flow = np.maximum(np.abs(state.Q).reshape(len(state.Q), -1).max(axis=1), np.abs(Q_in[-1]))
        pressure = np.abs(state.H - self.coefficients.P_0).max(axis=1)
        small = (
            self.settings.tolerance * flow + self.flow_floor,
            _PRESSURES * self.settings.tolerance * np.maximum(pressure, flow * self.impedance) + self.pressure_floor,
        )
        # where the inflow jumps (a held input that is set anew) the flow at the inlet starts from its new value: spread
        # over the step, the jump would show in the inlet pressure as its inertia divided by dt
        Q_start = state.Q.copy()
        Q_start[:, self.inlet_element, 0] = inflow[0]
        memory_t: list[Memory] = []
        with np.errstate(all="ignore"):
            for i in range(STAGES):
                A, Q, P_C, memory = state.A, Q_start, state.P_C, (state.stress, state.history)
                for j in range(i):
                    weight = dt * SDIRK3[i, j]
                    A = A + weight * A_t[j]
                    Q = Q + weight * rates[j]
                    P_C = P_C + weight * C_t[j]
                    memory = _ahead(memory, weight, memory_t[j])
                base = Base(self, operators.tau, A, Q, *memory, venous=venous)
                stage = Stage(self, operators, base, P_C, Q_in[i], venous, state.t + dt)
                Q_i, heads[i], A_t_i = stage.solve(Q + operators.tau * guess_rates[i], guess_heads[i], small)
                A_t.append(A_t_i)
                rates[i] = (Q_i - Q) / operators.tau
                charged = stage.charge(Q_i) if self.stores else P_C
                C_t.append((charged - P_C) / operators.tau)
                remembered = base.memory(Q_i, A_t_i)
                memory_t.append(_ahead(remembered, -1.0, memory, 1.0 / operators.tau))
            A_new = A + operators.tau * A_t_i
            self.check(A_new, A_t_i, Q_i, state.t + dt)
        return State(
            state.t + dt, A_new, Q_i, heads[-1], charged, rates, heads, state.rates, state.heads, A_t_i, *remembered
        )

    def area_rate(self, Q: Array) -> Array:
        """-∂Q/∂x at the Gauss points : (B, n_e, N) [m²/s], which is ∂A/∂t where nothing leaks (`massConserv_AQ`)."""
        return (Q @ self.derivative) * self.minus_J_inverse

    def check(self, A: Array, A_t: Array, Q: Array, t: float) -> None:
        """Raise NonPhysicalState unless A > 0, effective viscosity > 0, dP/dA > 0 and |U| < c everywhere."""
        for margin, reason, remedy in self._margins(A, A_t, Q):
            if not margin.min() > 0.0:
                self._fail(margin, t, reason(), remedy)

    def refuse(
        self, A: Array, A_t: Array, Q: Array, H: Array, changes: Array, venous: Array, done: Array, t: float
    ) -> NoReturn:
        """Raise NonPhysicalState for a stage that did not converge: by outlets, then by :meth:`check`, else as such.

        A, A_t, Q, H : the last finite iterate. changes : (B, n_e) of Q in it. ``done`` members are not to blame.
        """
        blame = ~done
        outlet = self.outlet_wall.area(H[:, self.mesh.topology.outlets] - venous)
        for b, o in np.argwhere(blame[:, None] & self.coefficients.reflects & ~(outlet > 0.0)):
            outlet_segment = self.network.segments[self.mesh.topology.outlet_segment[o]]
            raise NonPhysicalState(
                "the wall at the outlet cannot carry the pressure P - P_venous" + self._member(int(b)),
                outlet_segment.name,
                float(self.coefficients.L[b, self.mesh.topology.outlet_segment[o]]),
                t,
                f"check {outlet_segment.name}.outlet.P_venous and the elastic law",
            )
        innocent = np.where(done, np.inf, 0.0)[:, None, None]
        for margin, reason, remedy in self._margins(A, A_t, Q):
            if not np.min(margin + innocent) > 0.0:
                self._fail(margin + innocent, t, reason(), remedy)
        margin = innocent - changes[..., None] / self.wall.A0
        self._fail(margin, t, "the step did not converge", "use a smaller dt or check the parameters there")

    def _margins(self, A: Array, A_t: Array, Q: Array) -> Iterator[tuple[Array, Callable[[], str], str]]:
        """What must stay positive : (B, n_e, N), how to say that it does not, and the remedy; in the order to ask."""
        if self.wall.nonlinear:
            # asked first: where it is negative the iteration diverges, and the area with it
            relative = np.nan_to_num(self.wall.relative_viscosity(A, A_t), nan=np.inf)
            remedy = 'use viscous_law = "monotone", a smaller |phiNL/phi0| or a lower inflow'
            yield relative, lambda: self._viscosity_reason(relative), remedy
        yield A, lambda: "the area fell to zero or below", "lower the inflow or check R0, E and h there"
        speed = self.wall.wave_speed(A)
        yield speed, lambda: "the wall has no stiffness left (dP/dA <= 0)", "use a smaller |ENL/E| or pressure"
        subcritical = speed - np.abs((Q @ self.to_gauss) / A)
        yield subcritical, lambda: "the flow is supercritical (|Q/A| >= c)", "lower the inflow or stiffen the wall"

    def _viscosity_reason(self, relative: Array) -> str:
        r = np.broadcast_to(self.wall.r, relative.shape).ravel()[np.argmin(relative)]
        return f"the effective wall viscosity turned negative: the strain rate passed {-0.5 / r:.3g} 1/s"

    def _member(self, b: int) -> str:
        return f" in parameter set {b} of the batch" if self.coefficients.batched else ""

    def _fail(self, margin: Array, t: float, reason: str, remedy: str) -> NoReturn:
        """Raise NonPhysicalState at the point (b, e, g) where ``margin`` : (B, n_e, N) is smallest."""
        b, e, g = np.unravel_index(int(np.argmin(np.nan_to_num(margin, nan=-np.inf))), margin.shape)
        s = self.mesh.segment[e]
        place = self.mesh.positions(self.mesh.element.x_gauss)[e, g]
        x = float(place * self.coefficients.L[b, s])
        raise NonPhysicalState(reason + self._member(int(b)), self.network.segments[s].name, x, t, remedy)
