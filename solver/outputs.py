"""What is reported of a state: the outputs of the FMU and the columns of a result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .scheme.mesh import Samples
from .scheme.model import Model
from .scheme.sdirk import SDIRK3
from .scheme.step import State

Array = np.ndarray


@dataclass(frozen=True)
class Reporter:
    """Turns states into the outputs, in the order of ``names``: the FMU's variables and the columns of a result."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    report: Callable[[State], Array]

    def __call__(self, state: State) -> Array:
        """(B, n_outputs) SI values."""
        return self.report(state)


def reporter(model: Model) -> Reporter:
    """Outputs of a network: inlet.P (inlet.Q where that is driven), <site>.P, .Q, .R and <outlet>.outlet.P, .Q.

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
    n, B = len(segment), model.coefficients.B
    outlets, outlet_element = mesh.topology.outlets, mesh.outlet_element
    units = network.output_units()

    def report(state: State) -> Array:
        result = np.empty((B, len(units)))
        result[:, 0] = inlet_answer(model, state)
        A_t, AQ = gauss(state.A_t.reshape(B, -1)), both(state.y)
        A = AQ[:, :n]
        P, Q, R = (result[:, 1 + i : 1 + 3 * n : 3] for i in range(3))  # at the sites
        P[:] = wall.pressure(A, A_t)
        if model.wall.remembers:
            # the difference, not the stress itself: so that the answer is continuous as tau vanishes
            stress = model.wall.combined(np.moveaxis(model.layout.part(state.y, "stress"), 1, 0))
            change = stress - model.wall.viscous_stress(state.A, state.A_t)
            change = gauss(np.where(model.wall.forgets, 0.0, change).reshape(B, -1))
            P += wall.K_h * np.sqrt(wall.A0 / A) * change
        Q[:] = AQ[:, n:]
        R[:] = np.sqrt(A / np.pi)
        result[:, 1 + 3 * n :: 2] = state.H[:, outlets]
        result[:, 2 + 3 * n :: 2] = state.Q[:, outlet_element, -1]
        return result

    return Reporter(tuple(units), tuple(units.values()), report)


def inlet_answer(model: Model, state: State) -> Array:
    """The pressure [Pa] of an inlet with a given flow, the flow [m³/s] of one with a given pressure : (B,)."""
    by_flow = model.network.inlet.causality == "flow"
    return state.H[:, 0] if by_flow else state.Q[:, model.mesh.inlet_element, 0]


def volume_entered(model: Model, before: State, after: State) -> Array:
    """The volume [m³] that has flowed in in the step from one state to the next : (B,), as the areas have taken it."""
    first, dt = (..., model.mesh.inlet_element, 0), after.dt
    stages = before.Q[first] + dt * (SDIRK3 @ after.rates[first])
    entered: Array = dt * (SDIRK3[-1] @ stages)
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
