"""From a network to flat arrays: nodes, elements, sampling operators, coefficients.

The only file that knows indices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from . import effects
from .effect import Effect
from .element import Element, element, lagrange
from .network import Fluid, Network, Segment
from .outlets import Outlet, Reflection, Resistance, Windkessel
from .validation import check_parameters
from .wall import ELASTIC_LAWS, VISCOUS_LAWS, Wall

Array = np.ndarray
Parameters = Mapping[str, Any]

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
        return slice(self.n_nodes - len(self.outlet_segment), self.n_nodes)


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


# --- coefficients -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Term:
    """An effect that is on somewhere: its numbers, (B, n_segments), or (B, 1) if it belongs to the fluid."""

    effect: Effect
    values: Mapping[str, Array]

    def at(self, index: Array | slice) -> dict[str, Array]:
        """Its numbers at some of the segments."""
        return {key: value[:, index] for key, value in self.values.items()}

    @property
    def on(self) -> Array:
        """(n_segments,) where any member of the batch has it."""
        neutral = self.effect.neutral
        return np.any([np.any(value != neutral[key], axis=0) for key, value in self.values.items()], axis=0)


@dataclass(frozen=True)
class Coefficients:
    """The numbers of a network, or of a batch of them: leading axis B (1 when nothing is batched).

    L : (B, n_segments) [m]. base : the walls without further effects, arrays (B, n_segments). rho, nu, C_f, alpha,
    P_0 : (B, 1). k : (B, n_nodes) weight of the kinetic pressure that a node keeps (junctions only; 0 elsewhere).
    terms : the effects that are on.
    kappa : (B, n_outlets) (1 - R_t)/(1 + R_t), 0 where the outlet does not reflect. R1, C, R2 : (B, n_outlets); a
    plain resistance is R1 with C = ∞, a prescribed pressure R1 = 0. P_venous : (B, n_outlets) [Pa].
    reflects, stores : (n_outlets,) which outlets are reflections, and which Windkessels.
    """

    L: Array
    base: Wall
    terms: tuple[Term, ...]
    rho: Array
    nu: Array
    k: Array
    C_f: Array
    alpha: Array
    P_0: Array
    kappa: Array
    R1: Array
    C: Array
    R2: Array
    P_venous: Array
    reflects: Array
    stores: Array
    batched: bool

    @property
    def B(self) -> int:
        return self.L.shape[0]

    def wall_at(self, segment: Array, x: Array) -> Wall:
        """The walls at points x : (n,) = x/L of segments : (n,), arrays (B, n), with the effects that are on."""
        wall = self.base.at(segment)
        for term in self.terms:
            if term.effect.owner == "segment":
                wall = term.effect.wall(wall, term.at(segment), x)
        return wall

    @cached_property
    def wall(self) -> Wall:
        """The walls at the middles of the segments : (B, n_segments)."""
        n = self.L.shape[1]
        return self.wall_at(np.arange(n), np.full(n, 0.5))

    @property
    def cuts(self) -> tuple[tuple[float, ...], ...]:
        """x/L at which elements must end, for every segment."""
        wanted = [(term.effect.cuts, term.on) for term in self.terms if term.effect.cuts]
        n = self.L.shape[1]
        return tuple(tuple(sorted({x for cuts, on in wanted if on[s] for x in cuts})) for s in range(n))


def batch_size(parameters: Parameters) -> int | None:
    """Length of the parameters that are arrays, or None if all are scalars. Raises ValueError unless they agree."""
    sizes = {name: np.shape(value) for name, value in parameters.items() if np.ndim(value)}
    for name, shape in sizes.items():
        if len(shape) != 1 or shape[0] == 0 or shape != next(iter(sizes.values())):
            first = next(iter(sizes))
            raise ValueError(
                f"{name}: batch of shape {shape} does not fit {first} of shape {sizes[first]}; "
                "give scalars or one-dimensional arrays of one length."
            )
    return next(iter(sizes.values()))[0] if sizes else None


def coefficients(network: Network, parameters: Parameters | None = None, *, checked: bool = True) -> Coefficients:
    """The coefficients of a network with some parameters replaced by numbers or by arrays of B numbers.

    checked : whether the parameters must be allowed: then raises ValueError for an unknown name, a value out of range,
    or arrays of different lengths.
    """
    parameters = dict(parameters or {})
    if checked:
        check_parameters(network, parameters)
    size = batch_size(parameters)
    numbers = _Numbers(network, {**network.parameters(), **parameters}, size or 1)
    terms = _terms(numbers)
    R_t = numbers.outlets("R_t", Reflection, 1.0)
    return Coefficients(
        L=numbers.segments("L"),
        base=_walls(numbers),
        terms=terms,
        rho=numbers.single("fluid.rho"),
        nu=numbers.single("fluid.nu"),
        k=_kinetic(numbers),
        C_f=_friction(numbers, terms),
        alpha=numbers.single("fluid.alpha"),
        P_0=numbers.single("network.P_0"),
        kappa=(1.0 - R_t) / (1.0 + R_t),
        R1=numbers.outlets("R1", Windkessel, 0.0) + numbers.outlets("R", Resistance, 0.0),
        C=numbers.outlets("C", Windkessel, np.inf),
        R2=numbers.outlets("R2", Windkessel, np.inf),
        P_venous=numbers.outlets("P_venous", Outlet, 0.0),
        reflects=np.array([isinstance(o, Reflection) for o in network.outlets], bool),
        stores=np.array([isinstance(o, Windkessel) for o in network.outlets], bool),
        batched=size is not None,
    )


@dataclass(frozen=True)
class _Numbers:
    """The parameters of a network, by name, as arrays of ``size`` = B numbers."""

    network: Network
    values: Mapping[str, Any]
    size: int

    def column(self, name: str) -> Array:
        """(B,) values of one parameter."""
        return np.broadcast_to(np.asarray(self.values[name], float), (self.size,))

    def single(self, name: str) -> Array:
        """(B, 1) values of what belongs to the whole network."""
        return self.column(name)[:, None]

    def segments(self, key: str) -> Array:
        """(B, n_segments)."""
        return np.stack([self.column(f"{segment.name}.{key}") for segment in self.network.segments], axis=1)

    def outlets(self, key: str, kind: type[Outlet], otherwise: float) -> Array:
        """(B, n_outlets), ``otherwise`` at outlets of another kind."""
        other = np.full(self.size, otherwise)
        outlets = self.network.outlets
        return np.stack(
            [self.column(f"{o.segment}.outlet.{key}") if isinstance(o, kind) else other for o in outlets], axis=1
        )

    def holders(self, owner: str) -> list[tuple[str, Segment | Fluid]]:
        """What of the equations may hold terms, by name: the segments or the fluid."""
        if owner == "segment":
            return [(segment.name, segment) for segment in self.network.segments]
        return [("fluid", self.network.fluid)] if owner == "fluid" else []

    def term(self, effect: Effect, key: str) -> Array:
        """(B, n_segments) or (B, 1), neutral where a holder does not hold the term."""
        neutral = np.full(self.size, effect.neutral[key])
        holders = self.holders(effect.owner)
        return np.stack([self.column(f"{name}.{key}") if key in h.terms else neutral for name, h in holders], axis=1)


def _terms(numbers: _Numbers) -> tuple[Term, ...]:
    """The effects that are on somewhere, in the order of the catalogue."""
    held = [
        Term(effect, {key: numbers.term(effect, key) for key in effect.terms})
        for effect in effects.ALL
        if any(key in holder.terms for _, holder in numbers.holders(effect.owner) for key in effect.terms)
    ]
    return tuple(term for term in held if term.on.any())


def _walls(numbers: _Numbers) -> Wall:
    """The walls without further effects."""
    R0, E, ENL = (numbers.segments(key) for key in ("R0", "E", "ENL"))
    phi0, phiNL = numbers.segments("phi0"), numbers.segments("phiNL")
    plate = 1.0 - numbers.single("network.eta") ** 2
    h_over_R0 = numbers.segments("h") / R0
    return Wall(
        elastic=ELASTIC_LAWS[numbers.network.elastic_law],
        viscous=VISCOUS_LAWS[numbers.network.viscous_law],
        A0=np.pi * R0**2,
        K=E * h_over_R0 / plate,
        e=ENL / E,
        K_h=h_over_R0 / plate,
        phi0=phi0,
        r=np.divide(phiNL, phi0, out=np.zeros_like(phi0), where=phi0 > 0.0),
        P_ref=np.broadcast_to(numbers.single("network.P_ref"), phi0.shape),
        rho=np.broadcast_to(numbers.single("fluid.rho"), phi0.shape),
        nonlinear=bool(np.any(phiNL != 0.0)),
        bent=bool(np.any(ENL != 0.0)),
    )


def _friction(numbers: _Numbers, terms: tuple[Term, ...]) -> Array:
    """C_f = friction π ν : (B, 1) [m²/s] with the effects of the fluid that are on."""
    C_f = numbers.single("fluid.friction") * np.pi * numbers.single("fluid.nu")
    for term in terms:
        if term.effect.owner == "fluid":
            C_f = term.effect.friction(C_f, term.values)
    return C_f


def _kinetic(numbers: _Numbers) -> Array:
    """(B, n_nodes) weight k of the kinetic pressure."""
    k = np.zeros((numbers.size, topology(numbers.network).n_nodes))
    for node, junction in enumerate(numbers.network.junctions, start=1):
        k[:, node] = numbers.column(f"{junction.name}.junction.k")
    return k


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

    @property
    def inlet_element(self) -> int:
        """The element that starts at the inlet."""
        return int(np.flatnonzero(self.ends[:, 0] == 0)[0])

    @property
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
