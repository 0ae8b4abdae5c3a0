"""Where things are: nodes, elements, the parts of a state vector, and sampling. The only file that knows indices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..network import Network
from .element import Element, element, lagrange

Array = np.ndarray

_LARGEST_MESH = 4000  # elements; the nodal system is dense, and 1000 elements already take some 5 ms a step


@dataclass(frozen=True)
class Topology:
    """Nodes are the points where segments end: node 0 is the inlet; then one per junction, then one per outlet.

    start, end : (n_segments,) node at each end. outlet_segment : (n_outlets,).
    """

    start: Array
    end: Array
    outlet_segment: Array
    n_nodes: int

    @property
    def outlets(self) -> slice:
        """The nodes of the outlets."""
        return slice(self.n_nodes - len(self.outlet_segment), self.n_nodes)

    @property
    def junctions(self) -> slice:
        """The nodes of the junctions."""
        return slice(1, self.n_nodes - len(self.outlet_segment))


def topology(network: Network) -> Topology:
    """Number the nodes of a network."""
    index = {segment.name: i for i, segment in enumerate(network.segments)}
    start = np.zeros(len(index), int)
    end = np.zeros(len(index), int)
    for node, junction in enumerate(network.junctions, start=1):
        end[[index[name] for name in junction.inflow]] = node
        start[[index[name] for name in junction.outflow]] = node
    outlet_segment = np.array([index[outlet.segment] for outlet in network.outlets], int)
    end[outlet_segment] = 1 + len(network.junctions) + np.arange(len(outlet_segment))
    return Topology(start, end, outlet_segment, 1 + len(network.junctions) + len(network.outlets))


# --- mesh ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mesh:
    """Every segment cut into elements of one degree, equal but where an effect wants cuts; element ends join at nodes.

    segment : (n_e,) segment of each element. parts : (n_e,) length of the segment over that of the element.
    left : (n_e,) x/L where it begins. piece : (n_e,) number of the stretch between cuts that it lies in.
    ends : (n_e, 2) node at the left and right end; the first nodes are the topology's.
    incidence : (n_nodes, 2 n_e) net inflow of each node from the flows at the element ends (left, right, left, …).
    first, count : (n_segments,) first element and number of elements of each segment.
    """

    topology: Topology
    element: Element
    segment: Array
    parts: Array
    left: Array
    piece: Array
    ends: Array
    incidence: Array
    first: Array
    count: Array

    @property
    def n_nodes(self) -> int:
        return len(self.incidence)

    @property
    def n_elements(self) -> int:
        return len(self.segment)

    @cached_property
    def inlet_element(self) -> int:
        """The element that starts at the inlet."""
        return int(np.flatnonzero(self.ends[:, 0] == 0)[0])

    @cached_property
    def net_inflow(self) -> Array:
        """(2 n_e, n_nodes): flows at the element ends (left, right, left, …) times it are the nodes' net inflows."""
        return np.ascontiguousarray(self.incidence.T)

    @cached_property
    def sink(self) -> Array:
        """(n_e,) the outlet where the element's segment ends; the number of outlets where it ends at a junction."""
        outlets = self.topology.outlet_segment
        sink = np.full(len(self.count), len(outlets))
        sink[outlets] = np.arange(len(outlets))
        return sink[self.segment]

    @cached_property
    def outlet_element(self) -> Array:
        """(n_outlets,) last element of each outlet's segment."""
        s = self.topology.outlet_segment
        return self.first[s] + self.count[s] - 1

    def positions(self, xi: Array) -> Array:
        """x/L : (n_e, len(xi)) of points ξ in [-1, 1] of every element."""
        return self.left[:, None] + (xi + 1.0) / 2.0 / self.parts[:, None]

    def same_as(self, other: Mesh) -> bool:
        """Whether a state on this mesh means the same on the other."""
        mine, others = (self.segment, self.parts, self.ends), (other.segment, other.parts, other.ends)
        return self.element.N == other.element.N and all(map(np.array_equal, mine, others))

    def sample_gauss(self, segment: Array, position: Array) -> Array:
        """Matrix (n_points, n_e N): A or ∂Q/∂x at x = position · L from the N + 1 nearest points of its piece."""
        N = self.element.N
        points = self.positions(self.element.x_gauss).ravel()
        W = np.zeros((len(segment), self.n_elements * N))
        for row, (s, x) in enumerate(zip(segment, position, strict=True)):
            at = np.flatnonzero(np.repeat(self.piece == self.piece[self._holding(s, x)], N))
            near = at[np.sort(np.argsort(np.abs(points[at] - x), kind="stable")[: N + 1])]
            W[row, near] = lagrange(points[near], np.array([x]))[0]
        return W

    def sample_lobatto(self, segment: Array, position: Array) -> Array:
        """Matrix (n_points, n_e (N+1)) that evaluates Q at x = position · L."""
        n = self.element.N + 1
        W = np.zeros((len(segment), self.n_elements * n))
        for row, (s, x) in enumerate(zip(segment, position, strict=True)):
            e = self._holding(s, x)
            xi = 2.0 * (x - self.left[e]) * self.parts[e] - 1.0
            W[row, e * n : e * n + n] = lagrange(self.element.x_lobatto, np.array([xi]))[0]
        return W

    def _holding(self, segment: int, x: float) -> int:
        """The element that holds the point x/L of a segment."""
        own = slice(self.first[segment], self.first[segment] + self.count[segment])
        return int(self.first[segment] + np.searchsorted(self.left[own], x, side="right") - 1)


