"""Segments in pieces: a chain of uniform pieces with a node between each two, in place of a segment that varies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .mesh import Topology

Array = np.ndarray


@dataclass(frozen=True)
class Pieces:
    """m pieces of the segments, in their order.

    segment : (m,) that of each piece. left, right : (m,) x/L of its ends. nodes : the topology of the pieces; the nodes
    between pieces come after the junctions. node : (n_nodes,) that of every node of the network.
    """

    segment: Array
    left: Array
    right: Array
    nodes: Topology
    node: Array

    @property
    def middle(self) -> Array:
        """x/L of the middle of each piece."""
        return 0.5 * (self.left + self.right)

    @property
    def share(self) -> Array:
        """Length of each piece over that of its segment."""
        return self.right - self.left

    def locate(self, segment: Array, x: Array) -> tuple[Array, Array]:
        """The piece that holds each point x/L of a segment, and the point's place in the piece, from 0 to 1."""
        first = np.searchsorted(self.segment, segment)
        inside = (self.segment == segment[:, None]) & (self.right < x[:, None])
        piece = first + inside.sum(axis=1)
        return piece, (x - self.left[piece]) / self.share[piece]


def pieces(nodes: Topology, edges: Sequence[Array]) -> Pieces:
    """The pieces between the edges x/L, from 0 to 1, of each segment."""
    count = np.array([len(each) - 1 for each in edges])
    segment = np.repeat(np.arange(len(count)), count)
    last = np.cumsum(count) - 1
    first = last - count + 1
    between = nodes.outlets.start + np.arange(len(segment) - len(count))
    node = np.arange(nodes.n_nodes)
    node[nodes.outlets] += len(between)
    start, end = node[nodes.start][segment], node[nodes.end][segment]
    start[np.setdiff1d(np.arange(len(segment)), first)] = between
    end[np.setdiff1d(np.arange(len(segment)), last)] = between
    whole = Topology(start, end, first[nodes.inlet_segment], last[nodes.outlet_segment], nodes.n_nodes + len(between))
    left, right = (np.concatenate([each[part] for each in edges]) for part in (slice(None, -1), slice(1, None)))
    return Pieces(segment, left, right, whole, node)
