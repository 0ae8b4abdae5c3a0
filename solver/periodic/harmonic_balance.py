"""The periodic beat of a driven network by harmonic balance.

All parts use the equations of the scheme itself, so that all physics of a network is included:

1. The steady state of the mean drive, by implicit steps so long that everything but the flow comes to rest.
2. The waves about it, harmonic by harmonic. A stage of length τ replaces dx/dt by (x - x_start)/τ; with τ = 1/iω its
   Jacobian is that of small waves e^{iωt}: linear theory as in :mod:`~solver.linear`, about stretched walls with flow.
3. Repeated corrections: the same Jacobians cancel the residuals of these waves in the nonlinear equations over a
   period. Each correction is a tenth of the previous one for physiological waves. This also moves the mean, which
   differs from the state of the mean drive.

The only error in time is by the omitted harmonics: there is no time step whose error would accumulate.

Harmonic balance: M. S. Nakhla, J. Vlach, IEEE Trans. Circuits Syst. 23 (1976) 85; here with fixed Jacobians.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..laws.wall import weights
from ..mesh.elimination import Factor
from ..mesh.sources import NO_FORCING, Forcing
from ..network.inflow import Drives
from ..quantities.units import SIGNAL_UNITS
from ..scheme import terms
from ..scheme.guards import NonPhysicalState, check
from ..scheme.model import Model
from ..scheme.stage import Condensed, Operators, Stage, operators, operators_about, operators_repeated, start
from ..scheme.step import State, initial_state
from .mixing import EARLIER, SLOW, mixed
from .waves import SAMPLES, Near, Waves, amplitudes, constant, samples, taus_of

Array = np.ndarray
Drive = Callable[[Array], Array]

_STORAGE = 5e8  # bytes of the Jacobians of all harmonics; larger meshes or batches get fewer harmonics
_TOGETHER = 3000  # elements of members and moments in one operation (measured: equally fast from 800 to 12 000)
_FINE = 4096  # samples of the drive, whose mean must be accurate
MOST = _FINE // 4  # harmonics
LONG = (1e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4)  # s, the implicit steps to the steady state
_FILLING = 1e-2  # of its area: a point that the last such step moves further is not steady (native/balance.c, too)
_MINUTE = 1e-3  # of the tolerance: a first correction below it may be round-off, which no further one makes less
_SETTLED = 1e-8  # last correction in such a step, relative to the flows there


class NoSteadyState(InputError):
    """The network has no steady state under the mean of its drive; the message names the place and the remedy."""


def storable(model: Model) -> int:
    """The number of harmonics that fit into memory."""
    mesh = model.mesh
    numbers = model.coefficients.B * (mesh.elimination.inner.size + mesh.n_elements * (mesh.element.N + 3) ** 2)
    return int(_STORAGE / (16.0 * numbers))


def spectrum(model: Model, drive: Drive, T: float, K: int, t: float = 0.0) -> Array:
    """Harmonics (K+1, B or 1, n_inlets) of the drive of the inlets from time t [s] on, [m³/s] or [Pa]."""
    known = drive.harmonics(T, K) if isinstance(drive, Drives) and t == 0.0 else None
    if known is not None:
        return known
    values = np.asarray(drive(t + T / _FINE * np.arange(_FINE)), float)
    values = values.reshape(_FINE, len(model.network.inlets), -1).swapaxes(1, 2)
    return np.fft.rfft(values, axis=0, norm="forward")[: K + 1]


@dataclass(frozen=True)
class Moments:
    """Many moments of all members, processed as larger batches of a few moments: enough that the call overhead is
    small, and few enough for the cache.

    B : members. model, operators : of that batch; a model of one parameter set takes all times at once.
    """

    B: int
    model: Model
    operators: Operators

    @staticmethod
    def of(model: Model, n: int) -> Moments:
        """n : number of moments."""
        B, o = model.coefficients.B, operators(model, model.settings.dt)
        most = _TOGETHER // (B * model.mesh.n_elements)
        together = max(each for each in range(1, n + 1) if n % each == 0 and each <= max(most, 1))
        return Moments(B, *((model, o) if B == 1 else operators_repeated(model, together, model.settings.dt)))

    def of_each(self, *values: Array) -> Iterator[tuple[Array, ...]]:
        """Values at many moments, each (moments, B or 1, …), as batches for the model."""
        every = [np.broadcast_to(x, (len(x), self.B, *x.shape[2:])).reshape(-1, *x.shape[2:]) for x in values]
        size = len(every[0]) if self.B == 1 else self.model.coefficients.B
        for at in range(0, len(every[0]), size):
            yield tuple(x[at : at + size] for x in every)

    def stages(self, waves: Waves, drive: Array) -> Iterator[tuple[Stage, Array, Array, Array]]:
        """For all moments of a period the implicit stage that ends there, at the present rates; with y, dy/dt and H."""
        model, o, P_venous = self.model, self.operators, self.model.coefficients.P_venous
        for y, rate, H, driven in self.of_each(*map(samples, (waves.y, waves.rates, waves.H, drive))):
            yield Stage.of(model, o, y - o.tau * rate, model.inlets.gain * driven, P_venous, 0.0), y, rate, H

    def left_over(self, waves: Waves, drive: Array) -> tuple[Array, Array]:
        """Amplitudes of the residuals of momentum (K+1, B, n_e, N+1) [Pa] and of ΣQ at the nodes (K+1, B, n_nodes)."""
        R, net = list[Array](), list[Array]()
        for stage, y, _, H in self.stages(waves, drive):
            Q = self.model.layout.part(y, "Q")
            R.append(terms.residual(stage.start, Q, H))
            net.append(stage.node_residual(Q, H))
        return amplitudes(np.concatenate(R), waves.y), amplitudes(np.concatenate(net), waves.y)


def moments_of(model: Model, harmonics: int) -> Moments:
    """The moments of a period for this number of harmonics, mean included."""
    return Moments.of(model, SAMPLES * (harmonics - 1))


# --- the steady state ---------------------------------------------------------------------------------------------


def steady(model: Model, mean: Array) -> State:
    """The steady state under constant inflows [m³/s] or pressures at the inlets [Pa] : (B or 1, n_inlets). Raises
    NoSteadyState if there is none, also if the last step still moves an area by more than a hundredth."""
    state, c, layout = initial_state(model), model.coefficients, model.layout
    y, H, Q, A_t = state.y, state.H, state.Q, state.A_t
    given = model.inlets.gain * mean
    settled = settled_below(model, given)
    try:
        for tau in LONG:
            stage = Stage.of(model, operators_about(model, tau, y, H), y, given, c.P_venous, 0.0)
            # guess a flow that keeps the area constant: a long step would multiply any divergence
            Q, H, A_t = stage.solve(evened(Q), H, settled)
            before, y = layout.part(y, "A"), stage.end(Q, A_t)
        check(model, layout.part(y, "A"), A_t, Q, 0.0)
    except (NonPhysicalState, np.linalg.LinAlgError) as error:
        where = f" (segment {error.segment}: {error.reason})" if isinstance(error, NonPhysicalState) else ""
        raise _no_steady_state(model, mean, where) from None
    if np.any(np.abs(layout.part(y, "A") - before) > _FILLING * layout.part(y, "A")):
        raise _no_steady_state(model, mean, " (its arteries fill or empty without end)")
    return replace(state, y=y, H=H, A_t=np.zeros_like(A_t))


def _no_steady_state(model: Model, mean: Array, where: str) -> NoSteadyState:
    names = [inlet.drive for inlet in model.network.inlets]
    pairs = zip(names, mean.mean(axis=0), strict=True)
    means = ", ".join(f"{name} = {x:g} {SIGNAL_UNITS[name[-1]]}" for name, x in pairs)
    return NoSteadyState(
        f"network {model.network.name}: it has no steady state with {means}, the mean{where}; "
        f"change {names[0]} or the outlets, or start from rest."
    )


def settled_below(model: Model, given: Array) -> tuple[Array, Array]:
    """Convergence limits of flows and nodal pressures in such a step : two (B,)."""
    c = model.coefficients  # the flow through the inlets, and the transient flow that P_0 drives
    driven = np.abs(model.inlets.flow(given, c.P_0)).sum(axis=1)
    flow = _SETTLED * (driven + np.abs(c.P_0 - c.P_venous).max(axis=1) / model.impedance)
    return flow + model.flow_floor, flow * model.impedance + model.pressure_floor


# --- the waves ----------------------------------------------------------------------------------------------------


def balanced(
    model: Model, rest: State, drive: Array, T: float, tolerance: float, most: int,
    tell: Callable[[], None] | None = None, forcing: Forcing = NO_FORCING, near: Near | None = None,
    of_first: float = 0.0, keep: bool = False,
) -> tuple[Waves, Array, Near | None]:  # fmt: skip
    """The waves about a steady state under drives with harmonics : (K+1, B or 1, n_inlets) [m³/s or Pa], and the size
    of the last correction of each member : (B,), relative to the pulsating flows.

    tolerance : a smaller correction is the last; with ``of_first``, one smaller than that part of the first is. most :
    maximum number of corrections. If they grow, the waves before them are returned, with infinite size; after ``most``
    the size is infinite, too. tell : called after each. forcing : of sources, beside the drives. near : beats at which
    the corrections start, instead of the steady state. keep : return these beats for others to start at.
    """
    omega = 2.0 * np.pi / T * np.arange(len(drive))
    response, moments = Response.about(model, taus_of(omega), rest), moments_of(model, len(omega))
    drive, forced = drive + forcing.inlets, forcing.nodes * operators(model, model.settings.dt).loads.scale
    accepted = (near.momentum, near.nodes) if near else (0.0, 0.0)

    def left(waves: Waves) -> tuple[Waves, Array, Array]:
        filled = waves if model.storage.proportional else response.filled(waves, moments, drive)
        R, net = moments.left_over(filled, drive)
        return filled, R + forcing.momentum, net + forced

    waves = response.stored(started(model, rest, omega, near), forcing)
    waves = before = _remembering(model, waves, taus_of(omega))
    first = last = np.full(model.coefficients.B, np.inf)
    active, history = last > 0.0, list[tuple[Array, Waves]]()
    for made in range(most):
        filled, R, net = left(waves)
        y, H = response.correction(R - accepted[0], net - accepted[1])
        size = _size(model, y) / np.maximum(_size(model, waves.y + y), np.finfo(float).tiny)
        first = first if made else size
        less = size < last
        better = active & less
        history.append((model.layout.part(y, "Q"), Waves(omega, filled.y + y, filled.H + H)))
        history = history[-1 - EARLIER :]
        corrected = _remembering(model, mixed(history, size > SLOW * last), taus_of(omega))
        waves, before = corrected.where(better, before.where(active & ~less, waves)), waves.where(better, before)
        last = np.where(active, np.where(less, size, np.inf), last)
        active = better & (size > (of_first * np.maximum(first, _MINUTE * tolerance) if of_first else tolerance))
        if tell:
            tell()
        if not active.any():
            break
    kept = Near.of(waves, rest, *left(waves)[1:]) if keep else None
    return waves, np.where(active, np.inf, last), kept


def started(model: Model, rest: State, omega: Array, near: Near | None = None) -> Waves:
    """The waves at which corrections start: the steady state, with the flows, pressures and mean areas of other beats
    about theirs.

    Corrections keep the equations of mass and of the outlets' stores, which are linear, and must find them fulfilled:

        A_k = -∂Q_k/∂x / iω_k,    P_C,k = charge_k Q_k
    """
    begun = Waves(omega, constant(rest.y, len(omega)), constant(rest.H, len(omega)))
    if near is None:
        return begun
    layout, mesh = model.layout, model.mesh
    tau: Any = np.reshape(taus_of(omega), (-1, 1, 1))
    A, Q, P_C = (layout.part(begun.y, name) for name in ("A", "Q", "P_C"))
    A_near, Q_near = (layout.part(near.waves.y, name) for name in ("A", "Q"))
    A[0] += A_near[0]
    A[1:] = tau[1:, ..., None] * (Q_near[1:] @ mesh.element.d_xi) * model.minus_J_inverse
    Q += Q_near
    if P_C.size:
        for ends in model.coefficients.outlets:
            load = ends.load(model.outlet_wall.at(ends.index), tau)
            P_C[..., ends.index] += load.charge * Q_near[:, :, mesh.outlet_element[ends.index], -1]
    return begun._replace(H=begun.H + near.waves.H)


def _size(model: Model, y: Array) -> Array:
    """(B,) norm of the pulsating flows."""
    Q = y[1:, :, model.layout.places["Q"]]
    return np.sqrt((Q.real**2 + Q.imag**2).sum(axis=(0, 2)))


@dataclass(frozen=True)
class Response:
    """The response of a network to small waves about a steady state; frequencies and members share an axis.

    tau : (rows, 1, 1) of the stages. jacobian : inverse. scale, signs, charge : as :class:`~solver.scheme.stage.Loads`.
    storage : (rows, n_e, N) d(∂A/∂t)/d(-∂Q/∂x), 1 without leaks. minus_J_inverse : (rows, n_e, N).
    """

    model: Model
    tau: Array
    jacobian: Condensed
    scale: Array
    signs: Array
    charge: Array
    storage: Array
    minus_J_inverse: Array

    @staticmethod
    def of(model: Model, tau: Any, y: Array, H: Array) -> Response:
        """The response at one frequency, by stages of length tau, about the state y : (B, n), H : (B, n_nodes)."""
        o = operators_about(model, tau, y, H)
        s, _ = start(model, tau, o.inertia, o.memory, o.loads, y, model.coefficients.P_venous)
        slope = s.storage.slope(s.A, 0.0 * s.A)
        storage = np.broadcast_to(np.reshape(slope, np.shape(slope)[:-1]), s.A.shape)
        scale, signs, charge = o.loads.scale, o.loads.signs, o.loads.charge
        return Response(model, tau, o.at_rest, scale, signs, charge, storage, model.minus_J_inverse)

    @staticmethod
    def about(model: Model, taus: Sequence[Any], rest: State) -> Response:
        each = [Response.of(model, tau, rest.y, rest.H) for tau in taus]
        return Response(
            model,
            np.repeat(np.array(taus, complex), model.coefficients.B)[:, None, None],
            Condensed(
                np.concatenate([r.jacobian.K_inverse for r in each]),
                np.concatenate([r.jacobian.by_ends for r in each]),
                Factor.joined([r.jacobian.nodal for r in each]),
                model.mesh.ends,
            ),
            *(
                np.concatenate([getattr(r, name) for r in each])
                for name in ("scale", "signs", "charge", "storage", "minus_J_inverse")
            ),
        )

    def filled(self, waves: Waves, moments: Moments, drive: Array) -> Waves:
        """The waves with areas corrected for the residual of mass with leaks:

            δA = τ s r,    r = -∂Q/∂x - g (P - P_venous) - ∂A/∂t

        with s of ``storage``. Leakage is nonlinear in the area; without leaks the corrections are exact.
        """
        model, left = self.model, list[Array]()
        for stage, y, rate, _ in moments.stages(waves, drive):
            A, A_t, Q = (model.layout.part(x, name) for x, name in ((y, "A"), (rate, "A"), (y, "Q")))
            left.append(stage.start.storage.left_over(stage.start.supply(Q), A, A_t))
        r = amplitudes(np.concatenate(left), waves.y)
        y = waves.y.copy()
        change = self.tau * self.storage * r.reshape(-1, *r.shape[2:])
        model.layout.part(y, "A")[:] += change.reshape(r.shape)
        return waves._replace(y=y)

    def stored(self, waves: Waves, forcing: Forcing) -> Waves:
        """The waves with the outlet pressures stored from the flow of sources just before the outlets."""
        model, P_C = self.model, self.model.layout.part(waves.y, "P_C")
        if P_C.size and isinstance(forcing.nodes, np.ndarray):
            P_C[:] += self.charge.reshape(P_C.shape) * forcing.nodes[..., model.mesh.topology.outlets]
        return waves

    def correction(self, R: Array, net: Array) -> tuple[Array, Array]:
        """Changes of y and H, each (K+1, B, …), that cancel amplitudes R of momentum and of ΣQ at the nodes."""
        n, B = R.shape[:2]
        y, H = self.answer(R.reshape(n * B, *R.shape[2:]), net.reshape(n * B, -1), B)
        return y.reshape(n, B, -1), H.reshape(n, B, -1)

    def answer(self, R: Array, net: Array, means: int) -> tuple[Array, Array]:
        """Changes of y and H, each (rows, …), that cancel R : (rows, n_e, N+1) and net : (rows, n_nodes),

            K δQ = -R + (δH at the ends),    ΣδQ = -net at the nodes,    δA = -τ s ∂δQ/∂x

        with the Jacobian K of momentum in every element, and s of ``storage``. means : number of rows of means.
        """
        model, mesh, layout = self.model, self.model.mesh, self.model.layout
        Q = -np.einsum("beij,bej->bei", self.jacobian.K_inverse, R)
        H = self.jacobian.nodal.solve(net + mesh.net_inflow(Q, self.signs))
        self.jacobian.add_to(Q, H)
        y = np.zeros_like(Q, shape=(len(Q), layout.size))
        layout.part(y, "A")[:] = self.tau * self.storage * (Q @ mesh.element.d_xi) * self.minus_J_inverse
        if means and model.storage.proportional:  # a mean flow fills no area for ever: its divergence is removed
            Q[:means] = evened(Q[:means])
        layout.part(y, "Q")[:] = Q
        if layout.shapes["P_C"][0]:
            layout.part(y, "P_C")[:] = self.charge * Q[:, mesh.outlet_element, -1]
        return y, H

    def to_sources(self, momentum: Array, nodes: Array) -> tuple[Array, Array]:
        """Amplitudes y : (K+1, S, n) and H : (K+1, S, n_nodes) of small waves by S sources, with the same momentum
        (S, n_e, N+1) and ΣQ at the nodes (S, n_nodes) at every harmonic; for one parameter set."""
        model, mesh, layout = self.model, self.model.mesh, self.model.layout
        y = np.zeros((len(self.tau), len(nodes), layout.size), complex)
        H = np.zeros((len(self.tau), len(nodes), mesh.n_nodes), complex)
        for k in range(len(self.tau)):
            of_k = self.jacobian.member(k)
            Q = -np.einsum("eij,sej->sei", of_k.K_inverse[0], momentum)
            H[k] = of_k.nodal.solve(self.scale[k] * nodes + mesh.net_inflow(Q, self.signs[k : k + 1]))
            of_k.add_to(Q, H[k])
            A = self.tau[k] * self.storage[k] * (Q @ mesh.element.d_xi) * self.minus_J_inverse[k]
            layout.part(y[k], "A")[:] = A
            layout.part(y[k], "Q")[:] = evened(Q) if k == 0 and model.storage.proportional else Q
        return y, H


def evened(Q: Array) -> Array:
    """Flows Q : (…, N+1) replaced by their mean over each element."""
    return np.broadcast_to(Q.sum(axis=-1)[..., None] / Q.shape[-1], Q.shape)


def _remembering(model: Model, waves: Waves, taus: Sequence[Any]) -> Waves:
    """The waves with the memory of walls and fluid: linear filters of the viscous stress and of the velocity."""
    part = model.layout.part
    stress, history = part(waves.y, "stress"), part(waves.y, "history")
    if not stress.size and not history.size:
        return waves
    y, rates = samples(waves.y), samples(waves.rates)
    n = len(y) * len(y[0])
    at_once, U = (amplitudes(x.reshape(n, *x.shape[2:]), waves.y) for x in unremembered(model, y, part(rates, "A")))
    for k, tau in enumerate(taus):
        stress[k], history[k] = remembered(model, tau, at_once[k], U[k])
    return waves


def unremembered(model: Model, y: Array, A_t: Array) -> tuple[Array, Array]:
    """At moments y : (…, B, n) with ∂A/∂t : (…, B, n_e, N), the stress of the first wall elements without memory,
    (…, B, ≤ 2, n_e, N) [Pa] (all but the first have the same), and the velocity, (…, B, n_e, N+1) [m/s]."""
    part = model.layout.part
    A = part(y, "A")
    U = part(y, "Q") / (A @ model.mesh.element.at_lobatto)
    if not model.wall.remembers:
        return A[..., None, :, :][..., :0, :, :], U
    return np.moveaxis(model.wall.stresses(A, A_t)[:2], 0, -3), U


def remembered(model: Model, tau: Any, at_once: Array, U: Array) -> tuple[Array, Array]:
    """Amplitudes of the stresses (B, m, n_e, N) and of the history (B, m, n_e, N+1) at one frequency, from the
    amplitudes of :func:`unremembered`."""
    force, unit = model.force, np.ones((1, model.mesh.n_elements, model.mesh.element.N))
    stress = at_once
    if model.wall.remembers:
        weight = weights(np.moveaxis(model.wall.elements[0], 0, 1), tau)
        others = [at_once[:, 1:]] * (weight.shape[1] - 1)
        stress = weight * np.concatenate([at_once[:, :1], *others], axis=1)
    if not force.memories:
        return stress, U[:, None][:, :0]
    nothing = 0.0 * np.stack([U] * force.memories, axis=1)
    return stress, force.since(nothing, tau).history(nothing, U, unit)
