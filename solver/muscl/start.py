"""A state near the periodic one: that of the default scheme, on the cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..periodic import start
from ..scheme.model import build
from .flux import pressure_elastic
from .implicit import Solved
from .model import MusclModel
from .step import State


def periodic_state(
    model: MusclModel, drive: Any, T: float, t: float = 0.0, dt: float | None = None, backend: str = "numpy",
    tolerance: float = 0.0,
) -> State:  # fmt: skip
    """The state of :func:`solver.periodic.start.periodic_state`, with the same arguments and errors.

    The first step from it is an Euler step, as from rest.
    """
    grid, other = model.mesh, build(model.network, model.parameters)
    found = start.periodic_state(other, drive, T, t, dt, backend, tolerance)
    n = len(model.network.segments)
    segment = np.concatenate([grid.segment, np.tile(np.arange(n), 2)])
    x = np.concatenate([grid.middle, np.repeat([0.0, 1.0], n)])
    A, Q = (
        at(segment, x)(other.layout.part(found.y, name).reshape(len(found.y), -1))
        for at, name in ((other.mesh.sample_gauss, "A"), (other.mesh.sample_lobatto, "Q"))
    )
    at_ends = (len(A), 2, n)
    P_end = pressure_elastic(model.ends, A[:, grid.n_cells :].reshape(at_ends))
    H = found.H[:, : grid.topology.n_nodes]
    solved = Solved(Q[:, : grid.n_cells], Q[:, grid.n_cells :].reshape(at_ends), P_end, H)
    P_C, stored = np.zeros((len(A), len(grid.topology.outlet_segment))), other.layout.part(found.y, "P_C")
    if stored.size:  # else no outlet has a stored pressure
        P_C[:] = stored
    return State(t, A[:, : grid.n_cells], solved, P_C)
