"""Hypotheses on one record: the score of each, and all that were fitted so far, ranked under one weighting.

The score is -2 ln of evidence times prior. Every hypothesis is evaluated exactly and with model discrepancy. That is
free terms at places in a network (:mod:`fitting.inference.source_maps.source_map`), or an error of its channels
(:mod:`discrepancy.name.approximate`), and a random error of the wall law on a bench
(:mod:`fitting.inference.model_discrepancy`). The model without effect but with discrepancy is "something else".
The prior consists of a few prices: effects are equally likely beforehand, and so are the places of one effect, so that
many candidates do not make a discovery likelier.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fitting.inference import hierarchy
from fitting.inference.fit import Array, Fit, misfit, projected
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import PlacedEffect, effect_of
from fitting.inference.model_discrepancy import Beside, settled
from fitting.inference.places import Place
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown import free, precision

from .. import thresholds as at

Each = TypeVar("Each")


@dataclass(frozen=True)
class Named:
    """A hypothesis with its score. probability : among all. separation : d' to the best. above_best : its score minus
    the best one's. errors : model discrepancy, None for an exact hypothesis; ``fit`` is whitened with it. places : in a
    network, of the discrepancy. shown : False for a sensor fault with a frequency above half the sampling rate. Such a
    fault may be another one of the sensor, or aliasing of a flow with a kink, and is never named."""

    fit: Fit
    score: float
    misfit: float
    probability: float = 0.0
    separation: float = 0.0
    above_best: float = 0.0
    errors: Array | None = None
    places: tuple[Place, ...] = ()
    shown: bool = True

    @property
    def label(self) -> str:
        return " + ".join(term.label for term in self.fit.terms)

    @property
    def key(self) -> str:
        """The identity of a hypothesis: the sorted labels of its effects."""
        return names_of(self.fit.terms)

    @property
    def laws(self) -> frozenset[tuple[str, tuple[str, ...]]]:
        """The effects and where they act, whether all walls share a size or each has its own: what a name says."""
        return frozenset((t.effect, t.where) for t in self.fit.terms)

    @property
    def individual(self) -> bool:
        """True if every artery has deviations of its own."""
        return any(u.group for u in self.fit.unknowns)

    @property
    def explains(self) -> bool:
        """True if its residual is noise."""
        return self.misfit < (at.MISFIT_SEVERAL if len(self.fit.terms) > 1 else at.MISFIT)

    @property
    def visible(self) -> bool:
        """True if each of two effects is detectable beside the other."""
        alone = [float(np.linalg.norm(whitened_response(self.fit, [t]))) for t in self.fit.terms]
        return len(alone) < 2 or min(alone) >= at.VISIBLE

    def moved_to(self, fit: Fit, dof_of_noise: float) -> Named:
        """The same hypothesis, at the same prior, with another fit to the same data."""
        score = self.score + hierarchy.score(fit) - hierarchy.score(self.fit)
        return replace(self, fit=fit, score=score, misfit=misfit(fit, dof_of_noise))


def names_of(terms: Sequence[PlacedEffect]) -> str:
    """The labels of effects in alphabetical order."""
    return " + ".join(sorted(term.label for term in terms))


def whitened_response(fit: Fit, terms: Sequence[PlacedEffect]) -> Array:
    """(n,) whitened response to the sizes of some effects of a fit, with all its other free unknowns projected out. Its
    norm is their d'."""
    names = {u.name for t in terms for u in t.unknowns}  # some of which may be fixed
    mine = np.array([u.name in names for u in fit.unknowns], bool)
    size = mine & np.array([u.of_size or bool(u.group) for u in fit.unknowns], bool)
    free_others = ~mine & np.array([u.low < u.high for u in fit.unknowns], bool)
    prior = precision(fit.prior, fit.x)[free_others]
    change = fit.J[:, size] @ fit.x[size]
    return projected(fit.J[:, free_others], prior, change[:, None])[:, 0]


# --- evidence and prior -----------------------------------------------------------------------------------------------


