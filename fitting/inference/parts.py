"""Hypotheses of where along its segment: effects of a part, wherever that lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from solver import effects
from solver.effect import ALL_PLACES
from solver.network import Network

from .terms import Term, effect_of, searched, term_at

_GROWN = (1.0, 3.0, 10.0)  # typical sizes, from which a search for where along a segment may begin


def placed(network: Network, term: Term, x: Sequence[float]) -> Term | None:
    """An effect of a part of a segment that may lie elsewhere along it, from the sizes x of the usual part; or one that
    may also have another length, from where it is.

    None where there is no such thing.
    """
    effect = effect_of(term)
    there = {u.name for u in term.unknowns}
    missing = [c for c in effect.coordinates_along(network, term.place) if c.name not in there]
    if not missing:
        return None
    values = (tuple(c.nominal for c in missing),) if term.moves_along else effect.starts_along
    along = missing[: len(values[0])]
    starts = [(*x, *((v - c.nominal) / c.size for v, c in zip(each, along, strict=True))) for each in values]
    return replace(term, unknowns=(*term.unknowns, *(searched(effect, c) for c in along)), starts=tuple(starts))


def anywhere(network: Network) -> tuple[Term, ...]:
    """Every effect of a part of a segment, in every segment, with its usual size wherever a search may begin."""
    found = []
    for effect in effects.ALL:
        for place in effect.where(network) if effect.along else ():
            term = None if place == ALL_PLACES else term_at(network, effect, place)
            found.append(None if term is None else placed(network, term, [1.0] * len(term.unknowns)))
    return tuple(term for term in found if term is not None)


def grown(term: Term) -> Term:
    """An effect of a part whose search may begin with other sizes, of either sign where that is allowed."""
    (size, *_), signs = term.unknowns, (1.0, -1.0)
    starts = [
        (sign * factor, *start[1:])
        for start in term.starts
        for factor in _GROWN
        for sign in signs
        if size.low <= sign * factor <= size.high
    ]
    return replace(term, starts=tuple(starts))


def beside_sites(network: Network, term: Term) -> tuple[Term, ...]:
    """A local effect in the middle of each stretch that sites divide its segment into, from where it may move.

    Of one upstream of a site the site feels all, of one about it a part: linearised, one may look like nothing known
    where the other does not. Nothing for a segment without site, whose middle is as good as another place.
    """
    sites = {site.position for site in network.sites if site.segment == term.place and 0.0 < site.position < 1.0}
    moved = placed(network, term, [0.0] * len(term.unknowns))
    if moved is None or not sites:
        return ()
    (position, *_), size = moved.unknowns[len(term.unknowns) :], len(term.unknowns)
    ends = sorted({0.0, *sites, 1.0})
    middles = [(0.5 * (a + b) - position.nominal) / position.size for a, b in pairwise(ends)]
    nearest = [min(moved.starts, key=lambda start: abs(start[size] - x)) for x in middles]
    return tuple(grown(replace(moved, starts=(start,))) for start in dict.fromkeys(nearest) if start[size] != 0.0)
