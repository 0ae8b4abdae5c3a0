"""A state to start from that is near the periodic one, so that nobody waits ten beats for it.

All of it with the equations of the scheme itself, so that everything a network holds takes part:

1. The steady state of the mean inflow, by implicit steps so long that everything but the flow comes to rest.
2. The waves about it, harmonic by harmonic. A stage of length τ puts (x - x_start)/τ for dx/dt; with τ = 1/iω its
   Jacobian is that of small waves e^{iωt}: linear theory as in :mod:`~solver.linear`, about stretched walls with flow.
3. Harmonic balance: what these waves leave over in the nonlinear equations during a period is corrected with the same
   Jacobians, a few times. This moves the mean too, which differs from the state of the mean inflow.

Where the corrections grow, what was there before them stands. Waves so large that the state would not be physical are
left out: it is then the steady one.

Harmonic balance: M. S. Nakhla, J. Vlach, IEEE Trans. Circuits Syst. 23 (1976) 85; here with fixed Jacobians.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .memory import weights
from .scheme import terms
from .scheme.guards import NonPhysicalState, check
from .scheme.model import Model
from .scheme.sdirk import SDIRK3
from .scheme.stage import Operators, Stage, operators, operators_about, start
from .scheme.step import State, initial_state
from .units import SIGNAL_UNITS

Array = np.ndarray
Drive = Callable[[Array], Array]

_MOST, _FEWEST = 32, 4  # harmonics
_STORAGE = 5e8  # bytes of the Jacobians of all harmonics; a large mesh or batch has fewer of them
_SAMPLES = 4  # of a period for each harmonic, so that products of harmonics have room
_FINE = 4096  # samples of the inflow, whose mean counts
_LONG = (1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4)  # s, the implicit steps to the steady state
_SETTLED = 1e-8  # last correction in such a step, relative to the flows there
_CORRECTIONS = 6
_SMALL = 1e-4  # a correction of this part of the waves is the last


def periodic_state(model: Model, drive: Drive, T: float, t: float = 0.0, dt: float | None = None) -> State:
    """A state at time t [s] near that of the beats which repeat under what drives the inlet.

    drive : Q(t) [m³/s] for an array of times, or P(t) [Pa] where the inlet's causality is pressure; (n,) or of each
    member (n, B); of several inlets (n, n_inlets) or (n, n_inlets, B). T : its period [s]. dt : the step [s] to come,
    default the settings'.
    Raises ValueError where the network has no steady state with the mean of the drive.
    """
    samples = np.asarray(drive(t + T / _FINE * np.arange(_FINE)), float)
    samples = samples.reshape(_FINE, len(model.network.inlets), -1).swapaxes(1, 2)
    harmonics = np.fft.rfft(samples, axis=0, norm="forward")[: _kept(model) + 1]
    with np.errstate(all="ignore"):
        rest = _steady(model, harmonics[0].real)
        return _state(model, _balanced(model, rest, harmonics, T), rest, t, dt or model.settings.dt)


def _kept(model: Model) -> int:
    """How many harmonics are kept."""
    mesh = model.mesh
    numbers = model.coefficients.B * (mesh.elimination.inner.size + mesh.n_elements * (mesh.element.N + 3) ** 2)
    return int(np.clip(_STORAGE / (16.0 * numbers), _FEWEST, _MOST))


class _Waves(NamedTuple):
    """Amplitudes of e^{iωt}, the mean first: y (K+1, B, n) of the state vector, H (K+1, B, n_nodes) [Pa]."""

    omega: Array
    y: Array
    H: Array

    def at(self, t: float, derivative: bool = False) -> tuple[Array, Array]:
        """y and H, or their time derivatives, t [s] after the start."""
        turn = np.where(self.omega == 0.0, 1.0, 2.0) * np.exp(1j * self.omega * t)
        turn = turn * (1j * self.omega) if derivative else turn
        y, H = (np.tensordot(turn, x, 1).real for x in (self.y, self.H))
        return y, H


def _samples(x: Array) -> Array:
    """Values over a period : (4 K, …) of amplitudes x : (K+1, …)."""
    return np.fft.irfft(x, _SAMPLES * (len(x) - 1), axis=0, norm="forward")


def _amplitudes(x: Array | Sequence[Array]) -> Array:
    """Amplitudes : (K+1, …) of values over a period : (4 K, …)."""
    return np.fft.rfft(x, axis=0, norm="forward")[: len(x) // _SAMPLES + 1]


# --- the steady state ---------------------------------------------------------------------------------------------


def _steady(model: Model, mean: Array) -> State:
    """The steady state under constant inflows [m³/s] or pressures at the inlets [Pa] : (B or 1, n_inlets)."""
    state, c, layout = initial_state(model), model.coefficients, model.layout
    y, H, Q, A_t = state.y, state.H, state.Q, state.A_t
    # the flow that passes, and the one that P_0 drives on the way
    given = model.inlets.gain * mean
    driven = np.abs(model.inlets.flow(given, c.P_0)).sum(axis=1)
    flow = _SETTLED * (driven + np.abs(c.P_0 - c.P_venous).max(axis=1) / model.impedance)
    small = flow + model.flow_floor, flow * model.impedance + model.pressure_floor
    try:
        for tau in _LONG:
            stage = Stage.of(model, operators_about(model, tau, y, H), y, given, c.P_venous, 0.0)
            # a guess of the flow that leaves the area as it is: a long step would multiply what does not
            Q, H, A_t = stage.solve(0.0 * Q + Q.mean(axis=-1, keepdims=True), H, small)
            y = stage.end(Q, A_t)
        check(model, layout.part(y, "A"), A_t, Q, 0.0)
    except (NonPhysicalState, np.linalg.LinAlgError) as error:
        where = f" (segment {error.segment}: {error.reason})" if isinstance(error, NonPhysicalState) else ""
        names = [inlet.drive for inlet in model.network.inlets]
        means = ", ".join(
            f"{name} = {x:g} {SIGNAL_UNITS[name[-1]]}" for name, x in zip(names, mean.mean(axis=0), strict=True)
        )
        raise ValueError(
            f"network {model.network.name}: it has no steady state with {means}, the mean{where}; "
            f"change {names[0]} or the outlets, or start from rest."
        ) from None
    return replace(state, y=y, H=H, A_t=np.zeros_like(A_t))


# --- the waves ----------------------------------------------------------------------------------------------------


def _balanced(model: Model, rest: State, drive: Array, T: float) -> _Waves:
    """The waves about a steady state under drives with harmonics : (K+1, B or 1, n_inlets) [m³/s or Pa]."""
    omega = 2.0 * np.pi / T * np.arange(len(drive))
    # the mean is a wave so slow that everything follows it
    responses = [_Response.about(model, 1.0 / (1j * w) if w else _LONG[-1], rest) for w in omega]
    waves = _Waves(omega, _constant(rest.y, len(omega)), _constant(rest.H, len(omega)))
    before, smallest = None, np.inf
    for _ in range(_CORRECTIONS):
        R, net = _left_over(model, waves, drive)
        y, H = (np.array(x) for x in zip(*map(_Response.correction, responses, R, net), strict=True))
        size = _size(model, y[1:]) / (_size(model, waves.y[1:] + y[1:]) or 1.0)
        if not size < smallest:
            return before or waves
        before = waves if smallest < np.inf else None
        waves = _remembering(model, _Waves(omega, waves.y + y, waves.H + H), responses)
        smallest = size
        if size < _SMALL:
            break
    return waves


def _constant(x: Array, n: int) -> Array:
    return np.concatenate([x[None], np.zeros((n - 1, *x.shape))]).astype(complex)


def _size(model: Model, y: Array) -> float:
    return float(np.linalg.norm(model.layout.part(y, "Q")))


@dataclass(frozen=True)
class _Response:
    """How a network answers small waves of one frequency about a steady state.

    operators : of stages of length 1/iω. storage : (B, n_e, N) d(∂A/∂t)/dQ_x, -1 without leaks.
    """

    model: Model
    operators: Operators
    storage: Array

    @staticmethod
    def about(model: Model, tau: Any, rest: State) -> _Response:
        o = operators_about(model, tau, rest.y, rest.H)
        s, _ = start(model, tau, o.inertia, o.memory, o.loads, rest.y, model.coefficients.P_venous)
        slope = s.storage.slope(rest.A, rest.A_t)
        return _Response(model, o, np.reshape(slope, np.shape(slope)[:-1]) * model.minus_J_inverse)

    def correction(self, R: Array, net: Array) -> tuple[Array, Array]:
        """Changes of y and H that cancel amplitudes of momentum and of ΣQ at the nodes that are left over."""
        mesh, o, jacobian = self.model.mesh, self.operators, self.operators.at_rest
        Q = -np.einsum("beij,bej->bei", jacobian.K_inverse, R)
        H = jacobian.nodal.solve(net + mesh.net_inflow(Q, o.loads.signs))
        jacobian.add_to(Q, H)
        y = np.zeros((len(Q), self.model.layout.size), complex)
        part = self.model.layout.part
        part(y, "A")[:] = o.tau * self.storage * (Q @ mesh.element.d_xi)
        part(y, "Q")[:] = Q
        if part(y, "P_C").size:
            part(y, "P_C")[:] = o.loads.charge * Q[:, mesh.outlet_element, -1]
        return y, H


def _left_over(model: Model, waves: _Waves, drive: Array) -> tuple[Array, Array]:
    """Amplitudes of momentum (K+1, B, n_e, N+1) [Pa] and of ΣQ at the nodes (K+1, B, n_nodes) that do not vanish."""
    o, P_venous = operators(model, model.settings.dt), model.coefficients.P_venous
    rates = 1j * waves.omega[:, None, None] * waves.y
    R, net = list[Array](), list[Array]()
    for y, rate, H, driven in zip(*map(_samples, (waves.y, rates, waves.H, drive)), strict=True):
        # an implicit step from where it would have come from at its present rate
        stage = Stage.of(model, o, y - o.tau * rate, model.inlets.gain * driven, P_venous, 0.0)
        Q = model.layout.part(y, "Q")
        R.append(terms.residual(stage.start, Q, H))
        net.append(stage.node_residual(Q, H))
    return _amplitudes(R), _amplitudes(net)


def _remembering(model: Model, waves: _Waves, responses: Sequence[_Response]) -> _Waves:
    """The waves with what walls and fluid remember: linear filters of the strain rate's stress and of the velocity."""
    part = model.layout.part
    stress, history = part(waves.y, "stress"), part(waves.y, "history")
    if not stress.size and not history.size:
        return waves
    y, rates = _samples(waves.y), _samples(1j * waves.omega[:, None, None] * waves.y)
    A = part(y, "A")
    at_once = _amplitudes(np.moveaxis(model.wall.stresses(A, part(rates, "A")), 0, 2))
    relaxing = np.moveaxis(model.wall.elements[0], 0, 1)
    U = _amplitudes(part(y, "Q") / (A @ model.mesh.element.at_lobatto))
    for k, response in enumerate(responses):
        tau: Any = response.operators.tau
        if stress.size:
            stress[k] = weights(relaxing, tau) * at_once[k]
        if history.size:
            unit = np.ones(A.shape[1:])
            history[k] = model.force.since(history[k], tau).history(0.0 * history[k], U[k], unit)
    return waves


# --- the state ----------------------------------------------------------------------------------------------------


def _state(model: Model, waves: _Waves, rest: State, t: float, dt: float) -> State:
    """The state at the start of the period, with the stage values from which the next steps are guessed."""
    layout, at = model.layout, dt * SDIRK3.sum(axis=1)
    (y, H), (rate, _) = waves.at(0.0), waves.at(0.0, derivative=True)
    A_t = layout.part(rate, "A").copy()
    try:
        check(model, layout.part(y, "A"), A_t, layout.part(y, "Q"), t)
    except NonPhysicalState:
        return replace(rest, t=t)
    unknowns, before = (_stage_values(waves, rest, at - n * dt) for n in (1, 2))
    return replace(rest, t=t, y=y, H=H, A_t=A_t, unknowns=unknowns, unknowns_before=before, dt=dt)


def _stage_values(waves: _Waves, rest: State, times: Array) -> Array:
    """∂Q/∂t and H at the times [s] of the stages of a step : (STAGES, B, m)."""
    found = []
    for s in times:
        (rates, _), (_, H) = waves.at(s, derivative=True), waves.at(s)
        found.append(rest.guess.join(rest.layout.part(rates, "Q"), H))
    return np.array(found)
