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
from fitting.inference.gauss_newton import Trial
from fitting.inference.network import NetworkProblem
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, joins

from . import thresholds as at
from .law_starts import TYPICAL, Base, Begun, nearest
from .scoring import Compared, names_of, there

Array = np.ndarray


def with_rivals(result: Compared, runs: Runs) -> Compared:
    """With the laws refitted that promise to explain the record in the stead of one of the best hypothesis, or of all
    of it, and those whose search ended far above what they promise from there."""
    best = min(result.every, key=lambda n: n.score).fit  # even one that is never named, as no sensor can show it
    problem, members = result.problem, dict[str, Member]()
    assert isinstance(problem, NetworkProblem)
    known = {n.key: n.fit.cost for n in result.ranked}
    for rest in _rests(best.terms):
        base, labels = without(problem, best, rest, runs), {t.label for t in rest}
        if base is not None:
            laws = [t for t in result.sought if t.label not in labels and joins(t, rest)]
            for begun in promising(problem, base, laws, result.none.fit.cost, runs):
                key = names_of((*rest, begun.term))
                if begun.left < known.get(key, np.inf) - at.RULED_OUT:
                    members.setdefault(key, _begun(problem, base, begun))
    if not members:
        return result
    found = there(problem.searched_from(list(members.values()), runs, best.columns, best.cost))
    return result.joined_by(found).polished(runs)


def _rests(terms: tuple[Term, ...]) -> list[tuple[Term, ...]]:
    """What stays of a hypothesis: nothing, and of two laws each alone."""
    return [(), *((t,) for t in terms if len(terms) > 1)] if terms else []


def without(problem: NetworkProblem, fit: Fit, rest: tuple[Term, ...], runs: Runs) -> Base | None:
    """Where a fit is, but for the laws that are not of ``rest``; what the outlet had that one of these replaced is as
    it usually is. None where that cannot be simulated."""
    unknowns, columns = problem.hypothesis(rest), fit.columns
    x = dict(zip((u.name for u in fit.unknowns), fit.x, strict=True))
    member = Member(rest, unknowns, np.array([x.get(u.name, 0.0) for u in unknowns]))
    missing = np.flatnonzero([u.name not in columns for u in unknowns])
    if len(missing):
        (point,) = problem.points([Trial(member, missing, None, np.zeros(len(unknowns)))], runs)
        if point is None:
            return None
        columns |= {unknowns[i].name: column for i, column in zip(missing, point.J.T, strict=True)}
    return Base(member, np.stack([columns[u.name] for u in unknowns], axis=1))


def promising(problem: NetworkProblem, base: Base, laws: Sequence[Term], most: float, runs: Runs) -> list[Begun]:
    """The nearest laws that promise to cost less than ``most``, each at the size where it does; what a strong one
    promises is far from exact, but it is among the nearest. All are looked at with one size first."""
    first = _fewest(nearest(problem, base, laws, runs, TYPICAL), most, 2 * at.FEW)
    return _fewest(nearest(problem, base, [b.term for b in first], runs), most, at.FEW) if first else []


def _fewest(begun: Sequence[Begun], most: float, n: int) -> list[Begun]:
    """The n nearest, and all that promise so much that they might not be ruled out beside these."""
    return [b for k, b in enumerate(begun) if b.left < most and (k < n or b.left < begun[0].left + at.RULED_OUT)]


def _begun(problem: NetworkProblem, base: Base, begun: Begun) -> Member:
    """A hypothesis where it promises to come nearest."""
    x = base.member.x + begun.step
    return replace(base, member=replace(base.member, x=x)).with_laws(problem, [(begun.term, begun.x)])
