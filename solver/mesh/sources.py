"""Sources: unknown terms that are added to the equations of a network at one place, each with an amplitude g(t).

    ∂A/∂t + ∂Q/∂x = -q(x) g                                 an outflow
    ρ/A (∂Q/∂t + C_f Q/A) + ∂/∂x (P + …) + … = -d(x) g      a drop of pressure
    P = … + P_n(2x/L - 1) g                                 a further pressure of the wall

Physics that a model lacks acts as such terms somewhere. A source makes no assumption about the physics: its amplitude
is an arbitrary periodic function of time, harmonic by harmonic. Each kind is one class, which knows its possible places
in a network; an effect or outlet names the kind that represents it (:class:`~solver.laws.effect.Effect`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.polynomial import legendre

from ..laws.effect import Described
from ..network.description import Network
from ..network.table_source import TableSource
from .element import lagrange
from .mesh import Mesh

Array = np.ndarray

_GAUSS = legendre.leggauss(6)  # of the overlap of an element and an interval: exact for elements of degree 11


class Meshed(Protocol):
    """The interface of a model that sources use."""

    @property
    def network(self) -> Described: ...
    @property
    def mesh(self) -> Mesh: ...


@dataclass(frozen=True)
class Source:
    """One source of unit amplitude. place : its segment, or that of its outlet. unit : of the amplitude."""

    place: str

    unit: ClassVar[str]

    def momentum(self, model: Meshed) -> Array | None:
        """Its contribution to the momentum residual, (n_e, N+1) [Pa]; None if it has none."""
        return None

    def nodes(self, model: Meshed) -> Array | None:
        """Its contribution to ΣQ at the nodes, (n_nodes,) [m³/s]; None if it has none."""
        return None

    def inlets(self, model: Meshed) -> Array | None:
        """Its contribution to the flows that drive the inlets, (n_inlets,) [m³/s]; None if it has none."""
        return None

    def shown(self, network: Described) -> Mapping[str, float]:
        """Its direct contribution to outputs, in addition to its influence through A, Q and H."""
        return {}


@dataclass(frozen=True)
class WallPressure(Source):
    """A wall pressure P_n(2x/L - 1) g in addition to the wall law; P_n : the Legendre polynomial of a degree."""

    degree: int = 0

    unit = "Pa"

    def shape(self, x: Array) -> Array:
        """P_n at x/L."""
        return legendre.legval(2.0 * x - 1.0, np.eye(self.degree + 1)[self.degree])

    def momentum(self, model: Meshed) -> Array:
        mesh, found = model.mesh, _nothing(model)
        e = _elements(model, self.place)
        found[e] = self.shape(mesh.positions(mesh.element.x_gauss)[e]) @ mesh.element.minus_d_test
        return found

    def shown(self, network: Described) -> Mapping[str, float]:
        own = [site for site in network.sites if site.segment == self.place]
        return {f"{site.name}.P": float(self.shape(np.array(site.position))) for site in own}


@dataclass(frozen=True)
class Drop(Source):
    """A pressure drop g over an interval [start, end] of x/L."""

    start: float = 0.0
    end: float = 1.0

    unit = "Pa"

    def momentum(self, model: Meshed) -> Array:
        mesh, found = model.mesh, _nothing(model)
        for e in _elements(model, self.place):
            a, b = max(mesh.left[e], self.start), min(mesh.left[e] + 1.0 / mesh.parts[e], self.end)
            if b > a:
                x = 0.5 * (a + b) + 0.5 * (b - a) * _GAUSS[0]
                at = lagrange(mesh.element.x_lobatto, 2.0 * (x - mesh.left[e]) * mesh.parts[e] - 1.0)
                found[e] = (0.5 * (b - a) / (self.end - self.start) * _GAUSS[1]) @ at
        return found


@dataclass(frozen=True)
class Step(Source):
    """A pressure drop g between an end of a segment, 0 or 1 of x/L, and the node there."""

    end: int = 1

    unit = "Pa"

    def momentum(self, model: Meshed) -> Array:
        found = _nothing(model)
        found[_elements(model, self.place)[-self.end], -self.end] = 1.0
        return found


@dataclass(frozen=True)
class Outflow(Source):
    """A flow g that leaves a segment, uniformly along it: at the ends of its elements, by the trapezoidal rule."""

    unit = "m^3/s"

    def nodes(self, model: Meshed) -> Array:
        mesh: Mesh = model.mesh
        found = np.zeros(mesh.n_nodes)
        for e in _elements(model, self.place):
            found[mesh.ends[e]] -= 0.5 / mesh.parts[e]
        return found


@dataclass(frozen=True)
class OutletFlow(Source):
    """A flow g that leaves the end of a segment in addition to the flow through its outlet."""

    unit = "m^3/s"

    def nodes(self, model: Meshed) -> Array:
        mesh, found = model.mesh, np.zeros(model.mesh.n_nodes)
        i = [outlet.segment for outlet in model.network.outlets].index(self.place)
        found[np.arange(mesh.n_nodes)[mesh.topology.outlets][i]] = -1.0
        return found


@dataclass(frozen=True)
class InletFlow(Source):
    """A flow g that enters at the first inlet in addition to the given one; place : the segment there."""

    unit = "m^3/s"

    def inlets(self, model: Meshed) -> Array:
        return np.eye(len(model.network.inlets))[0]


ALL: tuple[type[Source], ...] = (WallPressure, Drop, Step, Outflow, OutletFlow, InletFlow)


BY_KIND: Mapping[str, type[Source]] = {
    "wall": WallPressure,
    "drop": Drop,
    "step": Step,
    "outflow": Outflow,
    "outlet": OutletFlow,
}  # as a network file names them


def made_of(table: TableSource) -> Source:
    """The source of unit amplitude of a table."""
    numbers = {key: int(x) if key in ("degree",) or table.kind == "step" else x for key, x in table.how.items()}
    return BY_KIND[table.kind](table.segment, **numbers)


def _nothing(model: Meshed) -> Array:
    return np.zeros((model.mesh.n_elements, model.mesh.element.N + 1))


def _elements(model: Meshed, segment: str) -> Array:
    """The elements of a segment."""
    s = [each.name for each in model.network.segments].index(segment)
    return np.arange(model.mesh.first[s], model.mesh.first[s] + model.mesh.count[s])


class Forcing(NamedTuple):
    """The total contribution of some sources, by harmonic; 0.0 where no source contributes.

    momentum : (K+1, B, n_e, N+1) [Pa]. nodes : (K+1, B, n_nodes) and inlets : (K+1, B, n_inlets) [m³/s].
    """

    momentum: Array | float
    nodes: Array | float
    inlets: Array | float

    @staticmethod
    def of(model: Meshed, sources: Sequence[Source], amplitudes: Array, n: int) -> Forcing:
        """For amplitudes g : (K+1, n_sources) or (K+1, B, n_sources) by harmonic, padded with 0 to n harmonics."""
        g = np.asarray(amplitudes, complex)
        g = g[:, None] if g.ndim == 2 else g
        g = np.concatenate([g[:n], np.zeros((max(0, n - len(g)), *g.shape[1:]))])
        g[0] = g[0].real
        return Forcing(
            *(
                sum((np.multiply.outer(g[..., i], x) for i, x in enumerate(parts) if x is not None), start=0.0)
                for parts in ([s.momentum(model) for s in sources], [s.nodes(model) for s in sources],
                              [s.inlets(model) for s in sources])
            )
        )  # fmt: skip

    def part(self, harmonics: slice, members: slice) -> Forcing:
        """The contribution for some harmonics and, if they differ, some members of a batch."""

        def of(x: Array | float) -> Array | float:
            if not isinstance(x, np.ndarray):
                return x
            return x[harmonics, members] if x.shape[1] > 1 else x[harmonics]

        return Forcing(*map(of, self))


NO_FORCING = Forcing(0.0, 0.0, 0.0)


def shown(network: Described, names: Sequence[str], sources: Sequence[Source]) -> Array:
    """(n_sources, m) direct contribution of each source to the outputs with these names."""
    found = [source.shown(network) for source in sources]
    return np.array([[each.get(name, 0.0) for name in names] for each in found]).reshape(len(found), len(names))


_FINE = 4096  # samples of a beat for the harmonics of a table


class _Place(NamedTuple):
    """The model interface for sources."""

    network: Network
    mesh: Mesh


@dataclass(frozen=True)
class Tables:
    """momentum : (n_sources, n_e, N+1), nodes : (n_sources, n_nodes), for unit amplitude; shown : direct contributions
    to the network's outputs, (n_sources, n_outputs). inlets, outlets : their nodes. now : (n_sources,) amplitudes at
    the requested moment, if these are given instead of the time."""

    tables: tuple[TableSource, ...]
    momentum: Array
    nodes: Array
    shown: Array
    inlets: slice
    outlets: slice
    now: Array | None = field(default=None)

    MEMBER_AXIS: ClassVar[Mapping[str, int | None]] = dict.fromkeys(("momentum", "nodes", "shown"))  # no batch axis

    @staticmethod
    def of(network: Network, mesh: Mesh) -> Tables:
        """The tables of a network on its mesh."""
        each, place = [made_of(table) for table in network.sources], _Place(network, mesh)
        still, closed = np.zeros((mesh.n_elements, mesh.element.N + 1)), np.zeros(mesh.n_nodes)
        momentum, nodes = [s.momentum(place) for s in each], [s.nodes(place) for s in each]
        return Tables(
            network.sources,
            np.array([still if x is None else x for x in momentum]).reshape(len(each), *still.shape),
            np.array([closed if x is None else x for x in nodes]).reshape(len(each), *closed.shape),
            shown(network, tuple(network.output_units()), each),
            mesh.topology.inlets,
            mesh.topology.outlets,
        )

    def given(self, g: Array) -> Tables:
        """These with fixed amplitudes g : (n_sources,) instead of g(t)."""
        return replace(self, tables=(), now=g)

    def none(self) -> Tables:
        """No tables."""
        return replace(self, tables=(), momentum=self.momentum[:0], nodes=self.nodes[:0], shown=self.shown[:0])

    def at(self, times: Array) -> Sequence[Array | None]:
        """g : (n_sources,) at each of some times [s]; None without tables."""
        return list(self._values(times)) if len(self.nodes) else [None] * len(times)

    def beside(
        self, sources: Sequence[Source], g: Array | None, T: float, n: int, t: float = 0.0
    ) -> tuple[Sequence[Source], Array]:
        """The given sources and these; with their n harmonics in beats of T [s] from time t [s] on.

        Raises ValueError for a table with another period.
        """
        if not self.tables:
            return sources, np.zeros((1, 0)) if g is None else g
        for table in self.tables:
            table.check_repeats(T)
        own = np.fft.rfft(self._values(t + T / _FINE * np.arange(_FINE)), axis=0, norm="forward")[:n]
        given = np.zeros((n, len(sources)), complex)
        if g is not None:
            given[: len(g)] = g[:n]
        return (*sources, *map(made_of, self.tables)), np.concatenate([given, own], axis=1)

    def add_to_momentum(self, R: Array, g: Array | None) -> None:
        """Add their contribution to the residual of momentum : (B, n_e, N+1) [Pa]."""
        if g is not None:
            R += (g @ self.momentum.reshape(len(g), -1)).reshape(self.momentum.shape[1:])

    def add_to_nodes(self, net: Array, scale: Array, g: Array | None) -> None:
        """Add their contribution to ΣQ at the nodes : (B, n_nodes) [m³/s]."""
        if g is not None:
            net += scale * (g @ self.nodes)

    def let_out(self, Q: Array, g: Array | None) -> Array:
        """The flows through the outlets, from flows Q : (B, n_outlets) [m³/s] at the ends of their segments."""
        return Q if g is None else Q + (g @ self.nodes)[self.outlets]

    def let_in(self, drive: Array, t: float) -> Array:
        """The flows through the inlets, from their drives : (n_inlets, B or 1), at time t [s]."""
        (g,) = self.at(np.array([t]))
        return drive if g is None else drive + (g @ self.nodes)[self.inlets, None]

    def add_to_outputs(self, result: Array, t: float) -> None:
        """Add their direct contributions at time t [s] to outputs : (B, n_outputs)."""
        (g,) = self.at(np.array([t]))
        if g is not None:
            result += g @ self.shown

    def _values(self, times: Array) -> Array:
        if self.now is not None:
            return self.now[None]
        return np.stack([s.curve.at(times / s.curve.period) for s in self.tables], axis=-1)
