"""One implicit stage: momentum in the elements, ΣQ and loads at the nodes, and the chord iteration that meets both."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..laws.outlets import Load
from ..laws.wall import Wall
from ..mesh.elimination import Factor
from ..mesh.mesh import Index, as_slice
from . import terms
from .drag_and_leak import Force
from .guards import refuse
from .model import Model
from .sdirk import GAMMA
from .terms import Start

Array = np.ndarray

CORRECTIONS = 8  # chord iterations before the Jacobian is refreshed
REFRESHES = 5  # fresh Jacobians before the step is given up
_KEPT = 16  # lengths of step whose operators a model keeps


@dataclass(frozen=True)
class Loads:
    """The loads of the outlets on the nodes at the end of a stage: :class:`~solver.laws.outlets.Load`, scale ΣQ =
    flow(P - P_b).

    scale : (B, n_nodes), 1 except at outlets and at inlets with a given pressure. signs : the weights of the flows at
    element ends in this case. keep, give, charge : (B, n_outlets). kinds : nodes, outlets, load of each.
    """

    scale: Array
    signs: Array
    keep: Array
    give: Array
    charge: Array
    kinds: tuple[tuple[Index, Index, Load], ...]


@dataclass(frozen=True)
class Condensed:
    """The inverse of the Jacobian of a stage, its elements condensed onto the nodes.

    K_inverse : (B, n_e, N+1, N+1) of each element's momentum. by_ends : (B, 2, n_e, N+1) response of Q to the pressures
    at its left and its right end. nodal : the system of the nodal pressures. ends : (n_e, 2) their nodes.
    """

    K_inverse: Array
    by_ends: Array
    nodal: Factor
    ends: Array

    def member(self, b: int) -> Condensed:
        """The Jacobian of one state of several."""
        own = slice(b, b + 1)
        return replace(self, K_inverse=self.K_inverse[own], by_ends=self.by_ends[own], nodal=self.nodal.member(b))

    def add_to(self, Q: Array, H: Array) -> None:
        """Add the flow from nodal pressures H : (B, n_nodes) to Q : (B, n_e, N+1)."""
        Q += np.einsum("bkej,bek->bej", self.by_ends, H.take(self.ends, 1))


@dataclass(frozen=True)
class Operators:
    """The operators of all stages of length tau: inertia (B, n_e, N+1) ρ w J/τ, the loads, the Jacobian at rest."""

    tau: float
    inertia: Array
    memory: Memory | NoMemory
    loads: Loads
    at_rest: Condensed


def operators(model: Model, dt: float) -> Operators:
    """The operators for steps of length dt [s]; made once per dt, and the last used are kept."""
    made: Operators | None = model.memo.pop(dt, None)
    if made is None:
        if len(model.memo) >= _KEPT:
            model.memo.pop(next(iter(model.memo)))
        c = model.coefficients
        H = np.broadcast_to(c.P_0, (c.B, model.mesh.n_nodes))
        made = operators_about(model, GAMMA * dt, model.at_rest(), H)
        made = replace(made, at_rest=replace(made.at_rest, nodal=made.at_rest.nodal.whole()))  # for many uses
    model.memo[dt] = made
    return made


def operators_about(model: Model, tau: float, y: Array, H: Array) -> Operators:
    """The operators of stages of length tau [s], with the Jacobian about a steady state y : (B, n), H : (B, n_nodes).

    With tau = 1/iω the Jacobian is that of small waves e^{iωt}: a stage replaces dx/dt by (x - x_start)/tau.
    """
    inertia, loads, memory = model.mass / tau, loads_of(model, tau), memory_of(model)
    about, behind = start(model, tau, inertia, memory, loads, y, model.coefficients.P_venous)
    K = terms.jacobian(about, terms.still(about))
    return Operators(tau, inertia, memory, loads, condense(model, loads, K, H, behind))


def operators_repeated(model: Model, times: int, dt: float) -> tuple[Model, Operators]:
    """All parameter sets repeated in one batch, with the operators for steps of length dt [s]; their Jacobian is that
    of the model, because residuals need none."""
    o, many = operators(model, dt), model.repeated(times)
    return many, replace(o, inertia=many.mass / o.tau, loads=loads_of(many, o.tau))


class NoMemory:
    """A and Q are the whole state."""

    def recall(self, model: Model, y: Array, tau: float, loads: Loads, P_venous: Array) -> tuple[Wall, Force, Array]:
        """Wall and force of a stage of length tau [s] that starts from y : (B, n), and P_b of its outlets."""
        return model.wall, model.force, P_venous

    def store(self, stage: Stage, end: Array, A: Array, A_t: Array, Q: Array) -> None:
        """Write the memory at the end of the stage into the state vector ``end``."""


class Memory:
    """Stored pressures, viscous stress, history of a force: backward Euler steps of length τ, relaxation solved for."""

    def recall(self, model: Model, y: Array, tau: float, loads: Loads, P_venous: Array) -> tuple[Wall, Force, Array]:
        _, _, P_C, stress, history = model.layout.split(y)
        behind = loads.keep * P_C + loads.give * P_venous
        return model.wall.remembering(stress.swapaxes(0, 1), tau), model.force.since(history, tau), behind

    def store(self, stage: Stage, end: Array, A: Array, A_t: Array, Q: Array) -> None:
        s, layout = stage.start, stage.start.model.layout
        _, _, P_C, stress, history = layout.split(end)
        let_out = s.model.tables.let_out(Q[:, s.model.mesh.outlet_element, -1], stage.g)
        P_C[:] = stage.behind + stage.operators.loads.charge * let_out
        if stress.size:
            stress[:] = s.wall.carried(A, A_t).swapaxes(0, 1)
        if history.size:
            history[:] = s.force.history(layout.part(s.y, "history"), Q, A)


def memory_of(model: Model) -> Memory | NoMemory:
    """The memory of a model's states beside A and Q."""
    return Memory() if model.layout.shapes["P_C"][0] else NoMemory()


