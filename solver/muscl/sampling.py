"""The outputs of a state of the finite volumes."""

from __future__ import annotations

import numpy as np

from ..scheme.model import sites_of
from ..scheme.outputs import Reporter
from .flux import pressure_elastic
from .model import MusclModel
from .step import State

Array = np.ndarray


def reporter(model: MusclModel) -> Reporter[State]:
    """The outputs of :func:`solver.scheme.outputs.reporter`: elastic pressure, Q and ∂A/∂t = -∂Q/∂x at a site by
    cubics through the four nearest cells, P from the wall law; at outlets and inlet pressure and flow of the nodes."""
    network, grid, (segment, position) = model.network, model.mesh, sites_of(model.network)
    cells, value, slope = grid.samples(segment, position)
    around = model.wall.at(cells.ravel())
    wall, L, n = model.coefficients.wall_at(segment, position), model.coefficients.L[:, segment], len(segment)
    units, nodes = network.output_units(), grid.topology
    by_flow, first = [inlet.causality == "flow" for inlet in network.inlets], len(network.inlets)

    def report(state: State) -> Array:
        solved = state.solved
        result = np.empty((len(state.A), len(units)))
        at_inlets = solved.Q_end[:, 0, nodes.inlet_segment]
        result[:, :first] = np.where(by_flow, solved.H[:, nodes.inlets], at_inlets)
        P = pressure_elastic(around, state.A[:, cells.ravel()]).reshape(len(state.A), *cells.shape)
        A, Q = wall.area((P * value).sum(axis=-1)), (state.Q[:, cells] * value).sum(axis=-1)
        A_t = -(state.Q[:, cells] * slope).sum(axis=-1) / L
        sites = (wall.pressure(A, A_t), Q, np.sqrt(A / np.pi))
        result[:, first : first + 3 * n] = np.stack(sites, axis=-1).reshape(len(result), -1)
        result[:, first + 3 * n :: 2] = solved.H[:, nodes.outlets]
        result[:, first + 1 + 3 * n :: 2] = solved.Q_end[:, 1, nodes.outlet_segment]
        return result

    return Reporter(tuple(units), tuple(units.values()), report)
