"""Tables of sources: terms with known amplitudes g(t) in the equations of a network, at every moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np

from ..network.description import Network
from ..network.table_source import TableSource
from .mesh import Mesh
from .sources import Source, made_of, shown

Array = np.ndarray

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
