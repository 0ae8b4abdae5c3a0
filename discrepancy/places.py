"""Where in the network an effect acts: which vessel, outlet, junction or channel to mark."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .outcome import Outcome


@dataclass(frozen=True)
class Mark:
    """A place to mark.

    kind : "segment", "outlet", "junction" or "channel". place : a name of that kind (of a channel: its site) or "all".
    named : by the verdict, or only in its class.
    """

    kind: str
    place: str
    named: bool
    text: str

    def is_at(self, kind: str, place: str) -> bool:
        """Whether this mark stands at a place."""
        return self.kind == kind and self.place in (place, "all")


def marks(outcome: Outcome) -> list[Mark]:
    """Every place of the verdict's effects, and of the others in its class."""
    variables = {(c.name, c.where): tuple(c.parameters) for c in outcome.candidates}
    variables |= {(e.name, e.where): tuple(e.parameters) for e in outcome.effects}
    surely = outcome.verdict in ("effect", "several")
    named = [(effect.name, effect.where) for effect in outcome.effects] if surely else []
    others = [
        member for member in (*outcome.members, *((e.name, e.where) for e in outcome.effects)) if member not in named
    ]
    return [
        Mark(
            kind_of(place, variables.get(key, ())),
            _site(place),
            key in named,
            f"{plain(key[0])} at {place_text(place)}",
        )
        for key in dict.fromkeys((*named, *others))
        for place in key[1]
    ]


def kind_of(place: str, variables: Iterable[str]) -> str:
    """The kind of a place, by the variables that an effect moves there: ``CA.outlet.R_t``, ``AA.junction.k`` …"""
    if "." in place:
        return "channel"
    for kind in ("outlet", "junction"):
        if any(kind in variable.split(".") for variable in variables):
            return kind
    return "segment"


def plain(name: str) -> str:
    """ "wall_viscosity" as people write it."""
    return name.replace("_", " ")


def place_text(place: str) -> str:
    """A place in words."""
    return "all places" if place == "all" else place


def _site(place: str) -> str:
    return place.rpartition(".")[0] or place
