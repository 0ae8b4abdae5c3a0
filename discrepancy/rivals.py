"""Rivals of the best hypothesis: other laws, of any place, in the stead of each of its laws.

The laws that were compared so far are those of the places of the source map. Other laws may explain the record as well:
few sensors see an external pressure of one artery as one of its neighbour, and a law that is more flexible takes up
what another one beside it does while that one is missing. A single name needs all of these refitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Fit, Member
from fitting.inference.network import NetworkProblem
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, joins

from . import thresholds as at
from .law_starts import TYPICAL, Base, Begun, nearest
from .scoring import Compared, names_of, there

Array = np.ndarray

_NEARLY = 2.0  # times the reach of the second look, of the first


def with_rivals(result: Compared, runs: Runs) -> Compared:
    """With the laws refitted that promise to explain the record in the stead of one of the best hypothesis."""
    best = min(result.every, key=lambda n: n.score).fit  # even one that is never named, as no sensor can show it
    problem, tried, members = result.problem, {n.key for n in result.ranked}, list[Member]()
    assert isinstance(problem, NetworkProblem)
    for i in range(len(best.terms)):
        rest = (*best.terms[:i], *best.terms[i + 1 :])
        base, there_already = without(problem, best, rest), {t.label for t in rest}
        new = [t for t in result.sought if t.label not in there_already and names_of((*rest, t)) not in tried]
        laws = [t for t in new if joins(t, rest)]
        members += [_begun(problem, base, b) for b in promising(problem, base, laws, best.cost, runs)]
    if not members:
        return result
    found = there(problem.searched_from(members, runs, best.columns))
    return result.joined_by(found).polished(runs)


def without(problem: NetworkProblem, fit: Fit, rest: tuple[Term, ...]) -> Base:
    """Where a fit is, but for the laws that are not of ``rest``."""
    unknowns = problem.hypothesis(rest)
    x = dict(zip((u.name for u in fit.unknowns), fit.x, strict=True))
    at_fit = np.array([x[u.name] for u in unknowns])
    return Base(Member(rest, unknowns, at_fit), np.stack([fit.columns[u.name] for u in unknowns], axis=1))


def promising(problem: NetworkProblem, base: Base, laws: Sequence[Term], best: float, runs: Runs) -> list[Begun]:
    """Laws that promise a cost near the best, each at the size where it does: all of those that might not be ruled out
    beside it, and a few more, as what one size promises is not exact. All are looked at with one size first."""
    first = [b for b in nearest(problem, base, laws, runs, TYPICAL) if b.left < best + _NEARLY * at.NEAR]
    found = nearest(problem, base, [b.term for b in first], runs) if first else []
    return [b for k, b in enumerate(found) if b.left < best + (at.NEAR if k < at.FEW else at.RULED_OUT)]


def _begun(problem: NetworkProblem, base: Base, begun: Begun) -> Member:
    """A hypothesis where it promises to come nearest."""
    x = base.member.x + begun.step
    return replace(base, member=replace(base.member, x=x)).with_laws(problem, [(begun.term, begun.x)])