def promised(
    base: Fit, terms: Sequence[PlacedEffect], columns: Mapping[str, Array]
) -> tuple[float, list[tuple[float, PlacedEffect]]]:
    """-2 ln evidence without effect, and that predicted by the columns of every effect, best first."""
    found = []
    for term, column in ((t, columns[t.label]) for t in terms if t.label in columns):
        unknowns = [u for u, moves in zip(term.unknowns, free(term.unknowns), strict=True) if moves]
        x, J = np.concatenate([base.x, np.zeros(len(unknowns))]), np.column_stack([base.J, column])
        linear = hierarchy.Linear.of_columns(base.z, J, x, (*base.unknowns, *unknowns), base.log_volume)
        found.append((linear.inferred().score, term))
    return hierarchy.Linear.of(base).inferred().score, sorted(found, key=lambda each: each[0])


def choice(term: PlacedEffect, terms: Sequence[PlacedEffect]) -> float:
    """-2 ln of the prior odds of one effect and place among all."""
    effects, places = {t.effect for t in terms}, sum(t.effect == term.effect for t in terms)
    return 2.0 * math.log(max(len(effects), 1) * max(places, 1))


def price(fit: Fit, terms: Sequence[PlacedEffect]) -> float:
    """-2 ln of the prior of a hypothesis: its effects and places among all."""
    return sum(choice(t, terms) + (at.FIRST if i == 0 else at.SECOND) for i, t in enumerate(fit.terms))


def found_from(terms: Sequence[PlacedEffect], term: PlacedEffect, named: Named) -> float:
    """The d' from which the evidence of a one-parameter effect of a hypothesis exceeds its price.

    Each effect of a pair counts as the second one, with the pair's price less the other's, and must be detectable.
    """
    beside = len(named.fit.terms) > 1
    cost, d = choice(term, terms) + (at.SECOND if beside else at.FIRST), 4.0
    for _ in range(20):  # d² = cost + the prior volume of a size of d standard deviations
        d = math.sqrt(max(cost + 2.0 * math.log(2.0 * d * hierarchy.LOG_RANGE / math.sqrt(2.0 * math.pi)), 1.0))
    return max(d, at.VISIBLE) if beside and named.visible else d


def weighed(problem: Forward, fit: Fit, terms: Sequence[PlacedEffect]) -> Named:
    """An exact hypothesis with its score."""
    score = hierarchy.score(fit) + price(fit, terms)
    return Named(fit, score, misfit(fit, problem.dof_of_noise), shown=problem.shows(fit))


def with_errors(exact: Named, beside: Beside) -> Named:
    """The same hypothesis with model discrepancy."""
    gained = hierarchy.score(beside.fit) - hierarchy.score(exact.fit)
    score = exact.score + gained + (at.SECOND - at.PART) + beside.cost
    return replace(exact, fit=beside.fit, score=score, errors=beside.errors, places=beside.places)


def ranked(found: Sequence[Named]) -> tuple[Named, ...]:
    """Hypotheses by score, those that may be named first, with their distance from the first."""
    return apart(sorted(found, key=lambda n: (not n.shown, n.score)))


def apart(found: Sequence[Named]) -> tuple[Named, ...]:
    """Hypotheses in the given order, with their distance from the first."""
    return tuple(
        replace(
            n,
            above_best=n.score - found[0].score,
            separation=math.sqrt(max(n.fit.cost - found[0].fit.cost, 0.0)),
        )
        for n in found
    )


def shares(all_ways: Sequence[Named]) -> list[float]:
    """Posterior probabilities of hypotheses among themselves."""
    best = min((n.score for n in all_ways), default=0.0)
    weights = [math.exp(-0.5 * (n.score - best)) for n in all_ways]
    return [w / sum(weights) for w in weights]


