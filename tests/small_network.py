"""The small network with something hidden in it."""

from __future__ import annotations

from forked import NETWORK

from fitting.inference.hypothesis import PlacedEffect, candidates

NAMES = ("A.P", "B.P", "B.Q", "C.P", "C.Q", "C.R")


def terms(*names: str) -> tuple[PlacedEffect, ...]:
    """Candidates of some effects, at all their places."""
    return tuple(t for t in candidates(NETWORK, NAMES) if t.effect in names)


def term(effect: str, place: str) -> PlacedEffect:
    return next(t for t in terms(effect) if t.place == place)
