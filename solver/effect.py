"""What an effect is: a physical term that a network may hold or lack, and the hooks by which it enters the equations.

The effects themselves are in :mod:`solver.effects`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .quantity import Quantity, quantities
from .wall import Wall

if TYPE_CHECKING:
    from .network import Network

Array = np.ndarray
Values = Mapping[str, Array]

ALL_PLACES = "all"


@dataclass(frozen=True)
class Points:
    """The flow points of a mesh, arrays that broadcast to (B, n_e, N+1).

    x : x/L of each point; centre : x/L of the middle of its element; R0 [m]; L [m]; nu [m²/s].
    """

    x: Array
    centre: Array
    R0: Array
    L: Array
    nu: Array


@dataclass(frozen=True)
class Drag:
    """A force per mass f(U) = quadratic U|U| + Σ weight_i y_i [m/s²] with memory dy_i/dt = -rate_i y_i + dU/dt.

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


class Effect:
    """A row of the catalogue.

    owner : what its numbers belong to: segment, fluid, outlet, junction or channel. places : where it may act, "all"
    being every owner at once. quantities : its numbers by key. neutral : the values that switch it off.
    signature, confusable, separator : what it does to records, what does nearly the same, and what tells them apart.
    at_rest : whether it moves the radius under a steady pressure. cuts : x/L where elements must end.
    terms : numbers of its own; field_of : or the class of :mod:`solver.network` and its fields that hold them.
    """

    name: ClassVar[str]
    equation: ClassVar[str]
    owner: ClassVar[str]
    places: ClassVar[tuple[str, ...]]
    neutral: ClassVar[Mapping[str, float]]
    signature: ClassVar[str]
    confusable: ClassVar[tuple[str, ...]]
    separator: ClassVar[str]
    at_rest: ClassVar[bool] = False
    cuts: ClassVar[tuple[float, ...]] = ()
    terms: ClassVar[Mapping[str, Quantity]] = {}
    field_of: ClassVar[tuple[str, tuple[str, ...]] | None] = None

    @cached_property
    def quantities(self) -> Mapping[str, Quantity]:
        """Unit, range and description of its numbers, by key."""
        if self.field_of is None:
            return self.terms
        from . import network  # which imports this module

        kind, keys = self.field_of
        return {key: quantities(getattr(network, kind))[key] for key in keys}

    # --- places -------------------------------------------------------------------------------------------------

    def where(self, network: Network, channels: Sequence[str] = ()) -> tuple[str, ...]:
        """All places where it can act; ``channels`` names the outputs that are measured, for effects of channels."""
        targets = self._targets(network, channels)
        everywhere = (ALL_PLACES,) if ALL_PLACES in self.places and targets else ()
        return everywhere + (targets if set(self.places) - {ALL_PLACES} else ())

    def variables(self, network: Network, place: str) -> dict[str, tuple[str, ...]]:
        """The variable names that each of its numbers moves at a place. Raises ValueError where it cannot act."""
        targets = self._targets(network, (place,))
        if place not in self.where(network, (place,)) and not (self.owner == "fluid" and place == "fluid"):
            allowed = ", ".join(self.where(network)) or "no place in this network"
            raise ValueError(f"{self.name}: it cannot act at {place!r} in network {network.name}; use {allowed}.")
        names = targets if place in (ALL_PLACES, "fluid") else (place,)
        suffix = f".{self.owner}" if self.owner in ("outlet", "junction") else ""
        return {key: tuple(f"{name}{suffix}.{key}" for name in names) for key in self.quantities}

    def add(self, network: Network, place: str, values: Mapping[str, float]) -> Network:
        """The network with this effect at a place; ``values`` in SI by key. Raises ValueError if it is not allowed."""
        names = self.variables(network, place)
        check_known(self.name, values, names)
        return network.with_terms({name: value for key, value in values.items() for name in names[key]})

    def _targets(self, network: Network, channels: Sequence[str]) -> tuple[str, ...]:
        if self.owner == "fluid":
            return ("fluid",)
        if self.owner == "channel":
            return tuple(name for name in channels if name in network.channel_names())
        kinds: dict[str, tuple[Any, ...]] = {
            "segment": network.segments,
            "outlet": network.outlets,
            "junction": network.junctions,
        }
        owners = kinds[self.owner]
        return tuple(owner.segment if self.owner == "outlet" else owner.name for owner in owners if self.acts_on(owner))

    def acts_on(self, owner: Any) -> bool:
        """Whether it makes sense at this segment, outlet or junction."""
        return True

    # --- how it enters the equations ----------------------------------------------------------------------------

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        """The walls at points x : (n,) = x/L with this effect; ``values`` : (B, n)."""
        return wall

    def friction(self, C_f: Array, values: Values) -> Array:
        """The friction coefficient C_f : (B, 1) [m²/s] with this effect; ``values`` : (B, 1)."""
        return C_f

    def drag(self, values: Values, points: Points) -> Drag | None:
        """The further force on the flow; ``values`` : (B, n_e, 1), or (B, 1, 1) of the fluid."""
        return None

    def observe(self, values: Values, X: Array, omega: Array) -> Array:
        """Fourier coefficients X : (..., n) of a channel at omega : (n,) as the sensor shows them."""
        return X


def check_known(where: str, keys: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Raise ValueError for the first key that is not known."""
    for key in keys:
        if key not in known:
            raise ValueError(f"{where}: unknown key {key!r}; use one of {', '.join(known)}.")
