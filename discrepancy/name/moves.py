"""Moves from the best hypothesis: another law, at any place, instead of one of its laws or all of them, or beside it.

The first comparison covers the laws at the places of the source map. Others may explain the record as well: few sensors
cannot distinguish an external pressure of one artery from one of its neighbour, a flexible law absorbs a missing second
law, and a law that acts everywhere is no place of a map. A name requires that all of these were refitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Fit, Member
from fitting.inference.gauss_newton import Trial
from fitting.inference.hypothesis import Term, joins
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs
from fitting.inference.source_maps.place_model import with_signals

from .. import thresholds as at
from .law_starts import TYPICAL, Base, Begun, along, fewest, nearest
from .scoring import Compared, names_of, there

Array = np.ndarray


def with_moves(result: Compared, runs: Runs, left: bool = False, more: bool = False) -> Compared:
    """Refit the laws that promise to explain the record instead of one law of the best hypothesis or all of them, and
    those whose search ended far above its predicted cost.

    left : the best leaves something; searches then start with a model error. more : another law may act beside it.
    """
    best = min(result.every, key=lambda n: n.score).fit  # even one that no sensor can show and that is never named
    assert isinstance(result.problem, NetworkProblem)
    problem, members = with_signals(result.problem, []), dict[tuple[str, bool], Member]()  # without free sources
    known, none = {n.key: n.fit.cost for n in result.ranked}, result.none.fit
    # a part of another segment may do what a part of one does
    anywhere = left or any(t.moves_along for t in best.terms)
    for rest in _rests(best.terms, left, more):
        base, labels = without(problem, best, rest, runs), {t.label for t in rest}
        if base is not None:
            plain = [t for t in result.sought if t.label not in labels and joins(t, rest)]
            laws = [each for t in plain for each in along(problem, t)] if anywhere else plain
            most = best.cost - at.SECOND if rest == best.terms else none.cost
            for begun in promising(problem, base, laws, most, runs):
                key = names_of((*rest, begun.term))
                if begun.left < known.get(key, np.inf) - at.RULED_OUT:
                    members.setdefault((key, begun.term.moves_along), _begun(problem, base, begun))
    if not members:
        return result
    chosen = list(members.values())
    if left:
        wide = problem.granted(at.AFAR)
        seen = problem.restated(there(wide.searched_from(chosen, runs)), wide)
        return result.joined_by(problem.relaxed(seen, runs)).polished(runs)
    return result.joined_by(problem.searched_from(chosen, runs, best.columns, best.cost)).polished(runs)


def _rests(terms: tuple[Term, ...], left: bool, more: bool) -> list[tuple[Term, ...]]:
    """The laws kept by each move: none, each one of a pair, and all if another one may act beside them."""
    rests = [(), *((t,) for t in terms if len(terms) > 1)] if terms or left else []
    return [*rests, terms] if terms and more and len(terms) < at.MOST_EFFECTS else rests


def without(problem: NetworkProblem, fit: Fit, rest: tuple[Term, ...], runs: Runs) -> Base | None:
    """The point of a fit reduced to the laws ``rest``. Parameters of an outlet that a removed law had replaced return
    to nominal. None if that point cannot be simulated."""
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
    """The laws with the lowest predicted cost, if below ``most``, each at its best size. The prediction is inaccurate
    for strong effects, but ranks them among the first. One size screens all laws first."""
    first = fewest(nearest(problem, base, laws, runs, TYPICAL), most, 2 * at.FEW)
    return fewest(nearest(problem, base, [b.term for b in first], runs), most) if first else []


def _begun(problem: NetworkProblem, base: Base, begun: Begun) -> Member:
    """A hypothesis at its predicted minimum."""
    x = base.member.x + begun.step
    return replace(base, member=replace(base.member, x=x)).with_laws(problem, [(begun.term, begun.x)])
