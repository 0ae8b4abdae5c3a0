"""Nodes, elements, the parts of a state vector, and sampling. This is the only file that computes indices."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..network.description import Network
from .element import Element, element, lagrange
from .elimination import CORE, Elimination, Sums, eliminated

Array = np.ndarray
Index = Array | slice

_LARGEST_MESH = 200_000  # elements: a larger number is a mistake in a length


@dataclass(frozen=True)
class Topology:
    """Nodes are the points where segments end: first the inlets; then one per junction, then one per outlet.

    start, end : (n_segments,) node at each end. inlet_segment : (n_inlets,). outlet_segment : (n_outlets,).
    """

    start: Array
    end: Array
    inlet_segment: Array
    outlet_segment: Array
    n_nodes: int

    @cached_property
    def inlets(self) -> slice:
        """The nodes of the inlets."""
        return slice(0, len(self.inlet_segment))

    @cached_property
    def outlets(self) -> slice:
        """The nodes of the outlets."""
        return slice(self.n_nodes - len(self.outlet_segment), self.n_nodes)

    @property
    def junctions(self) -> slice:
        """The nodes of the junctions."""
        return slice(len(self.inlet_segment), self.n_nodes - len(self.outlet_segment))


def topology(network: Network) -> Topology:
    """Number the nodes of a network."""
    index = {segment.name: i for i, segment in enumerate(network.segments)}
    start = np.zeros(len(index), int)
    end = np.zeros(len(index), int)
    inlet_segment = np.array([index[inlet.segment] for inlet in network.inlets], int)
    start[inlet_segment] = np.arange(len(inlet_segment))
    for node, junction in enumerate(network.junctions, start=len(inlet_segment)):
        end[[index[name] for name in junction.inflow]] = node
        start[[index[name] for name in junction.outflow]] = node
    outlet_segment = np.array([index[outlet.segment] for outlet in network.outlets], int)
    inner = len(inlet_segment) + len(network.junctions)
    end[outlet_segment] = inner + np.arange(len(outlet_segment))
    return Topology(start, end, inlet_segment, outlet_segment, inner + len(outlet_segment))


class Samples(NamedTuple):
    """Values at points, each a weighted sum of k numbers. at : (n_points, k) their indices. weight : (n_points, k)."""

    at: Array
    weight: Array

    @staticmethod
    def of_parts(parts: Iterable[tuple[Samples, slice]]) -> Samples:
        """Samples of a whole, from the samples of its parts, one after the other."""
        found = [(samples.at + part.start, samples.weight) for samples, part in parts]
        return Samples(*map(np.concatenate, zip(*found, strict=True)))

    def __call__(self, values: Array) -> Array:
        """(B, n_points) of values (B, n)."""
        return np.einsum("bpk,pk->bp", values.take(self.at, 1), self.weight)


def as_slice(index: Array) -> Index:
    """The same as a slice if possible, which is faster."""
    together = slice(int(index[0]), int(index[-1]) + 1) if len(index) else slice(0, 0)
    return together if np.array_equal(np.arange(together.start, together.stop), index) else index


# --- mesh ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mesh:
    """Every segment cut into elements of one degree, equal between the cuts of effects; element ends join at nodes.

    segment : (n_e,) segment of each element. parts : (n_e,) length of the segment over that of the element.
    left : (n_e,) x/L of its left end. piece : (n_e,) number of the interval between cuts that contains it.
    ends : (n_e, 2) node at the left and right end; the first nodes are the topology's. n_nodes : points where elements
    meet, or end. first, count : (n_segments,) first element and number of elements of each segment. core : about the
    number of nodes that are inverted as a whole instead of eliminated.
    """

    topology: Topology
    element: Element
    segment: Array
    parts: Array
    left: Array
    piece: Array
    ends: Array
    n_nodes: int
    first: Array
    count: Array
    core: int = CORE

    @property
    def n_elements(self) -> int:
        return len(self.segment)

    @cached_property
    def inlet_element(self) -> Array:
        """(n_inlets,) first element of each inlet's segment."""
        return self.first[self.topology.inlet_segment]

    @cached_property
    def outer_nodes(self) -> Array:
        """(n_e, N+1) the node at each end of every element; arbitrary inside."""
        nodes = np.repeat(self.ends[:, :1], self.element.N + 1, axis=1)
        nodes[:, -1] = self.ends[:, 1]
        return nodes

    @cached_property
    def outward(self) -> Array:
        """(n_e, N+1): the product with f at the ends of an element is the boundary term [f v]."""
        return np.tile(np.diff(np.eye(self.element.N + 1)[[0, -1]], axis=0), (self.n_elements, 1))

    @cached_property
    def elimination(self) -> Elimination:
        """The elimination for the system of the nodal pressures."""
        return eliminated(self.ends.astype(int).tobytes(), self.n_nodes, self.core)

    @cached_property
    def joined(self) -> Sums:
        """Sums of the flows at element ends (left, right, left, …) at the nodes."""
        return Sums.of(self.ends.ravel())

    @cached_property
    def _at_ends(self) -> Array:
        """Indices, among the flows (n_e (N+1)), of the flows at element ends in the order of ``joined``."""
        element, right = np.divmod(self.joined.order, 2)
        return element * (self.element.N + 1) + right * self.element.N

    def signs(self, scale: Array) -> Array:
        """(B, 2 n_e): weights of the flows in :meth:`net_inflow`, scaled at each node by scale : (B, n_nodes)."""
        return np.where(self.joined.order % 2, 1.0, -1.0) * scale.take(self.ends.ravel()[self.joined.order], 1)

    def net_inflow(self, Q: Array, signs: Array) -> Array:
        """Net inflow of each node, (B, n_nodes), by flows Q : (B, n_e, N+1)."""
        return np.add.reduceat(Q.reshape(len(Q), -1).take(self._at_ends, 1) * signs, self.joined.first, 1)

    @cached_property
    def sink(self) -> Array:
        """(n_e,) the outlet at the end of the element's segment; the number of outlets if it ends at a junction."""
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

    def same_as(self, other: object) -> bool:
        """True if a state on this mesh is valid on the other."""
        if not isinstance(other, Mesh):
            return False
        mine, others = (self.segment, self.parts, self.ends), (other.segment, other.parts, other.ends)
        return self.element.N == other.element.N and all(map(np.array_equal, mine, others))

    def sample_gauss(self, segment: Array, position: Array) -> Samples:
        """A or ∂Q/∂x (B, n_e N) at x = position · L from the nearest points of its piece, N + 1 if it has as many."""
        N = self.element.N
        points, at, weight = self.positions(self.element.x_gauss).ravel(), list[Array](), list[Array]()
        for e, x in zip(self._holding(segment, position), position, strict=True):
            same = np.flatnonzero(self.piece[e] == self.piece[max(0, e - 1) : e + 2]) + max(0, e - 1)
            inside = (N * same[:, None] + np.arange(N)).ravel()
            near = inside[np.sort(np.argsort(np.abs(points[inside] - x), kind="stable")[: N + 1])]
            at.append(np.resize(near, N + 1))
            weight.append(np.resize(lagrange(points[near], np.array([x]))[0], N + 1) * (np.arange(N + 1) < len(near)))
        return Samples(np.array(at, int).reshape(len(at), N + 1), np.array(weight).reshape(len(at), N + 1))

    def sample_lobatto(self, segment: Array, position: Array) -> Samples:
        """Q (B, n_e (N+1)) at x = position · L."""
        n, e = self.element.N + 1, self._holding(segment, position)
        xi = 2.0 * (position - self.left[e]) * self.parts[e] - 1.0
        return Samples(n * e[:, None] + np.arange(n), lagrange(self.element.x_lobatto, xi))

    def _holding(self, segment: Array, position: Array) -> Array:
        """The elements that contain the points x/L of segments."""
        begins = ((first, self.left[first : first + n]) for first, n in zip(self.first, self.count, strict=True))
        ends = dict(enumerate(begins))
        points = zip(segment, position, strict=True)
        return np.array([ends[s][0] + ends[s][1].searchsorted(x, side="right") - 1 for s, x in points], int)