# --- all that were compared -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Compared:
    """All hypotheses that were compared so far.

    problem : with its last weighting. none : without effect. ranked : with effects, best first. columns : of every
    candidate at ``none``, whitened; empty if the time limit came before their simulation. approximate : hypotheses
    scored with a model error of the channels (:mod:`discrepancy.name.approximate`). complete : False if the time limit
    ended the comparison.
    """

    problem: Forward
    none: Named
    ranked: tuple[Named, ...]
    columns: Mapping[str, Array]
    terms: tuple[PlacedEffect, ...]
    approximate: tuple[Named, ...] = ()
    complete: bool = True

    @classmethod
    def of(
        cls, problem: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[PlacedEffect, ...]
    ) -> Compared:
        """Score fits, among them one without effect. Of two fits of one hypothesis the more probable one counts."""
        known: dict[str, Named] = {}
        for n in (weighed(problem, f, terms) for f in fits):
            if n.key not in known or n.score < known[n.key].score:
                known[n.key] = n
        none = known.pop(names_of(()))
        return cls(problem, none, ranked(list(known.values())), columns, terms)

    @property
    def every(self) -> tuple[Named, ...]:
        """All hypotheses, the one without effect first."""
        return (self.none, *self.ranked)

    @property
    def fits(self) -> list[Fit]:
        """The fits of all hypotheses."""
        return [n.fit for n in self.every]

    @property
    def best(self) -> Named:
        """The best hypothesis among those that may be named."""
        return min((n for n in self.every if n.shown), key=lambda n: n.score)

    @property
    def sought(self) -> tuple[PlacedEffect, ...]:
        """The candidates. With individual walls, effects that are mere parameters of the subject are excluded."""
        if not self.none.individual:
            return self.terms
        return tuple(t for t in self.terms if not effect_of(t).of_animal(self.problem.network, t.place))

    def of_fits(self, fits: Sequence[Fit]) -> Compared:
        """The comparison of other fits to the same record."""
        return replace(Compared.of(self.problem, fits, self.columns, self.terms), complete=self.complete)

    def with_none(self, none: Fit) -> Compared:
        """The same comparison with another fit without effect."""
        return self.of_fits([none, *(n.fit for n in self.ranked)])

    def joined_by(self, fits: Sequence[Fit | None]) -> Compared:
        """Add further hypotheses; fits that failed (None) are dropped."""
        return self.of_fits([*self.fits, *there(fits)])

    def polished(self, runs: Runs) -> Compared:
        """Reweight the problem for the best hypothesis, and refit those near the best with fresh derivatives."""
        if self.problem.site is not None:  # of one weighting
            return self
        return exact(self.problem, self.fits, self.columns, self.terms, runs)

    def at_minimum(self, runs: Runs) -> Compared:
        """Refit the best hypothesis if it leaves more than noise: its search may have started far off."""
        return self if self.best.explains else self.joined_by(self.problem.refine([self.best.fit], runs))


def there(fits: Sequence[Each | None]) -> list[Each]:
    """The fits that succeeded."""
    return [f for f in fits if f is not None]


def last_of(stages: Iterator[Compared]) -> Compared:
    """The comparison after the last stage that was completed within the time limit.

    Raises OutOfTime if the limit was reached before the first.
    """
    known = None
    try:
        for later in stages:
            known = later
    except OutOfTime:
        if known is None:
            raise
        return replace(known, complete=False)
    assert known is not None
    return known


def exact(
    problem: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[PlacedEffect, ...], runs: Runs
) -> Compared:
    """Hypotheses near the best are refitted under weights for the best one; the others keep their linear minimum."""
    order = sorted((weighed(problem, f, terms).score, i) for i, f in enumerate(fits))
    sharp = problem.sharpened(fits[order[0][1]], runs)
    fits = sharp.restated(fits, problem)
    found = {i: settled(f) for i, f in enumerate(fits)}
    pending = set(found)
    again = [i for score, i in order if score < order[0][0] + at.NEAR]
    # every name is compared with the model without effect, so this is refitted first
    again.sort(key=lambda i: len(fits[i].terms) > 0)
    while again := again[: at.FEW]:  # until no hypothesis that was not refitted scores better than the refitted ones
        pending -= set(again)
        for i, fit in zip(again, sharp.refine([fits[i] for i in again], runs), strict=True):
            if fit is not None:
                found[i] = fit
            elif fits[i].terms:
                del found[i]
        score = {i: weighed(sharp, f, terms).score for i, f in found.items()}
        lowest = min((score[i] for i in found if i not in pending), default=np.inf)
        again = sorted((i for i in pending if score[i] < lowest), key=score.__getitem__)
    return Compared.of(sharp, list(found.values()), sharp.rewhitened(columns, problem), terms)
