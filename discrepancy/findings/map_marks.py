"""Where effects act in the network: the vessels, outlets, junctions and channels to mark on a map."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

from solver.laws import effects
from solver.laws.effect import Effect
from solver.quantities.legible import DASH

from .outcome import Outcome


@dataclass(frozen=True)
class Mark:
    """A place to mark.

    kind : "segment", "outlet", "junction" or "channel". place : a name of that kind (the site of a channel) or "all".
    named : by the verdict; otherwise only in its class.
    """

    kind: str
    place: str
    named: bool
    text: str

    def is_at(self, kind: str, place: str) -> bool:
        """True if this mark is at a place."""
        return self.kind == kind and self.place in (place, "all")


def marks(outcome: Outcome) -> list[Mark]:
    """Every place of the verdict's effects, and of the others in its class."""
    kinds = {"fluid": "segment"}  # effects of the fluid act in segments
    found = [(effect.name, effect.where) for effect in outcome.effects]
    named = found if outcome.verdict in ("effect", "several", "partial") else []
    return [
        Mark(
            kinds.get(owner := entry(name).owner, owner),
            site_of(place),
            (name, where) in named,
            effect_text(name, (place,)),
        )
        for name, where in dict.fromkeys((*named, *chain.from_iterable(outcome.members), *found))
        for place in where
    ]


def entry(name: str) -> Effect:
    """The effect of the catalogue with this name."""
    return effects.BY_NAME[name]


def of_sensor(name: str) -> bool:
    """True if the effect belongs to a measurement chain, not to the arteries."""
    return entry(name).owner == "channel"


def plain(name: str) -> str:
    """ "wall_viscosity" in words."""
    return name.replace("_", " ")


def places_text(where: Iterable[str]) -> str:
    """Places in words."""
    return ", ".join("all places" if place == "all" else place for place in where) or DASH


def effect_text(name: str, where: Iterable[str]) -> str:
    """An effect at its places in words."""
    return f"{plain(name)} at {places_text(where)}"


def label_text(label: str) -> str:
    """ "wall_viscosity at CA" in words, or several joined by a plus; names of places are unchanged."""
    found = (each.partition(" at ") for each in label.split(" + "))
    return " + ".join(plain(name) + (f" at {places_text([place])}" if at else "") for name, at, place in found)


def site_of(place: str) -> str:
    """The site of a channel; any other place unchanged."""
    return place.rpartition(".")[0] or place