def start(
    model: Model, tau: float, inertia: Array, memory: Memory | NoMemory, loads: Loads, y: Array, P_venous: Array
) -> tuple[Start, Array]:
    """The start of a stage of length tau [s] from the state vector y : (B, n), and P_b of its outlets."""
    A, Q = model.layout.part(y, "A"), model.layout.part(y, "Q")
    wall, force, behind = memory.recall(model, y, tau, loads, P_venous)
    return Start(model, tau, y, A, Q, inertia, wall, force, model.storage.since(wall, A, tau, P_venous)), behind


def loads_of(model: Model, tau: float) -> Loads:
    c, nodes = model.coefficients, model.mesh.topology
    outlet_nodes = np.arange(model.mesh.n_nodes)[nodes.outlets]
    scale = np.ones_like(c.P_0 + 0.0 * tau, shape=(c.B, model.mesh.n_nodes))  # complex where tau is
    keep, give, charge = (np.zeros_like(scale, shape=(c.B, len(outlet_nodes))) for _ in range(3))
    scale[:, nodes.inlets] *= model.inlets.scale
    kinds = []
    for ends in c.outlets:
        load = ends.load(model.outlet_wall.at(ends.index), tau)
        at = outlet_nodes[ends.index]
        scale[:, at], keep[:, ends.index], give[:, ends.index] = load.scale, load.keep, load.give
        charge[:, ends.index] = load.charge
        kinds.append((as_slice(at), as_slice(ends.index), load))
    return Loads(scale, model.mesh.signs(scale), keep, give, charge, tuple(kinds))


def condense(model: Model, loads: Loads, K: Array, H: Array, behind: Array) -> Condensed:
    """Invert the element Jacobians K and condense them onto the nodes; outlets linearised at H : (B, n_nodes)."""
    mesh = model.mesh
    K_inverse = np.linalg.inv(K)
    by_ends = np.stack([K_inverse[..., 0], -K_inverse[..., -1]], axis=1)
    by_left, by_right = by_ends[..., :: mesh.element.N].swapaxes(0, 1)
    # into the left node, then into the right one, by the pressures at both
    products = np.stack([-by_left[..., 0], -by_right[..., 0], by_left[..., 1], by_right[..., 1]], axis=-1)
    less = np.zeros_like(loads.scale, shape=(len(K), mesh.n_nodes))  # several states may have one parameter set
    less[:, mesh.topology.inlets] += model.inlets.slope
    for nodes, outlets, load in loads.kinds:
        less[:, nodes] += load.slope((H[:, nodes] - behind[:, outlets]).real)
    nodal = mesh.elimination.factor(products.reshape(len(K), -1), loads.scale, less)
    return Condensed(K_inverse, by_ends, nodal, mesh.ends)


