"""The default scheme: staggered spectral elements in space, unsplit and implicit in time.

`massConserv_AQ` and `momentumConserv_AQ` with the wall of `sheep_constitutive`:

    ∂A/∂t = -∂Q/∂x
    ρ/A ∂Q/∂t + ∂/∂x (P + ½ρα U²) + ρα (U/A) ∂Q/∂x + ρ C_f Q/A² = 0,     U = Q/A
    P = P_ref + P_el(A) + ν_s ∂A/∂t + ν_NL (∂A/∂t)²                       (the *total* pressure, pointwise)

Q lives at Lobatto points (degree N), A and P at Gauss points (degree N - 1), so ∂A/∂t = -∂Q/∂x holds pointwise and
mass is conserved to round-off. At every node one pressure H is the Lagrange multiplier that enforces ΣQ = 0; outlets
load the total pressure. Time: the three-stage, third-order, L-stable and stiffly accurate SDIRK method of Alexander
(1977). Each stage is solved by chord iterations with the Jacobian at rest, factorised once per (parameters, dt):
elements are condensed onto the nodes. Why not Crank–Nicolson: one L-stable scheme serves elastic and viscous walls
alike, so the answer is continuous as φ0 → 0, and it does not ring when an input is held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError, NonPhysicalState, NotConverged
from ..mesh.mesh import Layout
from .guards import check
from .model import Model
from .sdirk import HALVES, SDIRK3, STAGES
from .stage import Stage, largest, operators

Array = np.ndarray

_BEFORE = [row[:stage] for stage, row in enumerate(SDIRK3.tolist())]  # weights of earlier stages, as plain numbers
_FURTHEST = 10.0  # lengths of the last step over which the unknowns are extrapolated
_HALVINGS = 4  # a step that does not converge is halved at most this often
_PRESSURES = 10.0  # tolerance of nodal pressures, which follow the rates of flow, over that of the flows


@dataclass(frozen=True)
class State:
    """The state that a step starts from.

    y : (B, n) the state vector, its parts in ``layout``. A_t : (B, n_e, N) ∂A/∂t [m²/s]; H : (B, n_nodes) [Pa].
    unknowns, unknowns_before : (STAGES, B, m), ∂Q/∂t and H at the stages of the last two steps, both of length dt [s],
    which give the initial guess of the next one; their parts in ``guess``. halved : number of halvings of steps until
    now.
    """

    t: float
    y: Array
    A_t: Array
    H: Array
    unknowns: Array
    unknowns_before: Array
    layout: Layout
    guess: Layout
    dt: float = 0.0
    halved: int = 0

    @property
    def A(self) -> Array:
        """(B, n_e, N) [m²]."""
        return self.layout.part(self.y, "A")

    @property
    def Q(self) -> Array:
        """(B, n_e, N+1) [m³/s]."""
        return self.layout.part(self.y, "Q")

    @property
    def rates(self) -> Array:
        """(STAGES, B, n_e, N+1) ∂Q/∂t at the stages of the last step [m³/s²]."""
        return self.guess.part(self.unknowns, "rates")

    def of_moments(self, y: Array, A_t: Array, H: Array) -> State:
        """Many moments at once, for outputs: a state vector y, ∂A/∂t and H of each."""
        return replace(self, y=y, A_t=A_t, H=H)

    def members(self, index: Array | slice) -> State:
        """The state of some members of a batch."""
        return replace(
            self,
            y=self.y[index],
            A_t=self.A_t[index],
            H=self.H[index],
            unknowns=self.unknowns[:, index],
            unknowns_before=self.unknowns_before[:, index],
        )


def initial_state(model: Model, t: float = 0.0) -> State:
    """Fluid at rest under the uniform pressure P_0."""
    guess = Layout({"rates": model.mass.shape[1:], "heads": (model.mesh.n_nodes,)})
    H = np.broadcast_to(model.coefficients.P_0, (model.coefficients.B, model.mesh.n_nodes)).copy()
    unknowns = np.zeros((STAGES, model.coefficients.B, guess.size))
    guess.part(unknowns, "heads")[:] = H
    return State(t, model.at_rest(), np.zeros_like(model.A_rest), H, unknowns, unknowns, model.layout, guess)


def adopt(model: Model, state: State) -> State:
    """A state on this mesh adapted to other parameters: missing memory is added, unused memory dropped.

    The stress of a wall without memory is that of its strain rate; a new memory of the fluid starts at 0. The state of
    one member serves a whole batch. Raises ValueError for a batch of another size.
    """
    B, state = model.coefficients.B, of_batch(state, model.coefficients.B)
    if state.layout.shapes == model.layout.shapes:
        return replace(state, layout=model.layout)
    A, Q, *memory = state.layout.split(state.y)
    U = Q / (A @ model.mesh.element.at_lobatto)
    without = {
        "P_C": state.H[:, model.mesh.topology.outlets],
        "stress": np.moveaxis(model.wall.carried(A, state.A_t), 0, 1),
        "history": np.broadcast_to(-U[:, None], (B, *model.layout.shapes["history"])),
    }
    kept = []
    for (name, fresh), part in zip(without.items(), memory, strict=True):
        n = min(part.shape[1], model.layout.shapes[name][0])
        kept.append(np.concatenate([part[:, :n], fresh[:, n : model.layout.shapes[name][0]]], axis=1))
    return replace(state, y=model.layout.join(A, Q, *kept), layout=model.layout)


def of_batch(state: Any, B: int) -> Any:
    """A state of any scheme for B parameter sets; that of one serves all. Raises ValueError for another number."""
    members = len(state.y)
    if members not in (1, B):
        raise InputError(f"start: its state is of {members} parameter sets, not {B}; start from member(i) of it.")
    return state if members == B else state.members(np.zeros(B, int))


def step(model: Model, state: State, dt: float, drive: Array, P_venous: Array | None = None) -> State:
    """Advance by dt [s]; if that does not converge, by shorter steps, which ``halved`` of the state counts.

    drive : (n_inlets, 4) or (n_inlets, 4, B), the inflow [m³/s] at the times t + INFLOW_TIMES dt, or the pressure [Pa]
    of an inlet with given pressure; a single inlet may omit its axis. P_venous : (n_outlets,) or (B, n_outlets) [Pa]
    during the step, default the parameters'. A model of one parameter set steps B states as well; if one must be
    halved, all are.
    Raises NonPhysicalState if the result is not physical.
    """
    return parts(model, state, dt, drive, P_venous)[-1]


def parts(model: Model, state: State, dt: float, drive: Array, P_venous: Array | None = None) -> list[State]:
    """As :func:`step`, but returns the states at the ends of all parts of the step, usually one."""
    with np.errstate(all="ignore"):
        return _parts(model, state, dt, model.inlets.each(drive), P_venous, _HALVINGS)


def _parts(model: Model, state: State, dt: float, drive: Array, P_venous: Array | None, halvings: int) -> list[State]:
    try:
        return [_advance(model, state, dt, drive, P_venous)]
    except NotConverged as error:
        if halvings == 0:
            raise
        end, found = state.t + dt, [replace(state, halved=state.halved + 1)]
        try:
            for half in HALVES:
                found += _parts(model, found[-1], 0.5 * dt, np.matmul(half, drive), P_venous, halvings - 1)
        except NonPhysicalState:
            raise error from None
    return [*found[1:-1], replace(found[-1], t=end)]


def _advance(model: Model, state: State, dt: float, drive: Array, P_venous: Array | None) -> State:
    """A step: at every stage start = y + dt Σ a_j k_j, end = solve(start), k = (end - start)/τ."""
    o, c, layout, guess = operators(model, dt), model.coefficients, model.layout, state.guess
    drives, acting = model.inlets.at_stages(drive), model.tables.at(state.t + SDIRK3.sum(axis=1) * dt)
    venous = c.P_venous if P_venous is None else c.venous(np.atleast_2d(P_venous))
    small = tolerances(model, state, model.inlets.gain * drive[:, -1].T)
    y = state.y.copy()
    model.inlets.begin(y, model.tables.let_in(drive[:, 0], state.t))
    # extrapolation of the last two stage values is so accurate that one iteration is usually enough
    last, before = at_stages_of(state, dt)
    guesses = 2.0 * last - before
    unknowns, k = np.empty_like(guesses), list[Array]()
    changes, heads = o.tau * guess.part(guesses, "rates"), guesses[..., guess.places["heads"]]
    for a, change, head, found, given, g in zip(_BEFORE, changes, heads, unknowns, drives, acting, strict=True):
        start = y
        for a_j, k_j in zip(a, k, strict=True):
            start = start + (dt * a_j) * k_j
        stage = Stage.of(model, o, start, given, venous, state.t + dt, g)
        Q, H, A_t = stage.solve(stage.start.Q + change, head, small)
        end = stage.end(Q, A_t)
        k_i = end - start
        k_i /= o.tau
        k_i[:, layout.places["A"]] = A_t.reshape(len(y), -1)  # without the round-off of the difference
        found[:, guess.places["rates"]], found[:, guess.places["heads"]] = k_i[:, layout.places["Q"]], H
        k.append(k_i)
    check(model, layout.part(end, "A"), A_t, Q, state.t + dt)
    return State(state.t + dt, end, A_t, H, unknowns, last, layout, guess, dt, state.halved)


def at_stages_of(state: State, dt: float) -> tuple[Array, Array]:
    """The unknowns of the last two steps, converted to a step length of dt [s].

    For another length, the straight line through the values at their ends replaces them: a plain restart would have
    fifty times the error.
    """
    last, before = state.unknowns, state.unknowns_before
    if dt == state.dt or state.dt == 0.0:
        return last, before
    if dt > _FURTHEST * state.dt:  # extrapolation of two near points is unreliable
        last = np.broadcast_to(last[-1], last.shape)
        return last, last
    slope = (last[-1] - before[-1]) * (dt / state.dt)
    stages = SDIRK3.sum(axis=1)
    return last[-1] + np.multiply.outer(stages - 1.0, slope), last[-1] + np.multiply.outer(stages - 2.0, slope)


def tolerances(model: Model, state: State, given: Array) -> tuple[Array, Array]:
    """Convergence limits of flows and nodal pressures in a stage : two (B,)."""
    driven = model.inlets.flow(given, state.H[:, model.mesh.topology.inlets])
    flow = np.maximum(largest(state.y[:, state.layout.places["Q"]]), largest(driven))
    pressure = largest(state.H - model.coefficients.P_0)
    tolerance = model.settings.tolerance
    return (
        tolerance * flow + model.flow_floor,
        _PRESSURES * tolerance * np.maximum(pressure, flow * model.impedance) + model.pressure_floor,
    )