def build_mesh(
    network: Network, L: Array, element_length: float, degree: int, cuts: Sequence[Sequence[float]] | None = None
) -> Mesh:
    """Cut segments of length L : (n_segments,) [m] into elements no longer than ``element_length`` [m].

    cuts : x/L for every segment at which elements must end, increasing. Raises ValueError if that makes too many.
    """
    nodes = topology(network)
    bounds = [np.array([0.0, *at, 1.0]) for at in (cuts or [()] * len(L))]
    owner = np.repeat(np.arange(len(L)), [len(b) - 1 for b in bounds])  # of each piece
    start, width = np.concatenate([b[:-1] for b in bounds]), np.concatenate([np.diff(b) for b in bounds])
    pieces = np.maximum(1, np.ceil(width * L[owner] / element_length - 1e-9)).astype(int)
    if pieces.sum() > _LARGEST_MESH:
        raise ValueError(
            f"element_length = {element_length:g} m cuts network {network.name} into {pieces.sum()} elements, more "
            f"than {_LARGEST_MESH}; use longer elements (5 cm is the default) or check the lengths of the segments."
        )
    piece = np.repeat(np.arange(len(owner)), pieces)
    segment, parts = owner[piece], pieces[piece] / width[piece]
    left = start[piece] + (np.arange(len(piece)) - (np.cumsum(pieces) - pieces)[piece]) / parts
    count = np.bincount(segment, minlength=len(L))
    first = np.cumsum(count) - count
    place = np.arange(len(segment)) - first[segment]
    inner = place < count[segment] - 1  # the element's right end lies inside the segment
    ends = np.stack([nodes.start[segment], nodes.end[segment]], axis=1)
    ends[inner, 1] = nodes.n_nodes + np.arange(inner.sum())
    ends[np.flatnonzero(inner) + 1, 0] = ends[inner, 1]
    incidence = np.zeros((nodes.n_nodes + inner.sum(), 2 * len(segment)))
    at = np.arange(len(segment))
    incidence[ends[:, 0], 2 * at] = -1.0
    incidence[ends[:, 1], 2 * at + 1] = 1.0
    return Mesh(nodes, element(degree), segment, parts, left, piece, ends, incidence, first, count)


# --- the state vector ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout:
    """Where the named parts of a state vector y : (B, n) lie, one after the other."""

    shapes: Mapping[str, tuple[int, ...]]

    @cached_property
    def places(self) -> dict[str, slice]:
        """The columns of each part."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes.values()]).tolist()
        return {name: slice(a, b) for name, a, b in zip(self.shapes, [0, *ends], ends, strict=False)}

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return sum(map(math.prod, self.shapes.values()))

    def part(self, y: Array, name: str) -> Array:
        """A view of one part, (..., *shape)."""
        return y[..., self.places[name]].reshape(y.shape[:-1] + self.shapes[name])

    @cached_property
    def _cuts(self) -> list[tuple[slice, tuple[int, ...]]]:
        return list(zip(self.places.values(), self.shapes.values(), strict=True))

    def split(self, y: Array) -> list[Array]:
        """Views of all parts of a y : (B, n)."""
        B = (len(y),)
        return [y[:, columns].reshape(B + shape) for columns, shape in self._cuts]

    def join(self, *parts: Array) -> Array:
        """The vector y : (B, n) of parts (B, *shape)."""
        B = len(parts[0])
        return np.concatenate([part.reshape(B, -1) for part in parts], axis=1)
