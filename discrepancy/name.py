"""Name the missing effect: which hypotheses of the catalogue explain the record, and which cannot be ruled out.

1. A score test of every effect at every place: what of its column the nuisances cannot absorb, against the residual.
2. The best are refitted in full with the nuisances under their priors.
3. They are compared by BIC with n = 2K + 1 per signal, each with its share of the prior: effects are equally likely
   beforehand, and so are the places of one effect, so that many candidates do not make a discovery likelier.
4. The class holds all that the data cannot rule out; a name is given only if the class has one member, and none if
   its residual is not noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.stats import t as t_distribution

from . import thresholds as at
from .fits import Fit, bounded_step, bounds, misfit, projected
from .terms import Term

Array = np.ndarray


class Problem(Protocol):
    """A record and the model that it is compared with: a bench or a network."""

    @property
    def n_effective(self) -> int:
        """Independent numbers in the record."""
        ...

    @property
    def dof_of_noise(self) -> float:
        """Degrees of freedom that the noise is known from."""
        ...

    def refit(
        self,
        hypotheses: Sequence[tuple[Term, ...]],
        start: Fit | None = None,
        columns: Mapping[str, Array] | None = None,
    ) -> list[Fit | None]:
        """The most probable unknowns of every hypothesis."""
        ...

    def refreshed(self, fits: Sequence[Fit]) -> list[Fit]:
        """The same with Jacobians fit for intervals."""
        ...

    def columns(self, at: Fit, terms: Sequence[Term]) -> dict[str, Array]:
        """Whitened derivatives by terms that may be added."""
        ...


@dataclass(frozen=True)
class Named:
    """A hypothesis with its score: BIC with its share of the prior. probability : among all, "none" and "something
    else" included. separation : d' to the best."""

    fit: Fit
    score: float
    misfit: float
    probability: float
    separation: float

    @property
    def label(self) -> str:
        return " + ".join(term.label for term in self.fit.terms)

    @property
    def explains(self) -> bool:
        """Whether its residual is noise."""
        return self.misfit < at.MISFIT


@dataclass(frozen=True)
class Naming:
    """verdict : none, effect, ambiguous, several or unknown. base : without effect. ranked : best first. members : the
    class. columns : of every candidate at ``base``, whitened. reason : for unknown."""

    verdict: str
    base: Named
    ranked: tuple[Named, ...]
    members: tuple[Named, ...]
    columns: Mapping[str, Array]
    terms: tuple[Term, ...]
    reason: str | None = None

    @property
    def best(self) -> Named:
        return self.ranked[0] if self.ranked else self.base

    @property
    def confidence(self) -> float:
        """Probability that the best name (effect and place) is right."""
        return self.best.probability


@dataclass(frozen=True)
class Score:
    """Score test of a term: gain of the cost that its column promises, and its d' per unit of x."""

    term: Term
    gain: float


