"""Compare hypotheses on one record: what was found so far, ranked, under one weighting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fitting.inference.added import extended
from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.misfit import settled
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, followers, joins

from . import thresholds as at
from .weigh import Named, key_of, ranked, scores, shortlist, weighed

Array = np.ndarray


@dataclass(frozen=True)
class Compared:
    """What was compared so far.

    problem : as it was weighted at last. nones : without effect, with walls that have all in common or differ.
    ranked : best first. columns : of every candidate at the best of ``nones``, whitened.
    """

    problem: Forward
    nones: tuple[Named, ...]
    ranked: tuple[Named, ...]
    columns: Mapping[str, Array]
    terms: tuple[Term, ...]

    @property
    def none(self) -> Named:
        """The better one without effect."""
        return min(self.nones, key=lambda n: n.score)

    @property
    def best(self) -> Named:
        """The best hypothesis, that without effect included."""
        return min((*self.ranked, *self.nones), key=lambda n: n.score)

    @classmethod
    def of(
        cls, problem: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[Term, ...]
    ) -> Compared:
        """Of fits, weighed; of one hypothesis the more probable fit."""
        known: dict[tuple[str, bool], Named] = {}
        for n in (weighed(problem, f, terms) for f in fits):
            if n.key not in known or n.score < known[n.key].score:
                known[n.key] = n
        named = list(known.values())
        nones, rest = tuple(n for n in named if not n.fit.terms), [n for n in named if n.fit.terms]
        return cls(problem, nones, ranked(rest), columns, terms)

    @property
    def fits(self) -> list[Fit]:
        """Of all hypotheses."""
        return [n.fit for n in (*self.nones, *self.ranked)]

    def joined_by(self, fits: Sequence[Fit]) -> Compared:
        """With further hypotheses."""
        return Compared.of(self.problem, [*self.fits, *fits], self.columns, self.terms)

    def restated(self, problem: Forward) -> Compared:
        """Under the weights of another problem of the same record."""
        if problem is self.problem:
            return self
        fits = problem.restated(self.fits, self.problem)
        if problem.site is None:  # where other weights have it
            fits = [settled(f) for f in fits]
        return Compared.of(problem, fits, problem.rewhitened(self.columns, self.problem), self.terms)

    def polished(self, runs: Runs) -> Compared:
        """As the best hypothesis needs it weighted, and those near the best refitted with fresh derivatives."""
        sharp = self.problem.sharpened(self.best.fit, runs)
        if sharp is self.problem:
            return self
        near = [n.fit for n in (*self.nones, *self.ranked) if n.score < self.best.score + at.NEAR]
        again = {key_of(f): f for f in sharp.refine(near[: at.SHORTLIST // 2], runs) if f is not None}
        old = self.restated(sharp)
        return Compared.of(sharp, [again.get(key_of(f), f) for f in old.fits], old.columns, self.terms)

    def at_minimum(self, runs: Runs) -> Compared:
        """With the best hypothesis searched on, where it leaves something: its search may have begun far off."""
        if self.best.explains:
            return self
        (fit,) = self.problem.refine([self.best.fit], runs)
        return self if fit is None else self.joined_by([fit])

    def merged(self, other: Compared) -> Compared:
        """With the hypotheses of another comparison of the same record, under the weights of the better one."""
        better, worse = (self, other) if self.best.score <= other.best.score else (other, self)
        worse = worse.restated(better.problem)
        own, other = (better, worse) if better.none.score <= worse.none.score else (worse, better)
        everything = [*better.fits, *worse.fits]
        return Compared.of(better.problem, everything, own.columns or other.columns, self.terms)


def _labels(fit: Fit) -> tuple[str, ...]:
    return tuple(t.label for t in fit.terms)


def further(found: Compared, runs: Runs, branches: int = at.BRANCHES) -> Iterator[Compared]:
    """With more effects, or finer ones, until the best explains the record or nothing new is left to try.

    branches : of how many hypotheses at a time.
    """
    tried: set[tuple[str, ...]] = set()
    if found.best.fit.terms:
        elsewhere = moved_along(found, runs)
        if elsewhere:
            yield (found := found.joined_by(elsewhere))
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


def rewirings(found: Compared) -> list[tuple[Term, ...]]:
    """Outlets of another kind, which have two unknowns more: worth a refit where nothing else explains the record, and
    where what explains it acts in the segment of the outlet."""
    if not found.best.fit.terms and found.none.explains:
        return []
    near = {t.place for n in found.ranked if n.score < found.best.score + at.NEAR for t in n.fit.terms}
    return [(t,) for t in found.terms if t.rewires and (t.place in near or not found.best.explains)]


def hopeless(found: Compared) -> bool:
    """Whether the best effect leaves so much that nothing more beside it would explain the record."""
    fit = found.best.fit
    return bool(fit.terms) and fit.chi2 > at.HOPELESS * len(fit.z)


def moved_along(found: Compared, runs: Runs) -> list[Fit]:
    """The best effects of a part of a segment, wherever along it they may lie: of the best alone if it explains all."""
    best = found.best.fit
    local = [n.fit for n in found.ranked if len(n.fit.terms) == 1 and _within(at.ALONG_COST, n.fit, best)]
    fits = []
    for fit in local[:1] if found.best.explains else local[: at.ALONG]:
        term = found.problem.placed(fit, fit.terms[0])
        if term is not None:
            fits += [f for f in found.problem.refit([(term,)], fit, runs) if f is not None]
    return fits


def with_one_more(found: Compared, runs: Runs, tried: set[tuple[str, ...]], branches: int) -> list[Fit]:
    """One more effect beside each of the best hypotheses, or one of theirs refined from one size for all segments
    to one for each; of one combination the better fit. None where what is promised stays far above noise.

    tried : labels of the hypotheses that were taken up before; grows.
    """
    fits: dict[frozenset[str], Fit] = {}
    for first in _firsts(found, tried, branches):
        tried.add(_labels(first))
        for fit in (*_seconds(found, first, runs), *_refinements(found.problem, first, runs)):
            key = frozenset(_labels(fit))
            if key not in fits or fit.cost < fits[key].cost:
                fits[key] = fit
    return list(fits.values())


def _firsts(found: Compared, tried: set[tuple[str, ...]], branches: int) -> list[Fit]:
    """The best hypotheses that have room for another effect, one of each effect."""
    chosen: dict[str, Fit] = {}
    for n in found.ranked:
        near, room = _within(at.BRANCH_COST, n.fit, found.ranked[0].fit), len(n.fit.terms) < at.MOST_EFFECTS
        if near and room and _labels(n.fit) not in tried and len(chosen) < branches:
            chosen.setdefault(n.fit.terms[-1].effect, n.fit)
    return list(chosen.values())


def _within(factor: float, fit: Fit, best: Fit) -> bool:
    """Whether a cost is within a multiple of the best one's; ln det C, which has no zero, counts from the best's."""
    return fit.cost - best.log_volume < factor * (best.cost - best.log_volume)


def _seconds(found: Compared, first: Fit, runs: Runs) -> list[Fit]:
    """A second effect beside the first, where its linear promise comes near the noise."""
    problem, there = found.problem, set(_labels(first))
    others = [t for t in found.terms if t.label not in there and not t.rewires and joins(t, first.terms)]
    others += followers(extended(problem.network, first), problem.site, found.terms)
    (anew,) = problem.refine([first], runs)
    base = first if anew is None else anew
    columns = problem.columns(base, others, runs)
    enough = max(at.FAR_LEFT * len(base.z), at.PART_LEFT * base.chi2)
    promising = shortlist([s for s in scores(base, columns, others) if s.left < enough], at.SHORTLIST)
    fits = problem.refit([(*first.terms, t) for t in promising], base, runs, columns) if promising else []
    return [f for f in fits if f is not None]


def _refinements(problem: Forward, first: Fit, runs: Runs) -> list[Fit]:
    """Every effect of walls everywhere with a size of its own for each segment."""
    finer = [problem.refined(first, t) for t in first.terms]
    hypotheses = [(*first.terms[:i], f, *first.terms[i + 1 :]) for i, f in enumerate(finer) if f is not None]
    return [f for f in problem.refit(hypotheses, first, runs) if f is not None] if hypotheses else []
