"""Weigh hypotheses: the score test that picks those worth a refit, and the evidence that ranks what was refitted.

Every hypothesis is evaluated in two ways: exact, or with an error of the model beside it: in a network free terms at
places (:mod:`fitting.inference.beside`), on a bench a random error of its law (:mod:`fitting.inference.misfit`). The
model without effect and with such an error is "something else". A number of prices make the prior: effects are equally
likely beforehand, and so are the places of one effect, so that many candidates do not make a discovery likelier.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.inference import hierarchy
from fitting.inference.fit import Fit, misfit, projected
from fitting.inference.forward import Forward
from fitting.inference.gauss_newton import bounded_step
from fitting.inference.misfit import Beside
from fitting.inference.places import Place
from fitting.inference.terms import Term
from fitting.inference.unknown import bounds, free, penalty, precision, precisions

from . import thresholds as at

Array = np.ndarray


@dataclass(frozen=True)
class Named:
    """A hypothesis with its score, -2 ln of evidence and prior. probability : among all. separation : d' to the best.
    above_best : by how much its score is worse than the best one's. errors : of the model that it is held with, None
    for an exact one; ``fit`` is then whitened with them. places : of a network where they act. shown : whether a record
    can show it: a sensor that is named by a frequency above half the sampling rate may be another fault of it, or the
    aliases of a flow with a kink, and is never what is named."""

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
        """What tells it from other hypotheses."""
        return names_of(self.fit.terms)

    @property
    def individual(self) -> bool:
        """Whether every artery has deviations of its own."""
        return any(u.group for u in self.fit.unknowns)

    @property
    def explains(self) -> bool:
        """Whether its residual is noise."""
        return self.misfit < (at.MISFIT_SEVERAL if len(self.fit.terms) > 1 else at.MISFIT)

    @property
    def visible(self) -> bool:
        """Whether each of two effects shows beside the other."""
        return len(self.fit.terms) < 2 or self.visibility >= at.VISIBLE

    @property
    def visibility(self) -> float:
        """d' of the weakest of its effects, beside the others: what its sizes change, where and how it acts there."""
        found = []
        for term in self.fit.terms:
            mine = np.array([u in term.unknowns for u in self.fit.unknowns], bool)
            size = mine & np.array([u.of_size or bool(u.group) for u in self.fit.unknowns], bool)
            prior = precision(self.fit.prior, self.fit.x)[~mine]
            change = self.fit.J[:, size] @ self.fit.x[size]
            found.append(float(np.linalg.norm(projected(self.fit.J[:, ~mine], prior, change[:, None]))))
        return min(found, default=math.inf)


def names_of(terms: Sequence[Term]) -> str:
    """The labels of effects, in the order of the alphabet."""
    return " + ".join(sorted(term.label for term in terms))


# --- the score test ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Score test of a term: the gain of the cost that its column promises, and the cost that would be left."""

    term: Term
    gain: float
    left: float


