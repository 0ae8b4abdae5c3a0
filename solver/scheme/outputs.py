"""The outputs of a state: the outputs of the FMU and the columns of a result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from ..mesh.mesh import Layout, Samples
from .model import Model, sites_of
from .sdirk import SDIRK3
from .step import State

Array = np.ndarray
S = TypeVar("S")  # the states of a scheme


@dataclass(frozen=True)
class Reporter(Generic[S]):
    """Compute the outputs of states, in the order of ``names``: the FMU's variables and the columns of a result."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    report: Callable[[S], Array]

    def __call__(self, state: S) -> Array:
        """(B, n_outputs) SI values."""
        return self.report(state)


def reporter(model: Model, tables: bool = True) -> Reporter[State]:
    """Outputs of a network: P of each inlet (Q for a given P), <site>.P, .Q, .R and <outlet>.outlet.P, .Q.

    At a site A, ∂A/∂t and the effect of memory on the viscous stress are interpolated, and P follows from the wall law.
    Where parts of a wall begin and end (``on_parts``) A is not smooth: there P, K ε and K ε̇ are interpolated, and A
    follows. The nodal pressures are the multipliers H. tables : include the direct contributions of source tables at
    the time of the state.
    """
    network, mesh, wall, (segment, position) = model.network, model.mesh, model.site_wall, sites_of(model.network)
    gauss, lobatto = mesh.sample_gauss(segment, position), mesh.sample_lobatto(segment, position)
    # for a state vector followed by ∂A/∂t and H
    joined = Layout({**model.layout.shapes, "A_t": model.layout.shapes["A"], "H": (mesh.n_nodes,)})
    sampled = Samples.of_parts((at, joined.places[part]) for at, part in ((gauss, "A"), (gauss, "A_t"), (lobatto, "Q")))
    Q_columns, H_columns, inlets = joined.columns("Q"), joined.columns("H"), model.inlets
    at_inlets = np.where(inlets.by_flow, H_columns[mesh.topology.inlets], inlets.first)
    at_outlets = np.stack([H_columns[mesh.topology.outlets], Q_columns[mesh.outlet_element, -1]], axis=1)
    ends = np.concatenate([at_inlets, at_outlets.ravel()])
    n, first = len(segment), len(at_inlets)
    units = network.output_units()

    def report(state: State) -> Array:
        B = len(state.y)  # parameter sets, or instants of one
        values = joined.join(state.y, state.A_t, state.H)
        result = np.empty_like(values, shape=(B, len(units)))
        A, A_t, flow = sampled(values).reshape(B, 3, n).swapaxes(0, 1)
        at_ends = values.take(ends, 1)
        result[:, :first], result[:, first + 3 * n :] = at_ends[:, :first], at_ends[:, first:]
        P, Q, R = (result[:, first + i : first + 3 * n : 3] for i in range(3))  # at the sites
        P[:] = wall.pressure(A, A_t)
        if model.wall.remembers:
            # the difference, not the stress itself, so that the result is continuous as tau vanishes
            stress = model.wall.combined(np.moveaxis(model.layout.part(state.y, "stress"), 1, 0))
            change = stress - model.wall.viscous_stress(state.A, state.A_t)
            change = np.where(model.wall.forgets, 0.0, change)
            P += wall.K_h * np.sqrt(wall.A0 / A) * gauss(change.reshape(B, -1))
        if model.on_parts.any():
            walls, stretch = model.wall, np.sqrt(state.A / model.wall.A0)
            pressure = walls.pressure(state.A, state.A_t)
            if walls.remembers:
                pressure += walls.K_h / stretch * change
            P_smooth = gauss(pressure.reshape(B, -1))
            s = 1.0 + gauss((walls.K * (stretch - 1.0)).reshape(B, -1)) / wall.K
            rate = gauss((walls.K * walls.strain_rate(state.A, state.A_t)).reshape(B, -1)) / wall.K
            A_smooth = wall.A0 * s * s
            viscous = wall.pressure(A_smooth, 2.0 * wall.A0 * s * rate) - wall.pressure(A_smooth, 0.0 * rate)
            if walls.remembers:
                viscous += wall.K_h / s * gauss(change.reshape(B, -1))
            A, P[:] = np.where(model.on_parts, wall.area(P_smooth - viscous), A), np.where(model.on_parts, P_smooth, P)
        Q[:] = flow
        R[:] = np.sqrt(A / np.pi)
        if tables:
            model.tables.add_to_outputs(result, state.t)
        return result

    return Reporter(tuple(units), tuple(units.values()), report)


def inlet_answers(model: Model, state: State) -> Array:
    """The pressure [Pa] of inlets with a given flow, or the flow [m³/s] of those with a given pressure : (B,
    n_inlets)."""
    inlets = model.inlets
    return np.where(inlets.by_flow, state.H[:, model.mesh.topology.inlets], state.y[:, inlets.first])


def volume_entered(model: Model, before: State, after: State) -> Array:
    """The volume [m³] that entered at each inlet between two successive states : (B, n_inlets), consistent with the
    areas."""
    first, dt = (..., model.mesh.inlet_element, 0), after.dt
    stages = before.Q[first] + dt * np.tensordot(SDIRK3, after.rates[first], 1)
    entered: Array = dt * np.tensordot(SDIRK3[-1], stages, 1)
    return entered


def volume_weights(model: Model) -> Array:
    """The weights whose product with a state vector y : (B, n) is the blood volume in arteries and Windkessels [m³].

    Only inflow and outflow change this volume.
    """
    weights = np.zeros_like(model.kinetic, shape=(model.coefficients.B, model.layout.size))
    lengths = -model.mesh.element.w_gauss / model.minus_J_inverse
    weights[:, model.layout.places["A"]] = lengths.reshape(len(weights), -1)
    P_C = model.layout.part(weights, "P_C")
    for ends in model.coefficients.outlets:
        if ends.kind.stores:
            P_C[:, ends.index] = ends.kind.capacity(ends.numbers)
    return weights


def venous_flow(model: Model, state: State, P_venous: Array) -> Array:
    """The flow of each outlet to its P_venous : (n_outlets,) or (B, n_outlets) [Pa], as (B, n_outlets) [m³/s]."""
    (acting,) = model.tables.at(np.array([state.t]))
    Q, P_C = state.Q[:, model.mesh.outlet_element, -1], model.layout.part(state.y, "P_C")
    found = model.tables.let_out(Q, acting).copy()
    for ends in model.coefficients.outlets:
        if ends.kind.stores:
            numbers = ends.changed({"P_venous": np.atleast_2d(P_venous)[:, ends.index]})
            found[:, ends.index] = ends.kind.venous_flow(numbers, P_C[:, ends.index], found[:, ends.index])
    return found
