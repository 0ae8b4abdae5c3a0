"""What is reported of a state: the outputs of the FMU and the columns of a result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from .scheme.mesh import Samples
from .scheme.model import Model
from .scheme.sdirk import SDIRK3
from .scheme.step import State

Array = np.ndarray
S = TypeVar("S")  # the states of a scheme


@dataclass(frozen=True)
class Reporter(Generic[S]):
    """Turns states into the outputs, in the order of ``names``: the FMU's variables and the columns of a result."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    report: Callable[[S], Array]

    def __call__(self, state: S) -> Array:
        """(B, n_outputs) SI values."""
        return self.report(state)


def reporter(model: Model) -> Reporter[State]:
    """Outputs of a network: P of each inlet (Q where P is driven), <site>.P, .Q, .R and <outlet>.outlet.P, .Q.

    At a site A and ∂A/∂t are interpolated and P follows from the wall law, and so is what memory makes of the viscous
    stress; the nodal pressures are the multipliers H.
    """
    network, mesh = model.network, model.mesh
    index = {segment.name: i for i, segment in enumerate(network.segments)}
    segment = np.array([index[site.segment] for site in network.sites], int)
    position = np.array([site.position for site in network.sites])
    gauss, lobatto, places = (
        mesh.sample_gauss(segment, position),
        mesh.sample_lobatto(segment, position),
        model.layout.places,
    )
    both = Samples.of_parts(((gauss, places["A"]), (lobatto, places["Q"])))
    wall = model.coefficients.wall_at(segment, position)
    n, B, first = len(segment), model.coefficients.B, len(network.inlets)
    outlets, outlet_element = mesh.topology.outlets, mesh.outlet_element
    units = network.output_units()

    def report(state: State) -> Array:
        result = np.empty((B, len(units)))
        result[:, :first] = inlet_answers(model, state)
        A_t, AQ = gauss(state.A_t.reshape(B, -1)), both(state.y)
        A = AQ[:, :n]
        P, Q, R = (result[:, first + i : first + 3 * n : 3] for i in range(3))  # at the sites
        P[:] = wall.pressure(A, A_t)
        if model.wall.remembers:
            # the difference, not the stress itself: so that the answer is continuous as tau vanishes
            stress = model.wall.combined(np.moveaxis(model.layout.part(state.y, "stress"), 1, 0))
            change = stress - model.wall.viscous_stress(state.A, state.A_t)
            change = gauss(np.where(model.wall.forgets, 0.0, change).reshape(B, -1))
            P += wall.K_h * np.sqrt(wall.A0 / A) * change
        Q[:] = AQ[:, n:]
        R[:] = np.sqrt(A / np.pi)
        result[:, first + 3 * n :: 2] = state.H[:, outlets]
        result[:, first + 1 + 3 * n :: 2] = state.Q[:, outlet_element, -1]
        return result

    return Reporter(tuple(units), tuple(units.values()), report)


def inlet_answers(model: Model, state: State) -> Array:
    """Of inlets with a given flow the pressure [Pa], of those with a given pressure the flow [m³/s] : (B, n_inlets)."""
    found = state.H[:, model.mesh.topology.inlets]
    for i, inlet in enumerate(model.network.inlets):
        if inlet.causality == "pressure":
            found = found.copy()
            found[:, i] = state.Q[:, model.mesh.inlet_element[i], 0]
    return found


def volume_entered(model: Model, before: State, after: State) -> Array:
    """The volume [m³] that has flowed in at each inlet in the step from one state to the next : (B, n_inlets), as the
    areas have taken it."""
    first, dt = (..., model.mesh.inlet_element, 0), after.dt
    stages = before.Q[first] + dt * np.tensordot(SDIRK3, after.rates[first], 1)
    entered: Array = dt * np.tensordot(SDIRK3[-1], stages, 1)
    return entered


def volume_weights(model: Model) -> Array:
    """What a state vector y : (B, n) is multiplied by, and summed, for the blood in arteries and Windkessels [m³].

    Only what flows in and out changes it.
    """
    weights = np.zeros((model.coefficients.B, model.layout.size))
    lengths = -model.mesh.element.w_gauss / model.minus_J_inverse
    weights[:, model.layout.places["A"]] = lengths.reshape(len(weights), -1)
    P_C = model.layout.part(weights, "P_C")
    for ends in model.coefficients.outlets:
        if ends.kind.stores:
            P_C[:, ends.index] = ends.kind.capacity(ends.numbers)
    return weights


def venous_flow(model: Model, state: State, P_venous: Array) -> Array:
    """The flow of each outlet to its P_venous : (n_outlets,) or (B, n_outlets) [Pa], as (B, n_outlets) [m³/s]."""
    P_C, found = model.layout.part(state.y, "P_C"), state.Q[:, model.mesh.outlet_element, -1].copy()
    for ends in model.coefficients.outlets:
        if ends.kind.stores:
            numbers = ends.changed({"P_venous": np.atleast_2d(P_venous)[:, ends.index]})
            found[:, ends.index] = ends.kind.venous_flow(numbers, P_C[:, ends.index], found[:, ends.index])
    return found