def scores(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> list[Score]:
    """Promised gains, largest first."""
    found = []
    for term in terms:
        if term.label not in columns:
            continue
        J = np.column_stack([base.J, columns[term.label]])
        own = [u for u, moves in zip(term.unknowns, free(term.unknowns), strict=True) if moves]
        low, high = (np.concatenate([a, b]) for a, b in zip(bounds(base.unknowns), bounds(own), strict=True))
        n = len(base.x)
        x = np.concatenate([base.x, np.zeros(len(own))])
        prior = precisions((*base.unknowns, *own))
        step = bounded_step(J, base.z, prior, x, low, high)
        left = base.z + J @ step
        promised = float(left @ left) + penalty(prior[:n], (x + step)[:n])
        found.append(Score(term, base.cost - base.log_volume - promised, promised))
    return sorted(found, key=lambda s: -s.gain)


def promised(base: Fit, terms: Sequence[Term], columns: Mapping[str, Array]) -> tuple[float, list[tuple[float, Term]]]:
    """-2 ln evidence without effect, and what the columns of every effect promise, best first."""
    found = []
    for term, column in ((t, columns[t.label]) for t in terms if t.label in columns):
        unknowns = [u for u, moves in zip(term.unknowns, free(term.unknowns), strict=True) if moves]
        x, J = np.concatenate([base.x, np.zeros(len(unknowns))]), np.column_stack([base.J, column])
        linear = hierarchy.Linear.of_columns(base.z, J, x, (*base.unknowns, *unknowns), base.log_volume)
        found.append((linear.inferred().score, term))
    return hierarchy.Linear.of(base).inferred().score, sorted(found, key=lambda each: each[0])


# --- evidence ---------------------------------------------------------------------------------------------------------


def price(fit: Fit, terms: Sequence[Term]) -> float:
    """-2 ln of the prior of a hypothesis: its effects and places among all."""
    effects = {t.effect for t in terms}
    value = 0.0
    for i, term in enumerate(fit.terms):
        places = sum(t.effect == term.effect for t in terms)
        value += 2.0 * math.log(max(len(effects), 1) * max(places, 1)) + (at.FIRST if i == 0 else at.SECOND)
    return value


def found_from(terms: Sequence[Term], term: Term, named: Named) -> float:
    """d' from which an effect of one number is found in a hypothesis: where its evidence is worth the price.

    Each of two effects is a second one, whose price is that of both less that of the other alone, and must show.
    """
    effects, places = {t.effect for t in terms}, sum(t.effect == term.effect for t in terms)
    beside = len(named.fit.terms) > 1
    cost = (at.SECOND if beside else at.FIRST) + 2.0 * math.log(max(len(effects), 1) * max(places, 1))
    d = 4.0
    for _ in range(20):  # d² = cost + the price of a size that is d standard deviations large
        d = math.sqrt(max(cost + 2.0 * math.log(2.0 * d * hierarchy.LOG_RANGE / math.sqrt(2.0 * math.pi)), 1.0))
    return max(d, at.VISIBLE) if beside and named.visible else d


def weighed(problem: Forward, fit: Fit, terms: Sequence[Term]) -> Named:
    """An exact hypothesis."""
    score = hierarchy.score(fit) + price(fit, terms)
    return Named(fit, score, misfit(fit, problem.dof_of_noise), shown=problem.shows(fit))


def with_errors(exact: Named, beside: Beside | None) -> Named | None:
    """The same hypothesis with the errors of the model beside it; None where there are none."""
    if beside is None:
        return None
    gained = hierarchy.score(beside.fit) - hierarchy.score(exact.fit)
    score = exact.score + gained + at.ELSE + beside.cost
    return replace(exact, fit=beside.fit, score=score, errors=beside.errors, places=beside.places)


def ranked(found: Sequence[Named]) -> tuple[Named, ...]:
    """Hypotheses by score, those that may be named first, with their distance from the best of these."""
    return apart(sorted(found, key=lambda n: (not n.shown, n.score)))


def apart(found: Sequence[Named]) -> tuple[Named, ...]:
    """Hypotheses in this order, with their distance from the first."""
    return tuple(
        replace(
            n,
            above_best=n.score - found[0].score,
            separation=math.sqrt(max(n.fit.cost - found[0].fit.cost, 0.0)),
        )
        for n in found
    )


def stated(probability: float, kind: str) -> float:
    """A probability as it is said: its log-odds moved and stretched to what came true on tuning records.

    kind : "bench" or "network", or "partial" of a name beside which more remains.

    J. Platt, Advances in Large Margin Classifiers (1999) 61.
    """
    p = min(max(probability, 1e-12), 1.0 - 1e-12)
    most, shift, slope = at.RELIABILITY[kind]
    odds = shift + slope * min(math.log(p / (1.0 - p)), most)
    return 1.0 / (1.0 + math.exp(-odds))


def shares(all_ways: Sequence[Named]) -> list[float]:
    """Probabilities of hypotheses among themselves."""
    best = min((n.score for n in all_ways), default=0.0)
    weights = [math.exp(-0.5 * (n.score - best)) for n in all_ways]
    return [w / sum(weights) for w in weights]
