"""Compare hypotheses on one record: what was found so far, ranked, under one weighting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.misfit import settled
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, of_animal

from . import thresholds as at
from .weigh import Named, key_of, ranked, weighed

Array = np.ndarray
Columns = Mapping[bool, Mapping[str, Array]]


@dataclass(frozen=True)
class Compared:
    """What was compared so far.

    problem : as it was weighted at last. nones : without effect, with walls that have all in common or differ.
    ranked : best first. columns : of every candidate at each of ``nones``, whitened, by whether its walls differ.
    """

    problem: Forward
    nones: tuple[Named, ...]
    ranked: tuple[Named, ...]
    columns: Columns
    terms: tuple[Term, ...]

    @property
    def none(self) -> Named:
        """The better one without effect."""
        return min(self.nones, key=lambda n: n.score)

    @property
    def best(self) -> Named:
        """The best hypothesis, that without effect included."""
        return min((*self.ranked, *self.nones), key=lambda n: n.score)

    @property
    def sought(self) -> tuple[Term, ...]:
        """What is looked for: where every artery differs, nothing that is merely the animal's."""
        if not self.none.individual:
            return self.terms
        return tuple(t for t in self.terms if not of_animal(self.problem.network, t))

    def columns_of(self, none: Named) -> Mapping[str, Array]:
        """The columns at one of ``nones``; empty where the time was over before they were simulated."""
        return self.columns.get(none.individual, {})

    @classmethod
    def of(cls, problem: Forward, fits: Sequence[Fit], columns: Columns, terms: tuple[Term, ...]) -> Compared:
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
        columns = {kind: problem.rewhitened(each, self.problem) for kind, each in self.columns.items()}
        return Compared.of(problem, fits, columns, self.terms)

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
        columns = {kind: each for found in (worse, better) for kind, each in found.columns.items() if each}
        return Compared.of(better.problem, [*better.fits, *worse.fits], columns, self.terms)


def rewirings(found: Compared) -> list[tuple[Term, ...]]:
    """Outlets of another kind, which have two unknowns more: worth a refit where nothing else explains the record, and
    where what explains it acts in the segment of the outlet."""
    if not found.best.fit.terms and found.none.explains:
        return []
    near = {t.place for n in found.ranked if n.score < found.best.score + at.NEAR for t in n.fit.terms}
    return [(t,) for t in found.terms if t.rewires and (t.place in near or not found.best.explains)]


def hopeless(found: Compared) -> bool:
    """Whether the best effect leaves so much that nothing more beside it would explain the record; or, where none was
    tried, the animal without effect so much that its walls are to blame, too."""
    fit = found.best.fit
    return fit.chi2 > (at.HOPELESS if fit.terms else at.ANOTHER_ANIMAL) * len(fit.z)


def within(factor: float, fit: Fit, best: Fit) -> bool:
    """Whether a cost is within a multiple of the best one's; ln det C, which has no zero, counts from the best's."""
    return fit.cost - best.log_volume < factor * (best.cost - best.log_volume)
