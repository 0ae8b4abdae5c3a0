"""The periodic flow in a network, by harmonic balance.

    ∂A/∂t + ∂Q/∂x = -g (P - P_venous)
    ∂Q/∂t + ∂/∂x (α Q²/A) + (A/ρ) ∂P/∂x + C_f Q/A + S + F_u = 0,      C_f = friction π ν
    S = K Q|Q| / (2 ℓ A) in a stenosis of length ℓ:  Δp = K (ρ/2) Q|Q|/A²
    F_u = s A W * (Q/A),   Ŵ(ω) = iω F/(1 - F) - 8ν/R0²,   F = 2 J1(λ)/(λ J0(λ)),   λ = R0 √(-iω/ν)

F_u is Womersley's exact wall shear in a rigid tube less its quasi-steady part; the same as Zielke's convolution
(4ν/R0²) Σ exp(-j²νt/R0²) * ∂U/∂t over the zeros j of J2. Nodes: ΣQ = 0, and P + k (ρ/2)(Q/A)² equal. Ends: see
:class:`~.anatomy.End`; a reflection is Q = (1 - R_t)/(1 + R_t) A_e w(A_e) with the elastic area A_e of P - P_venous.

Space as in ``pieces.py``. Products are formed at the time samples, linear memory by Fourier multipliers. The system
linearised about the mean state is exact per harmonic: pieces are condensed onto their left ends, and the rest is left
to Anderson's iteration, until the correction falls below ``TOLERANCE`` of the pulse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ive

from .anatomy import Anatomy, End
from .beat import Beat, anderson
from .pieces import Node, Piece, cut, points, row_at
from .wall import Walls, wall_at, walls_of

Array = np.ndarray

TOLERANCE = 1e-8
_ROUNDS = 6  # linearisations about the mean state
_SWEEPS = 25  # iterations with one linearisation
_SMALL_PULSE = 1e-5  # of A0 and A0 c0: a smaller pulse cannot be told from round-off to TOLERANCE
_DEPTH = 8  # corrections that Anderson's iteration combines


class NoPeriodicFlow(ArithmeticError):
    """The iteration did not converge to a periodic flow."""


@dataclass(frozen=True)
class Flow:
    """A periodic flow: coefficients (K + 1, pieces, 2, n) of A/A0 and Q/(A0 c0), its channels, and the linearised
    equations that led to it."""

    unknown: Array
    channels: dict[str, Array]
    iterations: int
    correction: float
    linear: Linearised


class Balance:
    """The equations of one network for one period."""

    def __init__(self, model: Anatomy, beat: Beat, n: int = 10) -> None:
        self.model, self.beat, self.n = model, beat, n
        self.pieces, self.nodes = cut(model)
        self.p = len(self.pieces)
        start = np.array([piece.start for piece in self.pieces])[:, None]
        stop = np.array([piece.stop for piece in self.pieces])[:, None]
        self.points = points(n)
        self.walls = walls_of(
            model, [piece.vessel for piece in self.pieces], start + (stop - start) * self.points.xi, beat
        )
        self.resting = self.walls.at_rest()
        self._constants()

    def _constants(self) -> None:
        """Arrays (pieces, 1, 1) that the equations use, and the sizes that scale them."""
        m, pieces = self.model, self.pieces

        def column(value: Callable[[Piece], float]) -> Array:
            return np.array([value(piece) for piece in pieces])[:, None, None]

        self.length = column(lambda piece: piece.length)
        self.leak = column(lambda piece: piece.vessel.leak)
        self.loss = column(lambda piece: piece.vessel.K / (2.0 * piece.vessel.L))
        self.friction = m.friction * np.pi * m.nu
        self.venous = np.mean([end.P_venous for end in m.ends])
        middle = self.n // 2
        self.A_size = self.walls.A0[:, middle : middle + 1]
        self.c_size = np.sqrt(self.walls.K[:, middle : middle + 1] / (2.0 * m.rho))
        self.Q_size = self.A_size * self.c_size
        R0 = np.sqrt(self.walls.A0 / np.pi)
        self.shear = m.unsteady * womersley_excess(R0, m.nu, self.beat.omega) if m.unsteady else None

    # --- the state -------------------------------------------------------------------------------------------------

    def rest(self) -> Array:
        """The unknowns at rest under P_0."""
        s = self.resting.stretch(self.model.P_0 - self.walls.P_level)
        unknown = np.zeros((self.beat.K + 1, self.p, 2, self.n), complex)
        unknown[0, :, 0] = (self.walls.A0 * s * s / self.A_size)[..., 0]
        return unknown

    def fields(self, unknown: Array) -> tuple[Array, Array, Array, Array]:
        """A [m²], Q [m³/s], ∂A/∂t, P [Pa] at the points : (pieces, n, samples)."""
        c = np.moveaxis(unknown, 0, -1)
        A_c, Q_c = c[:, 0] * self.A_size, c[:, 1] * self.Q_size
        A, Q = self.beat.values(A_c), self.beat.values(Q_c)
        if not (A > 0.0).all():
            raise NoPeriodicFlow("the area of the iterate is not positive")
        A_t = self.beat.values(1j * self.beat.omega * A_c)
        return A, Q, A_t, self.walls.pressure(A, A_t)

    # --- the equations ---------------------------------------------------------------------------------------------

    def residual(self, unknown: Array, inflow: Array) -> tuple[Array, Array]:
        """Scaled residuals: (K + 1, pieces, 2 (n - 1)) inside, (K + 1, 2 pieces) at the ends."""
        m, beat, G, D = self.model, self.beat, self.points.to_gauss, self.points.slope / self.length
        A, Q, A_t, P = self.fields(unknown)
        U = Q / A
        mass = D @ Q + G @ (A_t + self.leak * (P - self.venous))
        sink = self.friction * U + self.loss * np.abs(Q) * U
        if self.shear is not None:
            sink = sink + A * beat.filtered(U, self.shear)
        Q_t = beat.filtered(Q, 1j * beat.omega)
        momentum = D @ (m.alpha * Q * U) + (G @ A) * (D @ P) / m.rho + G @ (Q_t + sink)
        inside = np.concatenate(
            [mass * self.length / self.Q_size, momentum * self.length / (self.Q_size * self.c_size)], axis=1
        )
        ends = np.stack(self._end_residuals(A, Q, P, inflow))
        return np.moveaxis(beat.coefficients(inside), -1, 0), beat.coefficients(ends).T

    def _end_residuals(self, A: Array, Q: Array, P: Array, inflow: Array) -> list[Array]:
        rows = []
        for node in self.nodes:
            rows.append(sum((2 * side - 1) * Q[i, -side] for i, side in node.ends) / self._flow_size(node))
            heads = [P[i, -side] + 0.5 * node.k * self.model.rho * (Q / A)[i, -side] ** 2 for i, side in node.ends]
            rows += [(head - heads[0]) / self._head_size(node) for head in heads[1:]]
        i = self._inlet
        rows.append((Q[i, 0] - inflow) / self.Q_size[i, 0])
        for i, end in self._outlets:
            rows.append(self._load(i, end, Q[i, -1], P[i, -1]) / self.Q_size[i, 0])
        return rows

    def _load(self, i: int, end: End, Q: Array, P: Array) -> Array:
        """Residual of an end [m³/s]; an impedance is counted in flow by the vessel's own impedance."""
        if end.kind == "reflection":
            R_t = end.R_t + end.swing * np.sin(2.0 * np.pi * (self.beat.phase - end.swing_phase))
            wall = wall_at(self.walls, i, -1)
            s = wall.stretch(P - end.P_venous - wall.P_level)
            return Q - (1.0 - R_t) / (1.0 + R_t) * wall.A0 * s * s * wall.speed_integral(s, self.model.rho)
        return self._admittance(i) * (P - end.P_venous - self.beat.filtered(Q, self._impedance(end)))

    def _impedance(self, end: End) -> Array:
        return end.R1 + end.R2 / (1.0 + 1j * self.beat.omega * end.R2 * end.C)

    def _admittance(self, i: int) -> float:
        return float(self.A_size[i, 0, 0] / (self.model.rho * self.c_size[i, 0, 0]))

    def _flow_size(self, node: Node) -> float:
        return float(self.Q_size[node.ends[0][0], 0, 0])

    def _head_size(self, node: Node) -> float:
        return float(self.model.rho * self.c_size[node.ends[0][0], 0, 0] ** 2)

    @cached_property
    def _inlet(self) -> int:
        names = [piece.vessel.name for piece in self.pieces]
        return names.index(self.model.inlet)

    @cached_property
    def _outlets(self) -> list[tuple[int, End]]:
        last = {piece.vessel.name: i for i, piece in enumerate(self.pieces)}
        return [(last[end.vessel], end) for end in self.model.ends]

    # --- the solution ----------------------------------------------------------------------------------------------

    def solve(
        self,
        inflow: Array,
        start: Array | None = None,
        tolerance: float = TOLERANCE,
        linear: Linearised | None = None,
    ) -> Flow:
        """The periodic flow for an inflow of coefficients (K + 1,) [m³/s].

        start : the unknowns of a flow nearby; linear : the equations of that flow, linearised, which serve the first
        iterations, as long as the pieces are the same. Raises NoPeriodicFlow if the iteration does not converge.
        """
        samples = self.beat.values(inflow)
        unknown = self.rest() if start is None else start
        total, correction = 0, np.inf
        for round_ in range(_ROUNDS):
            linear = linear if linear is not None and round_ == 0 else Linearised(self, unknown)
            sweeps = 3 if start is None and round_ == 0 else _SWEEPS
            unknown, used, correction = self._iterate(unknown, samples, linear, sweeps, tolerance)
            total += used
            if correction <= tolerance:
                return Flow(unknown, self.channels(unknown), total, correction, linear)
        raise NoPeriodicFlow(f"after {total} iterations the correction is still {correction:.2g} of the pulse")

    def _iterate(
        self, unknown: Array, inflow: Array, linear: Linearised, sweeps: int, tolerance: float
    ) -> tuple[Array, int, float]:
        """Anderson's iteration on unknown + correction."""
        states: list[Array] = []
        steps: list[Array] = []
        correction = np.inf
        for _ in range(sweeps):
            step = linear.correction(*self.residual(unknown, inflow))
            correction = float(np.abs(step).max() / max(np.abs(unknown[1:]).max(), _SMALL_PULSE))
            if not np.isfinite(correction):
                raise NoPeriodicFlow("the iteration diverged")
            states.append(unknown)
            steps.append(step)
            unknown = anderson(states[-_DEPTH:], steps[-_DEPTH:])
            if correction <= tolerance:
                break
        return unknown, len(steps), correction

    def channels(self, unknown: Array) -> dict[str, Array]:
        """Coefficients (K + 1,) of P, Q, R at every place, and of the inlet's P and Q."""
        A, Q, _, P = self.fields(unknown)
        result = {"inlet.Q": self.beat.coefficients(Q[self._inlet, 0])}
        for place in self.model.places:
            i = next(
                i
                for i, piece in enumerate(self.pieces)
                if piece.vessel.name == place.vessel and place.position <= piece.stop
            )
            piece = self.pieces[i]
            row = row_at(self.n, (place.position - piece.start) / (piece.stop - piece.start))
            for kind, value in (("P", P), ("Q", Q), ("R", np.sqrt(A / np.pi))):
                result[f"{place.name}.{kind}"] = self.beat.coefficients(row @ value[i])
        return result