def scores(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> list[Score]:
    """Promised gains, largest first."""
    found = []
    for term in terms:
        if term.label not in columns:
            continue
        J = np.column_stack([base.J, columns[term.label]])
        low, high = (np.concatenate([a, b]) for a, b in zip(bounds(base.unknowns), bounds(term.unknowns), strict=True))
        n = len(base.x)
        x = np.concatenate([base.x, np.zeros(len(term.unknowns))])
        prior = np.concatenate([base.prior, np.full(len(term.unknowns), at.PRIOR_WIDTH**-2.0)])
        step = bounded_step(J, base.z, prior, x, low, high)
        left = base.z + J @ step
        gain = base.cost - float(left @ left + prior[:n] @ (x + step)[:n] ** 2)
        found.append(Score(term, gain))
    return sorted(found, key=lambda s: -s.gain)


def shortlist(ranked: Sequence[Score], size: int) -> list[Term]:
    """The best place of every effect that promises a part of what the best promises, then the best of all."""
    if not ranked:
        return []
    least = max(at.BIC_NONE, at.PROMISING * ranked[0].gain)
    chosen: dict[str, Term] = {}
    effects: set[str] = set()
    for score in ranked:
        if score.term.effect not in effects and (score.gain > least or len(effects) < at.FEWEST):
            effects.add(score.term.effect)
            chosen[score.term.label] = score.term
    for score in ranked:
        if len(chosen) < size and score.gain > least:
            chosen.setdefault(score.term.label, score.term)
    return list(chosen.values())


def score(problem: Problem, fit: Fit, terms: Sequence[Term], scale: float = 1.0) -> float:
    """BIC and the price of having had many candidates: 2 ln(effects x places of this effect) for every term."""
    effects = {t.effect for t in terms}
    price = 0.0
    for term in fit.terms:
        places = sum(t.effect == term.effect for t in terms)
        price += 2.0 * math.log(len(effects) * max(places, 1)) + len(term.unknowns) * math.log(problem.n_effective)
    return fit.cost / scale + price


def name(problem: Problem, terms: Sequence[Term]) -> Naming:
    """The verdict on one record: at most two effects at once, see :func:`discrepancy.workflow.discover` for more."""
    terms = tuple(terms)
    (found,) = problem.refit([()])
    if found is None:
        raise ArithmeticError("the model as given cannot be simulated with this record")
    (base,) = problem.refreshed([found])
    columns = problem.columns(base, terms)
    none = Named(base, base.cost, misfit(base, problem.dof_of_noise), 1.0, 0.0)
    plain = shortlist(scores(base, columns, terms), at.SHORTLIST)
    fits = [f for f in problem.refit([(t,) for t in plain], base, columns) if f is not None]
    ranked = _ranked(problem, none, fits, terms)
    # another kind of outlet has two unknowns more: it is only worth its price where nothing else explains the record
    rewiring = [t for t in terms if t.rewires]
    if rewiring and not none.explains and not (ranked and ranked[0].explains):
        fits += [f for f in problem.refit([(t,) for t in rewiring]) if f is not None]
        ranked = _ranked(problem, none, fits, terms)
    if not ranked or ranked[0].score > none.score - at.BIC_NONE:
        if none.explains:
            return Naming("none", none, ranked, (), columns, terms)
        return Naming("unknown", none, ranked, (), columns, terms, _left(base, problem))
    best = ranked[0]
    if best.explains:
        members = _members(ranked)
        verdict = "effect" if len(members) == 1 else "ambiguous"
        return Naming(verdict, none, _refreshed(problem, ranked, members), members, columns, terms)
    pairs = _pairs(problem, ranked, terms)
    both = _ranked(problem, none, pairs, terms)
    if both and both[0].score < best.score - at.SECOND:
        if both[0].explains:
            members = _members(both)
            return Naming("several", none, _refreshed(problem, both, members), members, columns, terms)
        reason = f"{both[0].label} explain most of it, but more remains: {_left(both[0].fit, problem)}"
        return Naming("unknown", none, both + ranked, (), columns, terms, reason)
    reason = f"{best.label} comes nearest, but more remains: {_left(best.fit, problem)}"
    return Naming("unknown", none, ranked, (), columns, terms, reason)


def _ranked(problem: Problem, none: Named, fits: Sequence[Fit], terms: Sequence[Term]) -> tuple[Named, ...]:
    """Hypotheses by score, with probabilities. What the noise estimate or the solver leave is no evidence: costs are
    divided by the best reduced χ² where that is above 1."""
    if not fits:
        return ()
    dof = max(1, len(none.fit.z) - len(none.fit.x))
    scale = max(1.0, min(f.chi2 for f in fits) / dof)
    scored = [(score(problem, f, terms, scale), f) for f in fits]
    best = min(s for s, _ in scored)
    lowest = min(f.cost for _, f in scored)
    weights = [math.exp(-0.5 * (s - best)) for s, _ in scored]
    total = sum(weights) + math.exp(min(0.0, -0.5 * (none.score / scale - best))) + at.SOMETHING_ELSE
    named = [
        Named(f, s, misfit(f, problem.dof_of_noise), w / total, math.sqrt(max(f.cost - lowest, 0.0)))
        for (s, f), w in zip(scored, weights, strict=True)
    ]
    return tuple(sorted(named, key=lambda n: n.score))


def _members(ranked: Sequence[Named]) -> tuple[Named, ...]:
    return tuple(n for n in ranked if n.score - ranked[0].score < 2.0 * math.log(at.CLASS_ODDS))


def _refreshed(problem: Problem, ranked: Sequence[Named], members: Sequence[Named]) -> tuple[Named, ...]:
    """The ranking with Jacobians of the class fit for intervals."""
    fresh = problem.refreshed([m.fit for m in members[:4]])
    known = {m.label: f for m, f in zip(members, fresh, strict=False)}
    return tuple(Named(known.get(n.label, n.fit), n.score, n.misfit, n.probability, n.separation) for n in ranked)


def _pairs(problem: Problem, ranked: Sequence[Named], terms: Sequence[Term]) -> list[Fit]:
    """A second effect beside each of the best first ones."""
    found: dict[frozenset[str], Fit] = {}
    firsts: list[Named] = []
    for n in ranked:
        if len(firsts) < 3 and n.fit.terms[0].effect not in {f.fit.terms[0].effect for f in firsts}:
            firsts.append(n)
    for first in firsts:
        others = [t for t in terms if t.label != first.label and not t.rewires]
        (at_first,) = problem.refreshed([first.fit])
        columns = problem.columns(at_first, others)
        seconds = shortlist(scores(at_first, columns, others), at.SHORTLIST // 2)
        fits = problem.refit([(*first.fit.terms, t) for t in seconds], at_first, columns)
        for f in fits:
            if f is None:
                continue
            key = frozenset(t.label for t in f.terms)
            if key not in found or f.cost < found[key].cost:
                found[key] = f
    return list(found.values())


def _left(fit: Fit, problem: Problem) -> str:
    """Where the residual of a fit is largest, in words."""
    power = {}
    for s in np.unique(fit.signal):
        mine = fit.signal == s
        power[int(s)] = float(np.mean(fit.z[mine] ** 2))
    rms = math.sqrt(float(np.mean(fit.z**2)))
    low = float(np.mean(fit.z[fit.order <= 3] ** 2)) ** 0.5
    signals = getattr(problem, "signals", ())
    worst = max(power, key=lambda s: power[s])
    where = f", most in {signals[worst]}" if len(power) > 1 and len(signals) > worst else ""
    return f"whitened RMS {rms:.2g} ({low:.2g} up to the third harmonic){where}"


def quantile(problem: Problem) -> float:
    """Half a 95 % interval in standard deviations."""
    return float(t_distribution.ppf(0.975, problem.dof_of_noise))


def visibility(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> dict[str, float]:
    """d' of every term at typical size after the nuisance refit: norm of what the nuisances cannot absorb."""
    found = {}
    for term in terms:
        if term.label in columns:
            left = projected(base.J, base.prior, columns[term.label])
            found[term.label] = float(np.sqrt((left**2).sum(axis=0)).max())
    return found
