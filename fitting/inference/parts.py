"""Hypotheses of where along its segment: effects of a part, wherever that lies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from solver.network import Network

from .terms import Term, effect_of, searched

_LONGER = 3.0  # times the usual length, from which a part is looked for, too: it is no short one moved a little


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
    lengths = [tuple(times * c.nominal for c in missing) for times in (1.0, _LONGER)]
    values = lengths if term.moves_along else effect.search.starts_along
    along = missing[: len(values[0])]
    starts = [(*x, *((v - c.nominal) / c.size for v, c in zip(each, along, strict=True))) for each in values]
    return replace(term, unknowns=(*term.unknowns, *(searched(effect, c) for c in along)), starts=tuple(starts))
