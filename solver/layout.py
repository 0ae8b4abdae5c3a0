"""The layout of a network from left to right, for drawings. Not part of the FMU's code."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np

from .laws.outlets import Outlet
from .mesh.mesh import topology
from .network.description import Network, Segment

Array = np.ndarray

BEND = 0.45  # columns over which a segment leaves its junction for its own lane


@dataclass(frozen=True)
class Lane:
    """The position of a segment in a drawing: from column ``x0`` to ``x1`` at height ``y``, with its ends at ``y0``,
    ``y1``."""

    segment: Segment
    outlet: Outlet | None
    x0: float
    x1: float
    y: float
    y0: float
    y1: float
    relative_radius: float  # of the widest segment

    def height(self, part: Array | float) -> Array:
        """Height at the fraction ``part`` from x0 to x1: smooth bends at the ends, level between them."""
        x = np.asarray(part, float) * abs(self.x1 - self.x0)

        def smooth(u: Array) -> Array:
            u = np.clip(u, 0.0, 1.0)
            return u * u * (3.0 - 2.0 * u)

        left = smooth(x / BEND)
        right = smooth((x - abs(self.x1 - self.x0)) / BEND + 1.0)
        return self.y + (self.y0 - self.y) * (1.0 - left) + (self.y1 - self.y) * right

    @property
    def middle(self) -> float:
        """Column of the middle of the level part."""
        bend = BEND if self.x1 > self.x0 else -BEND
        return 0.5 * (self.x0 + bend * (self.y0 != self.y) + self.x1 - bend * (self.y1 != self.y))

    @cached_property
    def path(self) -> Array:
        """(n, 2) points of the drawn line."""
        part = np.linspace(0.0, 1.0, 33)
        return np.column_stack([self.x0 + part * (self.x1 - self.x0), self.height(part)])

    def at(self, part: float) -> tuple[float, float]:
        return self.x0 + part * (self.x1 - self.x0), float(self.height(part))


def lanes(network: Network) -> list[Lane]:
    """Lay out a network from left to right: columns by the longest path from an inlet, one lane per free end."""
    nodes = topology(network)
    start, end = nodes.start.tolist(), nodes.end.tolist()
    leaving: dict[int, list[int]] = {}
    for i, node in enumerate(start):
        leaving.setdefault(node, []).append(i)

    # walk the tree depth first, with an explicit stack: (segment that led here, segments still to follow, node)
    y: dict[int, float] = {}
    lane = count()
    left: dict[int, None] = {}  # nodes in the order in which the walk left them: the reverse is downstream order
    inlets = range(nodes.inlets.stop)
    entered, onward, backward = (
        set(inlets),
        set[int](),
        set[int](),
    )  # onward: first to its end; backward: makes a circle
    stack: list[tuple[int | None, Iterator[int], int]] = [(None, iter(leaving[node]), node) for node in inlets[::-1]]
    while stack:
        via, following, node = stack[-1]
        i = next(following, -1)
        if i < 0:
            stack.pop()
            left[node] = None
            if via is not None:
                after = leaving.get(node, [])
                beside = [y[j] for j in after if j in onward] or [y[j] for j in after]
                y[via] = float(np.mean(beside)) if beside else float(next(lane))
        elif end[i] in entered:
            y[i] = float(next(lane))
            if end[i] not in left:
                backward.add(i)
        else:
            entered.add(end[i])
            onward.add(i)
            stack.append((i, iter(leaving.get(end[i], [])), end[i]))
    column = dict.fromkeys(left, 0)
    for node in reversed(list(left)):
        for i in leaving.get(node, []):
            if i not in backward:
                column[end[i]] = max(column[end[i]], column[node] + 1)
    arriving = {node: [y[i] for i in y if end[i] == node and i not in backward] for node in left}
    height = {node: float(np.mean(at)) if at else y[leaving[node][0]] for node, at in arriving.items()}
    outlets = {outlet.segment: outlet for outlet in network.outlets}
    widest = max(segment.R0 for segment in network.segments)
    return [
        Lane(
            segment,
            outlets.get(segment.name),
            column[start[i]],
            column[end[i]],
            y[i],
            height[start[i]],
            height[end[i]],
            segment.R0 / widest,
        )
        for i, segment in enumerate(network.segments)
    ]
