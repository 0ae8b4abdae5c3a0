"""Base class of effects: a physical term that a network has or lacks, with all its own facts, and the hooks by which it
enters the equations.

The effects themselves are in :mod:`solver.laws.effects`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from ..errors import InputError
from ..quantities.coordinate import SCALE, SHIFT, Coordinate, allowed
from ..quantities.quantity import Quantity
from ..quantities.text import check_keys
from .wall import Wall

Array = np.ndarray
Values = Mapping[str, Array]
Anatomy = TypeVar("Anatomy", bound="Described")

ALL_PLACES = "all"
# the source in the equations that represents an effect (:mod:`~solver.mesh.sources`)
KINDS = WALL, DROP, OUTFLOW, OUTLET, JUNCTION, CHANNEL = "wall", "drop", "outflow", "outlet", "junction", "channel"
_SOURCES = {"segment": WALL, "fluid": DROP, "outlet": OUTLET, "junction": JUNCTION, "channel": CHANNEL}
_NEAR = 1e-9  # of an element: ends that agree with its own
_SUFFIX = {"outlet": ".outlet", "junction": ".junction"}  # of an owner's variables


class Described(Protocol):
    """The interface of a :class:`solver.network.description.Network` that effects and checks use."""

    @property
    def name(self) -> str: ...
    @property
    def segments(self) -> tuple[Any, ...]: ...
    @property
    def junctions(self) -> tuple[Any, ...]: ...
    @property
    def outlets(self) -> tuple[Any, ...]: ...
    @property
    def sites(self) -> tuple[Any, ...]: ...
    @property
    def channels(self) -> tuple[Any, ...]: ...
    @property
    def inlet(self) -> Any: ...
    @property
    def inlets(self) -> tuple[Any, ...]: ...
    @property
    def fluid(self) -> Any: ...
    @property
    def eta(self) -> float: ...
    @property
    def elastic_law(self) -> str: ...
    @property
    def viscous_law(self) -> str: ...
    def owners(self) -> Iterator[tuple[str, Any]]: ...
    def parameters(self) -> dict[str, float]: ...
    def parameter_quantities(self) -> dict[str, Quantity]: ...
    def channel_names(self) -> tuple[str, ...]: ...
    def segment(self, name: str) -> Any: ...
    def with_terms(self: Anatomy, values: Mapping[str, float]) -> Anatomy: ...
    def with_outlet(self: Anatomy, outlet: Any) -> Anatomy: ...


@dataclass(frozen=True)
class Points:
    """The flow points of a mesh, arrays that broadcast to (B, n_e, N+1).

    x : x/L of each point; left, right : x/L of the ends of its element; R0 [m]; L [m]; nu [m²/s].
    integral : (N+1, N+2) coefficients of ∫ from -1 to ξ of every point's polynomial, over its weight: the share of a
    point that belongs to a part of the element.
    """

    x: Array
    left: Array
    right: Array
    R0: Array
    L: Array
    nu: Array
    integral: Array

    def part(self, start: Array, end: Array) -> Array:
        """The share of every point that lies between two x/L, by the integral of its polynomial: 1 well inside, 0
        outside."""
        ends = (np.clip(2.0 * (x - self.left) / (self.right - self.left) - 1.0, -1.0, 1.0) for x in (start, end))
        a, b = (np.where(np.abs(xi) > 1.0 - _NEAR, np.sign(xi), xi) for xi in ends)
        powers = np.arange(self.integral.shape[1])
        found = (b[..., None] ** powers - a[..., None] ** powers) @ self.integral.T
        return np.where(b - a == 2.0, 1.0, found[..., 0, :])


@dataclass(frozen=True)
class Drag:
    """A force per mass f(U) = quadratic U|U| + Σ weight_i y_i [m/s²] with memory dy_i/dt = -rate_i y_i + dU/dt.

    U = Q/A [m/s]. With rate_i = 0, y_i = U: a force that is linear in the velocity.
    quadratic : (B, n_e, N+1) [1/m]. weight, rate : (m, B, n_e, N+1) [1/s]; m may be 0.
    """

    quadratic: Array
    weight: Array
    rate: Array

    def __add__(self, other: Drag) -> Drag:
        return Drag(
            self.quadratic + other.quadratic,
            np.concatenate([self.weight, other.weight]),
            np.concatenate([self.rate, other.rate]),
        )


@dataclass(frozen=True)
class SearchSpec:
    """Settings of an effect that only a search needs: its typical size, start points, and identifiability.

    typical : size of x = 1 by key, in SI, or of the logarithm if the number is a factor; by default the nominal value
    of its quantity, or 1 for the logarithm. scales : its numbers are factors. relative : keys that are expressed,
    typical size included, relative to another key of the owner, with the unit of the ratio.
    starts : start points x, (n,) each, beside 0. starts_along : start values, (m,) each, of the first m of
    :meth:`Effect.coordinates_along` for a search for its position along a segment; the remaining ones become free only
    if these do not suffice.
    local : the pressure and radius of one wall reveal it. source : the kind of source in the equations that represents
    it in a model that lacks it; "" stands for that of its owner.

    Raises InputError for a size that is not above 0, starts that are not finite or differ in length, and an unknown
    source.
    """

    typical: Mapping[str, float] = field(default_factory=dict)
    scales: bool = False
    relative: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    starts: tuple[tuple[float, ...], ...] = ()
    starts_along: tuple[tuple[float, ...], ...] = ()
    local: bool = False
    source: str = ""

    def __post_init__(self) -> None:
        for key, size in self.typical.items():
            if not 0.0 < size < math.inf:
                raise InputError(f"SearchSpec: typical size {size:g} of {key}; give a finite one above 0.")
        for name, points in (("starts", self.starts), ("starts_along", self.starts_along)):
            if len({len(point) for point in points}) > 1 or not np.isfinite([x for p in points for x in p]).all():
                raise InputError(f"SearchSpec: {name} {points}; give finite points of one length.")
        if self.source and self.source not in KINDS:
            raise InputError(f"SearchSpec: source {self.source!r}; use one of {', '.join(KINDS)}.")


class Effect:
    """A row of the catalogue.

    owner : the kind of object its numbers belong to: segment, fluid, outlet, junction or channel. places : where it may
    act; "all" means every owner at once. terms : its numbers by key. always : every owner has them as fields; otherwise
    only owners that were given them have them. neutral : the values that switch it off. how : keys that modify an
    active effect without switching it; an owner without them uses their neutral values. along : those of these keys
    that give the position along a segment.
    signature, confusable, separator : its signature in records, effects with a similar one, and the measurement that
    distinguishes them.
    cuts : x/L where elements must end.
    at_ends : numbers of its owner that may be given at both ends, with the term for their relative difference.
    needs : a key of its owner that must be above 0 for it to act. rewires : it replaces the outlet condition.
    remembers : it adds states to the solution, which a batch then carries for all of its members. search : settings of
    a search for it. library : the keys of its terms, if its form is learned from a record: no search uses it directly,
    but a learned law combines some of them (:meth:`learned`), valid in :meth:`valid`.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    owner: ClassVar[str]
    places: ClassVar[tuple[str, ...]]
    terms: ClassVar[Mapping[str, Quantity]]
    neutral: ClassVar[Mapping[str, float]]
    how: ClassVar[tuple[str, ...]] = ()
    along: ClassVar[tuple[str, ...]] = ()
    signature: ClassVar[str]
    confusable: ClassVar[tuple[str, ...]]
    separator: ClassVar[str]
    always: ClassVar[bool] = False
    cuts: ClassVar[tuple[float, ...]] = ()
    at_ends: ClassVar[Mapping[str, str]] = {}
    needs: ClassVar[str | None] = None
    rewires: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    search: ClassVar[SearchSpec] = SearchSpec()
    library: ClassVar[tuple[str, ...]] = ()

    @property
    def switches(self) -> tuple[str, ...]:
        """The keys that switch it on where they are not neutral."""
        return tuple(key for key in self.neutral if key not in (*self.how, *self.along))

    # --- places -------------------------------------------------------------------------------------------------

    def where(self, network: Described, channels: Sequence[str] = ()) -> tuple[str, ...]:
        """All places where it can act; ``channels`` names the measured outputs, for effects of channels."""
        targets = self._targets(network, channels)
        everywhere = (ALL_PLACES,) if ALL_PLACES in self.places and targets else ()
        return everywhere + (targets if set(self.places) - {ALL_PLACES} else ())

    def variables(self, network: Described, place: str) -> dict[str, tuple[str, ...]]:
        """The variables that each of its numbers changes at a place. Raises ValueError where it cannot act."""
        targets = self._targets(network, (place,))
        if place not in self.where(network, (place,)) and not (self.owner == "fluid" and place == "fluid"):
            there = ", ".join(self.where(network)) or "no place in this network"
            raise InputError(f"{self.name}: it cannot act at {place!r} in network {network.name}; use {there}.")
        names = targets if place in (ALL_PLACES, "fluid") else (place,)
        return {key: tuple(f"{name}{_SUFFIX.get(self.owner, '')}.{key}" for name in names) for key in self.terms}

    def add(self, network: Anatomy, place: str, values: Mapping[str, float]) -> Anatomy:
        """The network with this effect at a place; ``values`` in SI by key. Raises ValueError if it is not allowed."""
        names = self.variables(network, place)
        check_keys(self.name, values, names)
        return network.with_terms({name: value for key, value in values.items() for name in names[key]})

    def _targets(self, network: Described, channels: Sequence[str]) -> tuple[str, ...]:
        if self.owner == "fluid":
            return ("fluid",)
        if self.owner == "channel":
            return tuple(name for name in channels if name in network.channel_names())
        owners = [(name, owner) for name, owner in network.owners() if owner.OWNER == self.owner]
        return tuple(name.removesuffix(f".{self.owner}") for name, owner in owners if self.acts_on(owner))

    def acts_on(self, owner: Any) -> bool:
        """Whether it can act at this segment, outlet or junction."""
        return self.needs is None or value_of(owner, self.needs) > 0.0

    def of_animal(self, network: Described, place: str) -> bool:
        """Whether it only means that this animal's artery differs from the network's: no discovery if all differ."""
        return False

    # --- search coordinates ---------------------------------------------------------------------------------------

    @property
    def source(self) -> str:
        """The kind of source in the equations that represents it in a model that lacks it."""
        return self.search.source or _SOURCES[self.owner]

    def coordinates(self, network: Described, place: str, bench: bool = False) -> tuple[Coordinate, ...]:
        """The unknowns of a search for it at a place, at its default position; none where it has nothing to act on.

        bench : only P and R of one wall are known.
        """
        if self.library:
            return ()
        variables = {key: names for key, names in self.variables(network, place).items() if key not in self.along}
        found = (self._coordinate(network, place, key, names) for key, names in variables.items())
        return tuple(coordinate for coordinate in found if coordinate is not None)

    def learned(self, network: Described, place: str, keys: Sequence[str]) -> tuple[Coordinate, ...]:
        """The unknowns of a search for a law that combines some terms of the library."""
        variables = self.variables(network, place)
        found = (self._coordinate(network, place, key, variables[key]) for key in keys)
        return tuple(coordinate for coordinate in found if coordinate is not None)

    def valid(self, strain: Array, rate: Array) -> dict[str, float]:
        """The numbers that bound the validity of a learned wall law, from observed strains [-] and rates [1/s]."""
        return {}

    def formula(self, keys: Sequence[str]) -> str:
        """The equation of a learned law that combines some terms of the library."""
        return self.equation

    def coordinates_along(self, network: Described, place: str) -> tuple[Coordinate, ...]:
        """The unknowns of a search for its position along a segment, beside :meth:`coordinates`."""
        return ()

    def step(self, network: Described, owner: Any, key: str) -> float:
        """Change of a shifted number of one owner, in SI, for x = 1: its typical size."""
        size, relative = self.search.typical.get(key, self.terms[key].nominal), self.search.relative
        return size * value_of(owner, relative[key][0]) if key in relative else size

    def scaled(self, key: str, values: Sequence[float]) -> float | None:
        """Change of the logarithm for x = 1 if a number with these values is scaled, None if it is shifted."""
        return self.search.typical.get(key, 1.0) if self.search.scales and key not in self.along else None

    def _coordinate(self, network: Described, place: str, key: str, variables: Sequence[str]) -> Coordinate | None:
        if not variables:
            return None
        present, everywhere = network.parameters(), place == ALL_PLACES
        values = {v: present.get(v, self.neutral[key]) for v in variables}
        factor = self.scaled(key, tuple(values.values()))
        known = dict(network.owners())
        owners = [known[variable.removesuffix(f".{key}")] for variable in variables]
        kind = SHIFT if factor is None else SCALE
        steps = [self.step(network, owner, key) if factor is None else factor for owner in owners]
        moves = tuple(zip(variables, steps, strict=True))
        low, high = allowed(kind, moves, values, self.terms[key])
        first, size, unit, ratio = next(iter(values.values())), steps[0], self.terms[key].unit, None
        if everywhere and key in self.search.relative:
            ratio, unit = self.search.relative[key]
            if factor is None:
                size, first = self.search.typical.get(key, 1.0), first / value_of(owners[0], ratio)
            else:
                first = float(np.mean([value_of(owner, key) / value_of(owner, ratio) for owner in owners]))
        name = f"{ALL_PLACES}.{key}" if everywhere else variables[0]
        return Coordinate(name, kind, moves, low, high, unit, size, first, ratio)

    # --- how it enters the equations ------------------------------------------------------------------------------

    def cut_at(self, values: Values) -> tuple[float, ...]:
        """x/L at which the elements of one segment must end; ``values`` : (B,)."""
        return self.cuts

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        """The walls at points x : (n,) = x/L with this effect; ``values`` : (B, n)."""
        return wall

    def friction(self, C_f: Array, values: Values) -> Array:
        """The friction coefficient C_f : (B, 1) [m²/s] with this effect; ``values`` : (B, 1)."""
        return C_f

    def convection(self, alpha: Array, values: Values) -> Array:
        """The convective coefficient α : (B, 1) with this effect; ``values`` : (B, 1)."""
        return alpha

    def drag(self, values: Values, points: Points) -> Drag | None:
        """The further force on the flow; ``values`` : (B, n_e, 1), or (B, 1, 1) of the fluid."""
        return None

    def outlet(self, numbers: Values, values: Values) -> Values:
        """The numbers of outlets of one kind, by key, (B, n), with this effect; ``values`` : (B, n)."""
        return numbers

    def outflow(self, P: Array, values: Values) -> tuple[Array, Array]:
        """A further flow [m³/s] through outlets under P : (B, n) [Pa] above P_venous, and its derivative; of outlets
        that store no pressure. ``values`` : (B, n)."""
        return 0.0 * P, 0.0 * P

    def junction(self, numbers: Values, values: Values) -> Values:
        """The numbers of the junctions, by key, (B, n), with this effect; ``values`` : (B, n)."""
        return numbers


def value_of(owner: Any, key: str, otherwise: float = 0.0) -> Any:
    """A number of an object of the network, a term or a field; ``otherwise`` if it has none."""
    terms = getattr(owner, "terms", {})
    return terms[key] if key in terms else getattr(owner, key, otherwise)


def small_wave_impedance(network: Described, segment: Any) -> float:
    """Z = ρ c/A0 [Pa·s/m³] of a segment's small elastic waves at P_ref, c² = E h/(2 (1-η²) ρ R0)."""
    rho = network.fluid.rho
    c = math.sqrt(segment.E * segment.h / (1.0 - network.eta**2) / segment.R0 / 2.0 / rho)
    return float(rho * c / (math.pi * segment.R0**2))
