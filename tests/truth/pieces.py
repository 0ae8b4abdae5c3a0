"""Pieces of vessels and the points on them: where the equations of ``network.py`` are collocated.

A vessel is one piece, or several if it has a stenosis, or a leak or another stiffness in a part of it. A and Q live at
n Chebyshev-Lobatto points of a piece, the two equations at n - 1 Gauss points: with two conditions a piece, as many
equations as unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from .anatomy import Anatomy, Vessel

Array = np.ndarray


@dataclass(frozen=True)
class Piece:
    """A part of a vessel between start and stop [x/L]; vessel : as it is there, K that of the whole length."""

    vessel: Vessel
    start: float
    stop: float

    @property
    def length(self) -> float:
        return (self.stop - self.start) * self.vessel.L


@dataclass(frozen=True)
class Node:
    """Ends of pieces that meet, as (piece, side) with side 0 left and 1 right, and the k of their common head."""

    ends: tuple[tuple[int, int], ...]
    k: float


def cut(model: Anatomy) -> tuple[list[Piece], list[Node]]:
    """The pieces of all vessels, and the nodes between them."""
    pieces: list[Piece] = []
    nodes: list[Node] = []
    first: dict[str, int] = {}
    last: dict[str, int] = {}
    for vessel in model.vessels:
        marks = sorted({0.0, 1.0, *(mark for part in vessel.parts().values() for mark in part)})
        first[vessel.name] = len(pieces)
        for start, stop in pairwise(marks):
            here = vessel.at(0.5 * (start + stop))
            if start > 0.0:
                # a steep change of A keeps P + α ρU²/2; where A is the same on both sides there is nothing to keep
                k = model.alpha if here.E != pieces[-1].vessel.E else 0.0
                nodes.append(Node(((len(pieces) - 1, 1), (len(pieces), 0)), k))
            pieces.append(Piece(here, start, stop))
        last[vessel.name] = len(pieces) - 1
    for join in model.joins:
        ends = [(last[name], 1) for name in join.inflow] + [(first[name], 0) for name in join.outflow]
        nodes.append(Node(tuple(ends), join.k))
    return pieces, nodes


@dataclass(frozen=True)
class Points:
    """n Lobatto points on [0, 1] and the maps from values there to values and slopes at the n - 1 Gauss points."""

    xi: Array
    to_gauss: Array
    slope: Array


@lru_cache
def points(n: int) -> Points:
    """Points and maps for n Lobatto points."""
    xi = 0.5 * (1.0 - np.cos(np.pi * np.arange(n) / (n - 1)))
    gauss = 0.5 * (1.0 + np.polynomial.legendre.leggauss(n - 1)[0])
    # exact for polynomials: values and slopes of Chebyshev polynomials at both sets of points
    basis = np.polynomial.chebyshev.Chebyshev.basis
    at_lobatto = np.stack([basis(i, [0, 1])(xi) for i in range(n)], axis=1)
    at_gauss = np.stack([basis(i, [0, 1])(gauss) for i in range(n)], axis=1)
    slopes = np.stack([basis(i, [0, 1]).deriv()(gauss) for i in range(n)], axis=1)
    inverse = np.linalg.inv(at_lobatto)
    return Points(xi, at_gauss @ inverse, slopes @ inverse)


def row_at(n: int, xi: float) -> Array:
    """Weights (n,) that interpolate values at the Lobatto points to xi on [0, 1]."""
    basis = np.polynomial.chebyshev.Chebyshev.basis
    at_lobatto = np.stack([basis(i, [0, 1])(points(n).xi) for i in range(n)], axis=1)
    return np.array([basis(i, [0, 1])(xi) for i in range(n)]) @ np.linalg.inv(at_lobatto)