def build_mesh(
    network: Network, L: Array, element_length: float, degree: int, cuts: Sequence[Sequence[float]] | None = None
) -> Mesh:
    """Cut segments of length L : (n_segments,) [m] into elements no longer than ``element_length`` [m].

    cuts : increasing x/L for every segment at which elements must end. Raises ValueError for too many elements.
    """
    nodes = topology(network)
    bounds = [np.array([0.0, *at, 1.0]) for at in (cuts or [()] * len(L))]
    owner = np.repeat(np.arange(len(L)), [len(b) - 1 for b in bounds])  # of each piece
    start, width = np.concatenate([b[:-1] for b in bounds]), np.concatenate([np.diff(b) for b in bounds])
    pieces = np.maximum(1, np.ceil(width * L[owner] / element_length - 1e-9)).astype(int)
    if pieces.sum() > _LARGEST_MESH:
        raise InputError(
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
    n_nodes = nodes.n_nodes + int(inner.sum())
    return Mesh(nodes, element(degree), segment, parts, left, piece, ends, n_nodes, first, count)


# --- the state vector ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout:
    """The places of the named parts of a state vector y : (B, n), one after the other."""

    shapes: Mapping[str, tuple[int, ...]]

    @cached_property
    def places(self) -> dict[str, slice]:
        """The columns of each part."""
        ends = np.cumsum([math.prod(shape) for shape in self.shapes.values()]).tolist()
        return {name: slice(a, b) for name, a, b in zip(self.shapes, [0, *ends], ends, strict=False)}

    @property
    def size(self) -> int:
        """The number of entries of a state vector."""
        return sum(map(math.prod, self.shapes.values()))

    def columns(self, name: str) -> Array:
        """The columns of a part, in its shape."""
        return np.arange(self.size)[self.places[name]].reshape(self.shapes[name])

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
