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

import numpy as np

from fitting.inference.added import extended
from fitting.inference.fit import Fit, misfit
from fitting.inference.forward import Forward
from fitting.inference.search import bounded_step
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, followers, joins
from fitting.inference.unknown import bounds, penalty, precisions

from . import thresholds as at

Array = np.ndarray


@dataclass(frozen=True)
class Named:
    """A hypothesis with its score: BIC with its share of the prior. probability : among all, "none" and "something
    else" included. separation : d' to the best. above_best : by how much its score is worse than the best one's."""

    fit: Fit
    score: float
    misfit: float
    probability: float
    separation: float
    above_best: float = 0.0

    @property
    def label(self) -> str:
        return " + ".join(term.label for term in self.fit.terms)

    @property
    def explains(self) -> bool:
        """Whether its residual is noise."""
        return self.misfit < (at.MISFIT_SEVERAL if len(self.fit.terms) > 1 else at.MISFIT)


@dataclass(frozen=True)
class Naming:
    """verdict : none, effect, ambiguous, several or unknown. problem : as it was weighted at last. base : without
    effect. ranked : best first. members : the class. columns : of every candidate at ``base``, whitened. reason : for
    unknown."""

    verdict: str
    problem: Forward
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
    """Score test of a term: the gain of the cost that its column promises."""

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
        prior = precisions((*base.unknowns, *term.unknowns))
        step = bounded_step(J, base.z, prior, x, low, high)
        left = base.z + J @ step
        gain = base.cost - base.log_volume - float(left @ left) - penalty(prior[:n], (x + step)[:n])
        found.append(Score(term, gain))
    return sorted(found, key=lambda s: -s.gain)


def shortlist(ranked: Sequence[Score], size: int) -> list[Term]:
    """The best place of every effect that promises a part of what the best promises, then the best of all."""
    if len(ranked) <= size:
        return [score.term for score in ranked]
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


def score(problem: Forward, fit: Fit, terms: Sequence[Term]) -> float:
    """BIC and the price of having had many candidates: 2 ln(effects x places of this effect) for every term."""
    effects = {t.effect for t in terms}
    price, numbers = 0.0, len(problem.signals) * (2 * problem.K + 1)
    for term in fit.terms:
        places = sum(t.effect == term.effect for t in terms)
        price += 2.0 * math.log(len(effects) * max(places, 1)) + len(term.unknowns) * math.log(numbers)
    return fit.cost + price


def name(problem: Forward, terms: Sequence[Term], runs: Runs | None = None) -> Naming:
    """The verdict on one record: effects are added one by one until the residual is noise or nothing helps.

    Raises ArithmeticError if the model as given cannot be simulated with this record.
    """
    terms, runs = tuple(terms), runs or Runs()
    (found,) = problem.refit([()], runs=runs)
    if found is None:
        raise ArithmeticError("the model as given cannot be simulated with this record")
    none = _none(problem, found)
    if none.misfit < at.FAR_OFF:  # else the best hypothesis will tell how fine the steps must be
        problem, none, _ = _polished(problem, found, [], terms, runs)
    columns = problem.columns(none.fit, terms, runs)
    fits = _singles(problem, none, columns, terms, runs)
    none = _lower(problem, none, fits, runs)
    problem, none, ranked = _ranking(problem, none, fits, terms, runs)
    # another kind of outlet has two unknowns more: it is only worth its price where nothing else explains the record
    rewiring = [(t,) for t in terms if t.rewires]
    if rewiring and not none.explains and not (ranked and ranked[0].explains):
        lowest = min((n.fit.cost for n in ranked), default=none.fit.cost)
        others = problem.refit(rewiring, none.fit, runs, known=lowest)
        fits = [n.fit for n in ranked] + [f for f in others if f is not None]
        problem, none, ranked = _ranking(problem, none, fits, terms, runs)
    if not ranked or ranked[0].score > none.score - at.BIC_NONE:
        if none.explains:
            return Naming("none", problem, none, ranked, (), columns, terms)
        return Naming("unknown", problem, none, ranked, (), columns, terms, _left(none.fit, problem))
    while not ranked[0].explains and len(ranked[0].fit.terms) < at.MOST_EFFECTS:
        more = _ranked(problem, none, _more(problem, ranked, terms, runs), terms)
        if not more or more[0].score > ranked[0].score - at.SECOND:
            break
        problem, none, ranked = _polished(problem, none.fit, more, terms, runs)
    best = ranked[0]
    if not best.explains:
        reason = f"{best.label} comes nearest, but more remains: {_left(best.fit, problem)}"
        return Naming("unknown", problem, none, ranked, (), columns, terms, reason)
    members = _members(ranked)
    verdict = "several" if len(best.fit.terms) > 1 else "effect" if len(members) == 1 else "ambiguous"
    return Naming(verdict, problem, none, ranked, members, columns, terms)


def _lower(problem: Forward, none: Named, fits: Sequence[Fit], runs: Runs) -> Named:
    """The fit without effect, repeated from a fit of lower cost whose effect vanished: a local minimum was left."""
    best = min(fits, key=lambda f: f.cost, default=none.fit)
    own = {u.name for term in best.terms for u in term.unknowns}
    sizes = [abs(x) for u, x in zip(best.unknowns, best.x, strict=True) if u.name in own]
    if not sizes or max(sizes) > at.NO_SIZE or best.cost > none.fit.cost - at.BIC_NONE:
        return none
    (again,) = problem.refit([()], best, runs)
    lower = again is not None and again.cost < none.fit.cost
    return _none(problem, again) if again is not None and lower else none


