"""More effects beside the best, or finer ones, while more than noise remains."""

from __future__ import annotations

from collections.abc import Iterator

from fitting.inference.added import extended
from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.simulator import Runs
from fitting.inference.terms import followers, joins

from . import thresholds as at
from .along import moved_along, promising
from .compare import Compared, within
from .weigh import names_of, scores, shortlist


def further(found: Compared, runs: Runs, branches: int = at.BRANCHES) -> Iterator[Compared]:
    """With more effects, or finer ones, until the best explains the record or nothing new is left to try.

    branches : of how many hypotheses at a time.
    """
    tried: set[str] = set()
    if found.best.fit.terms and (fits := moved_along(found, runs)):
        yield (found := found.joined_by(fits))
    if found.best.fit.terms and not found.best.explains and (fits := promising(found, runs)):
        yield (found := found.joined_by(fits))
        if not found.best.explains and (fits := moved_along(found, runs)):
            yield (found := found.joined_by(fits))
    while found.best.fit.terms and not found.best.explains:
        fits = with_one_more(found, runs, tried, branches)
        if not fits:
            return
        known = found.best.score
        found = found.joined_by(fits)
        if not found.best.visible:
            found = found.joined_by(_each_alone(found, runs))
        found = found.polished(runs) if found.best.score < known else found
        yield found


def _each_alone(found: Compared, runs: Runs) -> list[Fit]:
    """Each effect of the best hypothesis alone, from where that ended: one that is nothing beside the other has only
    shown its search the way."""
    best, able = found.best.fit, {t.label for t in found.terms}
    fits = found.problem.refit([(t,) for t in best.terms if t.label in able], best, runs)
    return [f for f in fits if f is not None]


def with_one_more(found: Compared, runs: Runs, tried: set[str], branches: int) -> list[Fit]:
    """One more effect beside each of the best hypotheses, or one of theirs refined from one size for all segments
    to one for each; of one combination the better fit. None where what is promised stays far above noise.

    tried : names of the hypotheses that were taken up before; grows.
    """
    fits: dict[str, Fit] = {}
    for first in _firsts(found, tried, branches):
        tried.add(names_of(first.terms))
        for fit in (*_seconds(found, first, runs), *_refinements(found.problem, first, runs)):
            key = names_of(fit.terms)
            if key not in fits or fit.cost < fits[key].cost:
                fits[key] = fit
    return list(fits.values())


def _firsts(found: Compared, tried: set[str], branches: int) -> list[Fit]:
    """The best hypotheses that have room for another effect, one of each effect."""
    chosen: dict[str, Fit] = {}
    for n in found.ranked:
        near, room = within(at.BRANCH_COST, n.fit, found.ranked[0].fit), len(n.fit.terms) < at.MOST_EFFECTS
        if near and room and names_of(n.fit.terms) not in tried and len(chosen) < branches:
            chosen.setdefault(n.fit.terms[-1].effect, n.fit)
    return list(chosen.values())


def _seconds(found: Compared, first: Fit, runs: Runs) -> list[Fit]:
    """A second effect beside the first, where its linear promise comes near the noise."""
    problem, there = found.problem, {t.label for t in first.terms}
    others = [t for t in found.sought if t.label not in there and not t.rewires and joins(t, first.terms)]
    others += followers(extended(problem.network, first), problem.site, found.terms)
    (anew,) = problem.refine([first], runs)
    base = first if anew is None else anew
    columns = problem.columns(base, others, runs)
    enough = max(at.FAR_LEFT * len(base.z), at.PART_LEFT * base.chi2)
    chosen = shortlist([s for s in scores(base, columns, others) if s.left < enough], at.SHORTLIST)
    fits = problem.refit([(*first.terms, t) for t in chosen], base, runs, columns) if chosen else []
    return [f for f in fits if f is not None]


def _refinements(problem: Forward, first: Fit, runs: Runs) -> list[Fit]:
    """Every effect of walls everywhere with a size of its own for each segment."""
    finer = [problem.refined(first, t) for t in first.terms]
    hypotheses = [(*first.terms[:i], f, *first.terms[i + 1 :]) for i, f in enumerate(finer) if f is not None]
    return [f for f in problem.refit(hypotheses, first, runs) if f is not None] if hypotheses else []
