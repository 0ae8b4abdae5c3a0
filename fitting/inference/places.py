"""Places of a network where physics may be missing: a wall, a stretch of a segment, a junction, an outlet, a sensor, an
outlier among the parameters. They follow from the network, from the facts of the effects, and from the record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from solver.laws import effects
from solver.laws.effect import ALL_PLACES, CHANNEL, DROP, JUNCTION, OUTFLOW, OUTLET, WALL
from solver.mesh.sources import Drop, InletFlow, Outflow, OutletFlow, Source, Step, WallPressure
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .unknown import Unknown

NUMBER = "number"
STRETCHES = (0.1, 0.3, 0.5, 0.7, 0.9)  # x/L of the middles of stretches of a segment
_HALF = 0.05  # of a segment, half a stretch
_SHAPES = (1.0, 0.5, 0.2)  # relative sizes of a uniform, a linear and a parabolic wall pressure along a segment


@dataclass(frozen=True)
class Place:
    """A place where missing physics may act.

    kind : of its sources, as effects name it (:attr:`solver.laws.effect.Effect.source`), or NUMBER. name : the segment,
    outlet, junction or channel, or "all". sources : of unit amplitude, with their sizes ``relative`` to one another.
    at : x/L of a stretch. channel : of an additional signal. unknown : the outlier.
    """

    kind: str
    name: str
    sources: tuple[Source, ...] = ()
    relative: tuple[float, ...] = ()
    at: float | None = None
    channel: str | None = None
    unknown: Unknown | None = None

    @property
    def label(self) -> str:
        """The place in a sentence."""
        if self.unknown is not None:
            return f"{self.name} itself"
        of = {WALL: "the wall of", DROP: "a drop of pressure in", OUTFLOW: "a loss of flow along",
              JUNCTION: "junction", OUTLET: "the outlet of", CHANNEL: "the sensor of"}[self.kind]  # fmt: skip
        if self.name == ALL_PLACES:
            return {WALL: "all walls", DROP: "drops of pressure in all segments", JUNCTION: "all junctions"}[self.kind]
        return f"{of} {self.name}" + (f" at x/L = {self.at:g}" if self.at is not None else "")

    @property
    def segment(self) -> str:
        """The segment of the place, or the one that ends there."""
        return self.name.partition(".")[0]

    @property
    def key(self) -> tuple[str, str, float | None]:
        """A key that identifies the place."""
        return self.kind, self.name, self.at

    @property
    def columns(self) -> int:
        """The number of signals of its sources."""
        return len(self.relative)


def places(network: Network, channels: Sequence[str], unknowns: Sequence[Unknown]) -> tuple[Place, ...]:
    """Every place of a record's network. channels : the measured ones. unknowns : those in groups may be outliers."""
    kinds = {effect.source for effect in effects.ALL} | {OUTLET}
    found = [place for kind, of in _OF_KIND.items() if kind in kinds for place in of(network)]
    if CHANNEL in kinds:
        found += [Place(CHANNEL, name, (), (1.0,), channel=name) for name in channels]
        found.append(Place(CHANNEL, INFLOW, (InletFlow(network.inlet.segment),), (1.0,)))
    found += [Place(NUMBER, u.variables[0], unknown=u) for u in unknowns if u.group and not u.stated]
    return tuple(found)


def _walls(network: Network) -> list[Place]:
    shapes = range(len(_SHAPES))
    each = [
        Place(WALL, s.name, tuple(WallPressure(s.name, degree) for degree in shapes), _SHAPES) for s in network.segments
    ]
    return _and_all(WALL, each)


def _drops(network: Network) -> list[Place]:
    found = [
        Place(DROP, s.name, (Drop(s.name, at - _HALF, at + _HALF),), (1.0,), at)
        for s in network.segments
        for at in STRETCHES
    ]
    found += [
        Place(DROP, s.name, (Drop(s.name, 0.0, 0.5), Drop(s.name, 0.5, 1.0)), (1.0, 1.0)) for s in network.segments
    ]
    whole = tuple(Drop(s.name) for s in network.segments)
    return [*found, Place(DROP, ALL_PLACES, whole, (1.0,) * len(whole))] if len(whole) > 1 else found


def _junctions(network: Network) -> list[Place]:
    found = []
    for j in network.junctions:
        steps = [Step(s, 1) for s in j.inflow] + [Step(s, 0) for s in j.outflow]
        steps = steps[1:] if len(steps) == 2 else steps  # at a junction of two segments, both drops are the same
        found.append(Place(JUNCTION, j.name, tuple(steps), (1.0,) * len(steps)))
    return _and_all(JUNCTION, found)


def _and_all(kind: str, each: list[Place]) -> list[Place]:
    """The places, and one more for all of a kind, with a common amplitude."""
    if len(each) < 2:
        return each
    sources, relative = (tuple(x for p in each for x in getattr(p, part)) for part in ("sources", "relative"))
    return [*each, Place(kind, ALL_PLACES, sources, relative)]


_OF_KIND: dict[str, Callable[[Network], list[Place]]] = {
    WALL: _walls,
    DROP: _drops,
    OUTFLOW: lambda network: [Place(OUTFLOW, s.name, (Outflow(s.name),), (1.0,)) for s in network.segments],
    JUNCTION: _junctions,
    OUTLET: lambda network: [Place(OUTLET, o.segment, (OutletFlow(o.segment),), (1.0,)) for o in network.outlets],
}