def _none(problem: Forward, fit: Fit) -> Named:
    return Named(fit, fit.cost, misfit(fit, problem.dof_of_noise), 1.0, 0.0)


def _singles(
    problem: Forward, none: Named, columns: Mapping[str, Array], terms: tuple[Term, ...], runs: Runs
) -> list[Fit]:
    """The promising effects refitted, each by itself."""
    plain = shortlist(scores(none.fit, columns, terms), at.SHORTLIST)
    return [f for f in problem.refit([(t,) for t in plain], none.fit, runs, columns) if f is not None]


def _ranking(
    problem: Forward, none: Named, fits: Sequence[Fit], terms: tuple[Term, ...], runs: Runs
) -> tuple[Forward, Named, tuple[Named, ...]]:
    """The hypotheses ranked, and where one of them beats none, polished."""
    ranked = _ranked(problem, none, fits, terms)
    if ranked and ranked[0].score < none.score - at.BIC_NONE:
        return _polished(problem, none.fit, ranked, terms, runs)
    return problem, none, ranked


def _polished(
    problem: Forward, base: Fit, ranked: Sequence[Named], terms: tuple[Term, ...], runs: Runs
) -> tuple[Forward, Named, tuple[Named, ...]]:
    """The problem as the best hypothesis needs it, and those near the best refitted with fresh derivatives."""
    best = ranked[0].fit if ranked else base
    sharp = problem.sharpened(best, runs)
    near = [n.fit for n in ranked if n.score < ranked[0].score + at.NEAR][: at.SHORTLIST // 2]
    if sharp is problem:
        return problem, _none(problem, base), tuple(ranked)
    anew, *again = sharp.refine([base, *near], runs)
    fits = [f for f in again if f is not None]
    base = base if anew is None else anew
    none = _none(sharp, base)
    known = {tuple(t.label for t in f.terms) for f in fits}
    far = sharp.restated([n.fit for n in ranked if tuple(t.label for t in n.fit.terms) not in known], problem)
    return sharp, none, _ranked(sharp, none, [*fits, *far], terms)


def _ranked(problem: Forward, none: Named, fits: Sequence[Fit], terms: Sequence[Term]) -> tuple[Named, ...]:
    """Hypotheses by score, with probabilities."""
    if not fits:
        return ()
    scored = [(score(problem, f, terms), f) for f in fits]
    best = min(s for s, _ in scored)
    lowest = min(f.cost for _, f in scored)
    weights = [math.exp(-0.5 * (s - best)) for s, _ in scored]
    total = sum(weights) + math.exp(min(0.0, -0.5 * (none.score - best))) + at.SOMETHING_ELSE
    named = [
        Named(f, s, misfit(f, problem.dof_of_noise), w / total, math.sqrt(max(f.cost - lowest, 0.0)), s - best)
        for (s, f), w in zip(scored, weights, strict=True)
    ]
    return tuple(sorted(named, key=lambda n: n.score))


def _members(ranked: Sequence[Named]) -> tuple[Named, ...]:
    return tuple(n for n in ranked if n.score - ranked[0].score < 2.0 * math.log(at.CLASS_ODDS))


def _more(problem: Forward, ranked: Sequence[Named], terms: Sequence[Term], runs: Runs) -> list[Fit]:
    """One more effect beside each of the best hypotheses, or one of theirs refined from one size for all segments
    to one for each; of one combination the better fit."""
    found: dict[frozenset[str], Fit] = {}
    firsts: list[Named] = []
    for n in ranked:
        near = n.fit.cost < at.BRANCH_COST * ranked[0].fit.cost
        if (
            near
            and len(firsts) < at.BRANCHES
            and n.fit.terms[-1].effect not in {f.fit.terms[-1].effect for f in firsts}
        ):
            firsts.append(n)
    for first in firsts:
        there = {t.label for t in first.fit.terms}
        others = [t for t in terms if t.label not in there and not t.rewires and joins(t, first.fit.terms)]
        others += followers(extended(problem.network, first.fit), problem.site, terms)
        (anew,) = problem.refine([first.fit], runs)
        base = first.fit if anew is None else anew
        columns = problem.columns(base, others, runs)
        seconds = shortlist(scores(base, columns, others), at.SHORTLIST)
        fits = problem.refit([(*first.fit.terms, t) for t in seconds], base, runs, columns)
        for f in [*fits, *problem.refit(_refinements(problem, first.fit), runs=runs)]:
            if f is not None:
                key = frozenset(t.label for t in f.terms)
                found[key] = min(f, found.get(key, f), key=lambda fit: fit.cost)
    return list(found.values())


def _refinements(problem: Forward, fit: Fit) -> list[tuple[Term, ...]]:
    found = []
    for i, term in enumerate(fit.terms):
        finer = problem.refined(fit, term)
        if finer is not None:
            found.append((*fit.terms[:i], finer, *fit.terms[i + 1 :]))
    return found


def _left(fit: Fit, problem: Forward) -> str:
    """Where the residual of a fit is largest, in words."""
    power = {}
    for s in np.unique(fit.signal):
        mine = fit.signal == s
        power[int(s)] = float(np.mean(fit.z[mine] ** 2))
    rms = math.sqrt(float(np.mean(fit.z**2)))
    low = float(np.mean(fit.z[fit.order <= 3] ** 2)) ** 0.5
    worst = max(power, key=lambda s: power[s])
    where = f", most in {problem.signals[worst]}" if len(power) > 1 else ""
    return f"whitened RMS {rms:.2g} ({low:.2g} up to the third harmonic){where}"