class Linearised:
    """The equations linearised about the mean of a state, solved per harmonic."""

    def __init__(self, balance: Balance, unknown: Array) -> None:
        self.b = balance
        b = balance
        A, Q, _, P = (x.mean(axis=-1, keepdims=True) for x in balance.fields(unknown))
        self.A, self.Q, self.P = A, Q, P
        self.speed = np.abs(b.beat.values(np.moveaxis(unknown, 0, -1)[:, 1] * b.Q_size)).mean(axis=-1, keepdims=True)
        self.Z = b.resting.impedance(A)  # (pieces, n, K + 1)
        self._condense()
        self._nodes()

    def _condense(self) -> None:
        """Inverse of each piece's equations, with A and Q at its left end given: (K + 1, pieces, 2n, 2n)."""
        b, n = self.b, self.b.n
        shape = (b.beat.K + 1, b.p, 2 * n, 2 * n)
        J = np.zeros(shape, complex)
        J[..., : 2 * (n - 1), :] = self._inside()
        J[..., 2 * (n - 1), 0] = 1.0
        J[..., 2 * (n - 1) + 1, n] = 1.0
        self.inverse = np.linalg.inv(J)

    def _inside(self) -> Array:
        b, m, G = self.b, self.b.model, self.b.points.to_gauss
        D = b.points.slope / b.length
        A, Q, iw = self.A, self.Q, 1j * b.beat.omega
        U = Q / A

        def spread(matrix: Array, factor: Array) -> Array:
            """matrix (…, n - 1, n) times factor (…, n, K + 1 or 1) along its columns: (K + 1, pieces, n - 1, n)."""
            full = np.broadcast_to(factor, (b.p, b.n, b.beat.K + 1))
            return np.moveaxis(matrix[..., None] * full[:, None], -1, 0)

        drag = b.friction / A + 2.0 * b.loss * self.speed / A
        sink = b.friction + b.loss * self.speed
        if b.shear is not None:
            drag, sink = drag + b.shear, sink + A * b.shear
        mass_A = spread(np.broadcast_to(G, (b.p, *G.shape)), iw + b.leak * self.Z)
        mass_Q = spread(D, np.ones((1, 1, 1)))
        pressure = (G @ A) * D / m.rho
        force = (D @ self.P) * G / m.rho
        moment_A = spread(pressure, self.Z) + spread(force, np.ones((1, 1, 1)))
        moment_A -= spread(D, m.alpha * U * U) + spread(np.broadcast_to(G, (b.p, *G.shape)), sink * U / A)
        moment_Q = spread(D, 2.0 * m.alpha * U) + spread(np.broadcast_to(G, (b.p, *G.shape)), iw + drag)
        A_size, Q_size = b.A_size, b.Q_size
        mass = np.concatenate([mass_A * A_size, mass_Q * Q_size], axis=-1) * b.length / Q_size
        moment = np.concatenate([moment_A * A_size, moment_Q * Q_size], axis=-1) * b.length / (Q_size * b.c_size)
        return np.concatenate([mass, moment], axis=-2)

    def _nodes(self) -> None:
        """The conditions at the ends in terms of A and Q at the left ends: (K + 1, 2 pieces, 2 pieces), inverted."""
        b, n = self.b, self.b.n
        rows = self._end_rows()  # (2 pieces, pieces, side, A or Q, K + 1)
        rows = np.moveaxis(rows, -1, 0)
        right = self.inverse[..., [n - 1, 2 * n - 1], :]  # A and Q at the right end
        self.right_inside = right[..., : 2 * (n - 1)]
        self.right_rows = rows[:, :, :, 1]
        N = rows[:, :, :, 0] + np.einsum("kepc,kpcd->kepd", rows[:, :, :, 1], right[..., 2 * (n - 1) :])
        self.nodes_inverse = np.linalg.inv(N.reshape(len(N), 2 * b.p, 2 * b.p))

    def _end_rows(self) -> Array:
        b = self.b
        rows = np.zeros((2 * b.p, b.p, 2, 2, b.beat.K + 1), complex)
        at = 0
        for node in b.nodes:
            for i, side in node.ends:
                rows[at, i, side, 1] = (2 * side - 1) * b.Q_size[i, 0] / b._flow_size(node)
            for j, (i, side) in enumerate(node.ends[1:], start=1):
                rows[at + j, i, side] = self._head(i, side, node.k) / b._head_size(node)
                first, first_side = node.ends[0]
                rows[at + j, first, first_side] = -self._head(first, first_side, node.k) / b._head_size(node)
            at += len(node.ends)
        rows[at, b._inlet, 0, 1] = 1.0
        for j, (i, end) in enumerate(b._outlets, start=1):
            rows[at + j, i, 1] = self._load(i, end) / b.Q_size[i, 0]
        return rows

    def _head(self, i: int, side: int, k: float) -> Array:
        """Change of P + k (ρ/2)(Q/A)² at an end with the scaled A and Q there : (2, K + 1)."""
        A, Q = self.A[i, -side, 0], self.Q[i, -side, 0]
        kinetic = k * self.b.model.rho * Q / A**2
        of_A = (self.Z[i, -side] - kinetic * Q / A) * self.b.A_size[i, 0]
        return np.stack([of_A, np.full_like(of_A, kinetic * self.b.Q_size[i, 0, 0])])

    def _load(self, i: int, end: End) -> Array:
        b = self.b
        if end.kind == "reflection":
            wall: Walls = wall_at(b.resting, i, -1)
            s = wall.stretch(self.P[i, -1] - end.P_venous - wall.P_level)
            slope = wall.elastic_slope(s) / (2.0 * wall.A0 * s)  # dP_el/dA
            speed = s * np.sqrt(slope * wall.A0 / b.model.rho)  # c
            gain = (1.0 - end.R_t) / (1.0 + end.R_t) * (wall.speed_integral(s, b.model.rho) + speed) / slope
            of_P, of_Q = -gain * np.ones(b.beat.K + 1), np.ones(b.beat.K + 1, complex)
        else:
            of_P = np.full(b.beat.K + 1, b._admittance(i))
            of_Q = -b._admittance(i) * b._impedance(end)
        return np.stack([of_P * self.Z[i, -1] * b.A_size[i, 0], of_Q * b.Q_size[i, 0]])

    def correction(self, inside: Array, ends: Array) -> Array:
        """The change of the unknowns that removes both residuals, to first order."""
        b, n = self.b, self.b.n
        rest = np.einsum("kpcd,kpd->kpc", self.right_inside, inside)
        ends = ends - np.einsum("kepc,kpc->ke", self.right_rows, rest)
        left = np.einsum("kij,kj->ki", self.nodes_inverse, ends).reshape(-1, b.p, 2)
        full = np.concatenate([inside, left], axis=-1)
        change = -(self.inverse @ full[..., None])[..., 0]
        change[0] = change[0].real
        return change.reshape(-1, b.p, 2, n)

    def inlet_response(self) -> dict[str, Array]:
        """Change of every channel with a unit change of the inflow, per harmonic : (K + 1,)."""
        b = self.b
        ends = np.zeros((b.beat.K + 1, 2 * b.p), complex)
        inlet_row = 2 * b.p - 1 - len(b._outlets)
        ends[:, inlet_row] = -1.0 / b.Q_size[b._inlet, 0, 0]
        change = self.correction(np.zeros((b.beat.K + 1, b.p, 2 * (b.n - 1)), complex), ends)
        c = np.moveaxis(change, 0, -1)
        dA, dQ = c[:, 0] * b.A_size, c[:, 1] * b.Q_size
        result = {}
        for place in b.model.places:
            i = next(
                i
                for i, piece in enumerate(b.pieces)
                if piece.vessel.name == place.vessel and place.position <= piece.stop
            )
            piece = b.pieces[i]
            row = row_at(b.n, (place.position - piece.start) / (piece.stop - piece.start))
            result[f"{place.name}.P"] = row @ (self.Z * dA)[i]
            result[f"{place.name}.Q"] = row @ dQ[i]
            result[f"{place.name}.R"] = row @ (dA / (2.0 * np.sqrt(np.pi * self.A)))[i]
        return result


def womersley_excess(R0: Array, nu: float, omega: Array) -> Array:
    """Ŵ(ω) = iω F/(1 - F) - 8ν/R0² [1/s] of the module's head; zero at ω = 0. Arrays broadcast."""
    w = np.where(omega == 0.0, 1.0, omega)
    z = R0 * np.sqrt(1j * w / nu)  # F = 2 I1(z)/(z I0(z)), the same function without cancellation of large J
    F = 2.0 * ive(1, z) / (z * ive(0, z))
    return np.where(omega == 0.0, 0.0, 1j * w * F / (1.0 - F) - 8.0 * nu / R0**2)
