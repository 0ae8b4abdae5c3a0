"""Two effects together on a bench, where a refit costs a tenth of a second: every two of the catalogue are tried.

What two effects are is not seen from the best single one: a lag beside a slow catheter is another catheter from afar,
and a relaxation is nothing where its search begins, until the lag is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from fitting.inference.added import extended
from fitting.inference.fit import Fit
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, followers, joins

from . import thresholds as at
from .compare import Compared
from .weigh import Named, names_of


def coupled(found: Compared, runs: Runs) -> Iterator[Compared]:
    """With every two effects, searched from nothing, and then again those that are near the best, or share one with it,
    from either of the two alone."""
    alone = {n.fit.terms[0]: n.fit for n in found.ranked if len(n.fit.terms) == 1}
    couples = [(a, b) for a, b in combinations(found.terms, 2) if joins(b, (a,))]
    couples += [couple for fit in alone.values() for couple in _following(found, fit)]
    lowest = min(n.fit.cost for n in found.ranked)
    yield (found := _joined(found, found.problem.refit(couples, runs=runs, known=lowest)))
    best = found.best
    near = {n.key for n in found.ranked if n.score < best.score + at.NEAR}
    for term, fit in alone.items():
        shared = term in best.fit.terms
        mine = [c for c in couples if term in c and (shared or names_of(c) in near)]
        found = _joined(found, found.problem.refit(mine, fit, runs))
    yield found


def _following(found: Compared, fit: Fit) -> list[tuple[Term, Term]]:
    """An effect and each that can act only where it does."""
    network = extended(found.problem.network, fit)
    return [(fit.terms[0], after) for after in followers(network, found.problem.site, found.terms)]


def _joined(found: Compared, fits: list[Fit | None]) -> Compared:
    return found.joined_by([f for f in fits if f is not None])


def both_show(found: Compared, n: Named) -> bool:
    """Whether each of two effects shows beside the other: linear (:attr:`Named.visibility`), or on a bench by what the
    other alone leaves, d'² = cost(the other alone) - cost(both), which is more where valleys bend."""
    if n.visible or found.problem.site is None:
        return n.visible
    alone = {other.label: other.fit.cost for other in found.ranked if len(other.fit.terms) == 1}
    least = min(alone.get(t.label, -math.inf) for t in n.fit.terms)
    return least - n.fit.cost >= at.BESIDE**2