class Stage(NamedTuple):
    """A stage from ``start``: find Q and the nodal pressures H at its end, at time t [s].

    behind : (B, n_outlets) [Pa] the pressures behind the outlets. given : (B, n_inlets) [m³/s] the drives of the
    inlets, times their gain. P_venous : (B, n_outlets) [Pa]. g : (n_sources,) amplitudes of the tables.
    """

    start: Start
    operators: Operators
    behind: Array
    given: Array
    P_venous: Array
    t: float
    g: Array | None = None

    @staticmethod
    def of(
        model: Model, o: Operators, y: Array, given: Array, P_venous: Array, t: float, g: Array | None = None
    ) -> Stage:
        """The stage that starts from the state vector y : (B, n)."""
        s, behind = start(model, o.tau, o.inertia, o.memory, o.loads, y, P_venous)
        return Stage(s, o, behind, given, P_venous, t, g)

    def solve(self, Q: Array, H: Array, small: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Chord iterations from a guess until Q and H change by no more than ``small`` : two (B,).

        Returns Q, H and ∂A/∂t. A converged member of a batch has the same result as alone, whatever its neighbours do.
        A diverged one starts again from the guess, with the Jacobian there.
        Raises NonPhysicalState, located from the last finite iterate.
        """
        small_Q, small_H = small
        model, start = self.start.model, self.start
        jacobian, guess = self.operators.at_rest, (Q, H)
        done, before, together = np.zeros(len(Q), bool), Q, True
        for _ in range(1 + REFRESHES):
            for _ in range(CORRECTIONS):
                Q_new, dH = self.correct(jacobian, Q, H)
                change_Q, change_H = largest((Q_new - Q).reshape(len(Q), -1)), largest(dH)
                near = (change_Q <= small_Q) & (change_H <= small_H)
                H_new = H + dH
                if together and np.count_nonzero(near) == len(near):
                    return Q_new, H_new, start.area_rate(Q_new)
                moves = ~done & np.isfinite(change_Q) & np.isfinite(change_H)
                if moves.all():
                    before, Q, H = Q, Q_new, H_new
                else:
                    before = np.where(moves[:, None, None], Q, before)
                    Q, H = np.where(moves[:, None, None], Q_new, Q), np.where(moves[:, None], H_new, H)
                done = done | (moves & near)
                together = not done.any()
                if done.all():
                    return Q, H, start.area_rate(Q)
                if not (moves & ~done).any():
                    break
            last, finite = (Q, H), (start.area(start.area_rate(Q)) > 0.0).all(axis=(1, 2)) & moves
            lost = ~done & ~finite
            Q, H = np.where(lost[:, None, None], guess[0], Q), np.where(lost[:, None], guess[1], H)
            try:
                jacobian = condense(model, self.operators.loads, self.jacobian(Q), H, self.behind)
            except np.linalg.LinAlgError:  # a state without a Jacobian cannot continue
                break
        changes = np.abs(last[0] - before).max(axis=2)
        A_t = start.area_rate(last[0])
        refuse(model, start.area(A_t), A_t, *last, changes, self.P_venous, done, self.t)

    def jacobian(self, Q: Array) -> Array:
        """The Jacobian of momentum in every element, at the flow Q."""
        return terms.jacobian(self.start, terms.flow(self.start, Q))

    def correct(self, jacobian: Condensed, Q: Array, H: Array) -> tuple[Array, Array]:
        """One chord iteration: momentum residual, condensation onto the nodes, nodal pressures, flow. Returns the flow
        and the change of the pressures."""
        R = terms.residual(self.start, Q, H)
        self.start.model.tables.add_to_momentum(R, self.g)
        Q_new = Q - np.einsum("beij,bej->bei", jacobian.K_inverse, R)
        dH = jacobian.nodal.solve(self.node_residual(Q_new, H))
        jacobian.add_to(Q_new, dH)
        return Q_new, dH

    def node_residual(self, Q: Array, H: Array) -> Array:
        """ΣQ at the nodes, minus the drives of the inlets; flow minus load at the outlets : (B, n_nodes) [m³/s]."""
        model, loads = self.start.model, self.operators.loads
        net, inlets = model.mesh.net_inflow(Q, loads.signs), model.mesh.topology.inlets
        net[:, inlets] += model.inlets.flow(self.given, H[:, inlets])
        model.tables.add_to_nodes(net, loads.scale, self.g)
        for nodes, outlets, load in loads.kinds:
            net[:, nodes] -= load.flow(H[:, nodes] - self.behind[:, outlets])
        return net

    def end(self, Q: Array, A_t: Array) -> Array:
        """The state vector at the end of the stage, from the flow and ∂A/∂t there."""
        s, model, B = self.start, self.start.model, len(Q)
        end, A = np.empty_like(s.y), s.area(A_t)
        end[:, model.layout.places["A"]] = A.reshape(B, -1)
        end[:, model.layout.places["Q"]] = Q.reshape(B, -1)
        self.operators.memory.store(self, end, A, A_t, Q)
        return end


def largest(x: Array) -> Array:
    """(B,) sizes of the largest of each row of x : (B, n)."""
    return np.maximum.reduce(np.abs(x), 1)
