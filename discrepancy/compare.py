"""Compare hypotheses on one record: what was found so far, ranked, under one weighting."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.misfit import settled
from fitting.inference.simulator import OutOfTime, Runs
from fitting.inference.terms import Term, effect_of

from . import thresholds as at
from .weigh import Named, names_of, ranked, weighed

Array = np.ndarray


@dataclass(frozen=True)
class Compared:
    """What was compared so far.

    problem : as it was weighted at last. none : without effect. ranked : those with effects, best first. columns : of
    every candidate at ``none``, whitened; empty where the time was over before they were simulated.
    """

    problem: Forward
    none: Named
    ranked: tuple[Named, ...]
    columns: Mapping[str, Array]
    terms: tuple[Term, ...]

    @property
    def every(self) -> tuple[Named, ...]:
        """All hypotheses, that without effect first."""
        return (self.none, *self.ranked)

    @property
    def best(self) -> Named:
        """The best hypothesis of those that may be named."""
        return min((n for n in self.every if n.shown), key=lambda n: n.score)

    @property
    def sought(self) -> tuple[Term, ...]:
        """What is looked for: where every artery differs, nothing that is merely the animal's."""
        if not self.none.individual:
            return self.terms
        return tuple(t for t in self.terms if not effect_of(t).of_animal(self.problem.network, t.place))

    @classmethod
    def of(
        cls, problem: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[Term, ...]
    ) -> Compared:
        """Of fits, one without effect among them, weighed; of one hypothesis the more probable fit."""
        known: dict[str, Named] = {}
        for n in (weighed(problem, f, terms) for f in fits):
            if n.key not in known or n.score < known[n.key].score:
                known[n.key] = n
        none = known.pop(names_of(()))
        return cls(problem, none, ranked(list(known.values())), columns, terms)

    @property
    def fits(self) -> list[Fit]:
        """Of all hypotheses."""
        return [n.fit for n in self.every]

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
        near = [n.fit for n in self.every if n.score < self.best.score + at.NEAR]
        again = {names_of(f.terms): f for f in sharp.refine(near[: at.FEW], runs) if f is not None}
        old = self.restated(sharp)
        return Compared.of(sharp, [again.get(names_of(f.terms), f) for f in old.fits], old.columns, self.terms)

    def at_minimum(self, runs: Runs) -> Compared:
        """With the best hypothesis searched on, where it leaves something: its search may have begun far off."""
        if self.best.explains:
            return self
        (fit,) = self.problem.refine([self.best.fit], runs)
        return self if fit is None else self.joined_by([fit])

    def with_columns(self, columns: Mapping[str, Array]) -> Compared:
        """With the columns of candidates at the hypothesis without effect."""
        return replace(self, columns=columns)


def last_of(stages: Iterator[Compared]) -> tuple[Compared, bool]:
    """What is known after the last stage, and whether there is none after it: the time may be over before.

    Raises OutOfTime where it was over before the first.
    """
    known = None
    try:
        while (later := next(stages, None)) is not None:
            known = later
    except OutOfTime:
        if known is None:
            raise
        return known, False
    assert known is not None
    return known, True


def exact(
    problem: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[Term, ...], runs: Runs
) -> Compared:
    """The hypotheses within reach of the best, weighted as it needs them and searched on; the others as they are."""
    order = sorted((weighed(problem, f, terms).score, i) for i, f in enumerate(fits))
    sharp = problem.sharpened(fits[order[0][1]], runs)
    fits = sharp.restated(fits, problem)
    found = {i: settled(f) for i, f in enumerate(fits)}
    left = set(found)
    again = [i for score, i in order if score < order[0][0] + at.NEAR]
    while again := again[: at.FEW]:  # until none that was not searched on looks better than those that were
        left -= set(again)
        for i, fit in zip(again, sharp.refine([fits[i] for i in again], runs), strict=True):
            if fit is not None:
                found[i] = fit
            elif fits[i].terms:
                del found[i]
        score = {i: weighed(sharp, f, terms).score for i, f in found.items()}
        lowest = min((score[i] for i in found if i not in left), default=np.inf)
        again = sorted((i for i in left if score[i] < lowest), key=score.__getitem__)
    return Compared.of(sharp, list(found.values()), sharp.rewhitened(columns, problem), terms)
