"""Cells in flat arrays over all segments. The only file of this scheme that knows indices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..mesh.element import lagrange
from ..mesh.elimination import Elimination, eliminate
from ..mesh.mesh import Topology, topology
from ..network.description import Network

Array = np.ndarray

FEWEST = 4  # cells of a segment: the stencil of a site
_MOST = 100_000  # cells of a network


@dataclass(frozen=True)
class Grid:
    """Every segment divided into equal cells, one segment after the other.

    segment : (n_cells,) segment of each cell. count : (n_segments,). left, middle, right : (n_cells,) x/L of the faces
    and the centre. nodes : (2, n_segments) node where each begins and ends.
    """

    topology: Topology
    segment: Array
    count: Array
    left: Array
    middle: Array
    right: Array
    nodes: Array

    @property
    def n_cells(self) -> int:
        return len(self.segment)

    @cached_property
    def first(self) -> Array:
        """(n_segments,) the cell where each begins."""
        return np.cumsum(self.count) - self.count

    @cached_property
    def last(self) -> Array:
        """(n_segments,) the cell where each ends."""
        return np.cumsum(self.count) - 1

    @cached_property
    def at_ends(self) -> Array:
        """(2, 2, n_segments) the cells next to both ends (first axis), the outer and the inner one (second)."""
        return np.stack([np.stack([self.first, self.first + 1]), np.stack([self.last, self.last - 1])])

    @cached_property
    def elimination(self) -> Elimination:
        """The elimination order for the system of the nodes."""
        return eliminate(self.nodes.T, self.topology.n_nodes)

    def same_as(self, other: object) -> bool:
        """Whether a state on this grid is valid on the other."""
        return isinstance(other, Grid) and np.array_equal(self.count, other.count)

    def samples(self, segment: Array, position: Array) -> tuple[Array, Array, Array]:
        """The four cells nearest to x = position · L : (n, 4), and their weights (n, 4) for a value at x and for its
        derivative with respect to x/L."""
        first = np.round(position * self.count[segment] - 0.5 * FEWEST).astype(int)
        first = np.clip(first, 0, self.count[segment] - FEWEST)
        cells = self.first[segment, None] + first[:, None] + np.arange(FEWEST)
        x = position * self.count[segment] - first - 0.5  # in cells, from the first of the four
        nodes = np.arange(float(FEWEST))
        to_powers = np.linalg.inv(nodes[:, None] ** np.arange(FEWEST))
        powers = np.arange(1, FEWEST)
        slope = np.concatenate([np.zeros((len(x), 1)), powers * x[:, None] ** (powers - 1)], axis=1) @ to_powers
        return cells, lagrange(nodes, x), slope * self.count[segment, None]


def build_grid(network: Network, L: Array, cell: float) -> Grid:
    """Divide segments of length L : (n_segments,) [m] into cells of at most ``cell`` [m], at least four each.

    Raises ValueError if that makes too many.
    """
    count = np.maximum(FEWEST, np.ceil(L / cell - 1e-9)).astype(int)
    if count.sum() > _MOST:
        raise InputError(
            f"muscl settings: cell = {cell:g} m cuts network {network.name} into {count.sum()} cells, more than "
            f"{_MOST}; use longer cells or check the lengths of the segments."
        )
    nodes, segment = topology(network), np.repeat(np.arange(len(L)), count)
    place, n = np.arange(len(segment)) - (np.cumsum(count) - count)[segment], count[segment]
    ends = np.stack([nodes.start, nodes.end])
    return Grid(nodes, segment, count, place / n, (place + 0.5) / n, (place + 1) / n, ends)
