"""The verdict: the hypotheses that remain, exact or with model discrepancy, and the conclusion from them.

Free runs of the FMU may withdraw a name (:func:`discrepancy.name.confirmation.confirmed`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.model_discrepancy import Beside, settled
from fitting.inference.places import NUMBER, Place
from fitting.inference.source_maps.source_map import SourceMap
from fitting.inference.unknown import Reach
from solver.network.description import Network

from .. import thresholds as at
from ..findings.map_marks import label_text
from ..findings.outcome import ADDED
from .scoring import Compared, Named, apart, ranked, shares, with_errors

Freed = Callable[[Named], Beside | None]


@dataclass(frozen=True)
class Naming:
    """The verdict on a record.

    verdict : none, effect, ambiguous, several, partial or unknown. problem : with its last weighting. base : without
    effect. ranked : best first. members : the class. columns : of every candidate at ``base``, whitened.
    confidence : probability that the verdict is right: that the best name (effect and place) is true; for none, that
    nothing acts at any place; for unknown, that the nearest effect does not act, small if it acts but leaves most of
    the gap. reason : for unknown; for partial, the remaining gap. complete : the search was completed. reaches :
    profile intervals of the best by unknown (:func:`discrepancy.name.intervals.profiled`). map : source map of a
    network; None for a first model that an effect, or none, explains. nearest : the best model without effect if that
    is far from the record; a name must do better (:mod:`discrepancy.name.model_selection`). only_with : for unknown, a
    sentence on the implausible values with which alone the model fits the record, and their consequence.
    """

    verdict: str
    problem: Forward
    base: Named
    ranked: tuple[Named, ...]
    members: tuple[Named, ...]
    columns: Mapping[str, Array]
    terms: tuple[PlacedEffect, ...]
    confidence: float
    reason: str | None = None
    complete: bool = True
    reaches: Mapping[str, Reach] = field(default_factory=dict)
    map: SourceMap | None = None
    nearest: Fit | None = None
    only_with: str = ""

    @property
    def adds(self) -> bool:
        """True if the verdict adds effects to the model."""
        return self.verdict in ADDED

    @property
    def best(self) -> Named:
        return self.ranked[0] if self.ranked else self.base

    @property
    def of_one_site(self) -> bool:
        """True if the best are two sensor faults of one site, which can imitate many other effects."""
        return _of_one_site(self.best, self.problem.network)

    @property
    def accuracy(self) -> float:
        """The stated error of the model at every harmonic, as a fraction of a channel's pulsation."""
        return self.problem.accuracy

    @property
    def walls(self) -> str:
        """The kind of walls: common to all arteries, or individual deviations."""
        return "individual" if self.base.individual else "common"


def decided(found: Compared, beside: Freed) -> Naming:
    """The verdict on all that were compared. beside : returns a hypothesis with model discrepancy."""
    made = _decided(found, beside)
    # in an approximate network, a named effect may stand for missing vessels, and missing vessels may hide an effect:
    # the confidence is limited, as for a partial effect
    loose = made.verdict == "partial" or made.accuracy > 0.0
    concluded = made.members or (made.verdict == "none" and loose)
    surest = at.SUREST["partial" if loose else found.problem.kind] if concluded else 1.0
    most = surest if found.complete else at.SUREST["incomplete"]
    return replace(made, confidence=min(made.confidence, most), complete=found.complete)


def _decided(found: Compared, beside: Freed) -> Naming:
    problem, none, approximate = found.problem, found.none, found.approximate
    exact = _with_shown([n for n in found.every if n.explains and both_show(found, n)])
    widened = ((n, beside(n)) for n in _discrepancy_candidates(found, exact))
    loose = [with_errors(n, errors) for n, errors in widened if errors is not None]
    if any(n.fit.terms for n in exact):
        approximate = tuple(n for n in approximate if not n.fit.terms or _closes(found, n))
    ways = ranked([*exact, *(n for n in loose if not _by_a_law(n, exact)), *_with_shown(approximate)])
    ways = tuple(replace(n, probability=p) for n, p in zip(ways, shares(ways), strict=True))
    if none.explains:
        ways = _with_aliases(ways)
    named = sum(n.probability for n in ways if n.fit.terms)
    unknown = Naming("unknown", problem, none, found.ranked, (), found.columns, found.terms, 1.0 - named)
    if not ways:  # nothing explains the record, and if no wall law is valid its error cannot be estimated
        return replace(unknown, confidence=at.SUREST["incomplete"], reason=_left(none.fit, problem))
    # similar effects share their probability: together they may be more probable than no effect
    best = next((n for n in ways if n.fit.terms), ways[0]) if named > 0.5 else max(ways, key=lambda n: n.probability)
    if not best.fit.terms:
        if best.errors is None or (none.explains and not best.places):
            nothing = sum(n.probability for n in ways if not n.fit.terms and not n.places)
            return replace(unknown, verdict="none", confidence=nothing)
        return replace(unknown, reason=_acting(best.places) if best.places else _left(none.fit, problem))
    confidence = sum(n.probability for n in ways if n.laws == best.laws)
    if best.errors is not None:
        return _partial(replace(unknown, confidence=confidence), found, ways, approximate)
    same = tuple(n for n in ways if n.errors is None and n.fit.terms)
    others = tuple(n for n in found.ranked if n.key not in {m.key for m in same})
    order = apart([*same, *others])
    members = _class(order[: len(same)])
    return replace(
        unknown,
        verdict=_exact_verdict(best, members, problem.network),
        ranked=order,
        members=members,
        confidence=confidence,
    )


def _with_aliases(ways: Sequence[Named]) -> tuple[Named, ...]:
    """Add the probability of faults that the record cannot show to that of the exact model without effect: if this
    model explains the record, they are its aliases."""
    hidden = sum(n.probability for n in ways if not n.shown)
    return tuple(
        n if n.fit.terms or n.errors is not None else replace(n, probability=n.probability + hidden)
        for n in ways
        if n.shown
    )


def _with_shown(exact: Sequence[Named]) -> list[Named]:
    """Drop hypotheses that the record cannot show. Those with a fault of the same sensors as a shown hypothesis remain
    and compete with it."""
    places = [{t.place for t in n.fit.terms} for n in exact if n.shown]
    return [n for n in exact if n.shown or {t.place for t in n.fit.terms} in places]


def both_show(found: Compared, n: Named) -> bool:
    """True if each of two effects is detectable beside the other. The linear model shows it (:attr:`Named.visible`),
    and so does the cost of a refit without the effect, d'² = cost(without it) - cost(both). In a network both must show
    it, because the linear response to an effect that replaces all viscosity is larger than what a refit gains; where
    there was no refit without the effect, the linear model suffices. On a bench one suffices, the refit with a higher
    limit.
    """
    alone = {other.label: other.fit.cost for other in found.ranked if len(other.fit.terms) == 1}
    both = n.fit.terms if len(n.fit.terms) > 1 else ()
    least = min((alone[t.label] - n.fit.cost for t in both if t.label in alone), default=math.inf)
    if found.problem.site is None:
        return n.visible and least >= at.VISIBLE**2
    return n.visible or (all(t.label in alone for t in both) and least >= at.BESIDE**2)


def _by_a_law(loose: Named, exact: Sequence[Named]) -> bool:
    """True if the map has only outlying parameters, and a law at the same arteries explains the record, within the
    odds of 1 : 100 of the map and more probable than no effect."""
    if loose.fit.terms or not loose.places or any(p.kind != NUMBER for p in loose.places):
        return False
    none = min((n.score for n in exact if not n.fit.terms), default=math.inf)
    there, most = {p.segment for p in loose.places}, min(loose.score + at.RULED_OUT, none)
    return any(n.fit.terms and n.score < most and {t.place for t in n.fit.terms} <= there for n in exact)


def _discrepancy_candidates(found: Compared, exact: Sequence[Named]) -> list[Named]:
    """Hypotheses that are also evaluated with an error of the model: no effect, and the most probable single effects,
    with each member of a pair that explains the record, so that a second effect must do better than such an error. In a
    network whose best hypothesis explains the record, no effect and that one alone; in other networks the most probable
    one, and those that close half of the gap. Others cannot be named, and a search for their places takes seconds."""
    if found.problem.site is None and any(n is found.best for n in exact):
        return [found.none, *([found.best] if len(found.best.fit.terms) == 1 else [])]
    single = [n for n in found.ranked if len(n.fit.terms) == 1 and n.shown]
    alone = {t.label for n in exact if len(n.fit.terms) > 1 for t in n.fit.terms}
    few = single[: at.FEW]
    if found.problem.site is None:
        few = [n for n in few if n is few[0] or n.label in alone or _closed(found, n) >= at.PART_CLOSED]
    return [found.none, *few, *(n for n in single[at.FEW :] if n.label in alone)]


def _closed(found: Compared, n: Named) -> float:
    """The fraction of the gap that a hypothesis closes."""
    return 1.0 - math.sqrt(n.fit.chi2 / found.none.fit.chi2)


def _closes(found: Compared, n: Named) -> bool:
    """False for an effect that closes too little of the gap to be named: beside one that leaves only noise, its model
    error explains the record in its place."""
    exact = next((other for other in found.ranked if other.key == n.key), None)
    return exact is None or _closed(found, exact) >= at.PART_CLOSED


def _class(order: Sequence[Named]) -> tuple[Named, ...]:
    """The hypotheses that cannot be ruled out, each name once."""
    names = dict[frozenset[tuple[str, tuple[str, ...]]], Named]()
    for n in order:
        if n.score - order[0].score < at.RULED_OUT:
            names.setdefault(n.laws, n)
    return tuple(names.values())


def _exact_verdict(best: Named, members: Sequence[Named], network: Network) -> str:
    """The verdict if the best hypothesis is exact and has an effect."""
    if len(best.fit.terms) == 1:
        return "effect" if len(members) == 1 else "ambiguous"
    return "ambiguous" if _of_one_site(best, network) else "several"


def _of_one_site(best: Named, network: Network) -> bool:
    """True for two sensors of one site; the flow meter counts at each site at the inlet."""
    inlet = {s.name for s in network.sites if s.segment == network.inlet.segment and s.position == 0.0}
    sites = [t.place.rpartition(".")[0] for t in best.fit.terms if t.is_sensor]
    return len(sites) == 2 and len({"inlet" if site in inlet else site for site in sites}) == 1


def _partial(unknown: Naming, found: Compared, ways: Sequence[Named], approximate: Sequence[Named]) -> Naming:
    """The verdict if an effect explains only a part of the gap; unknown if that is less than PART_CLOSED. unknown : the
    verdict in the latter case, with the confidence of the best name."""
    problem, none, best = found.problem, found.none, next(n for n in ways if n.fit.terms)
    exact = next(n for n in found.ranked if n.key == best.key)
    if _closed(found, exact) < at.PART_CLOSED:
        reason = f"{label_text(best.label)} comes nearest, but more remains: {_left(exact.fit, problem)}"
        return replace(unknown, confidence=1.0 - unknown.confidence, reason=reason)
    assert best.errors is not None
    wide = problem.widened(best.errors)
    own = set[str]() if best.places else {n.key for n in approximate}
    compared = [none, exact, *(n for n in found.ranked if n is not exact)]
    fits = wide.restated([n.fit for n in compared], problem)
    # hypotheses fitted with their own error keep their point: the error of the best one is too small for them
    fits = [f if n.key in own else settled(f) for n, f in zip(compared, fits, strict=True)]
    none, first, *rest = (n.moved_to(f, wide.dof_of_noise) for n, f in zip(compared, fits, strict=True))
    loose = [n for n in ways if n.errors is not None]
    chance = {n.key: sum(m.probability for m in loose if m.key == n.key) for n in loose}
    above = {n.key: n.score - best.score for n in reversed(loose)}  # each with its own errors
    order = tuple(
        replace(n, probability=chance.get(n.key, 0.0), above_best=above.get(n.key, n.above_best))
        for n in apart([first, *ranked(rest)])
    )
    labels = {n.key for n in _class([n for n in loose if n.fit.terms])}
    anew = wide.columns(none.fit, found.terms) if wide.site else wide.rewhitened(found.columns, problem)
    return replace(
        unknown, verdict="partial", problem=wide, base=none, ranked=order, columns=anew,
        members=tuple(n for n in order if n.key in labels), confidence=unknown.confidence,
        reason=_left(exact.fit, problem) + (f"; further, {_acting(best.places)}" if best.places else ""),
    )  # fmt: skip


def _acting(places: Sequence[Place]) -> str:
    """The free sources beside a hypothesis, in words."""
    *others, last = (p.label for p in places)
    return f"no law was found for {', '.join(others)}{' and ' if others else ''}{last}"


def _left(fit: Fit, problem: Forward) -> str:
    """Where the residual of a fit is largest, in words."""
    power = {int(s): float(np.mean(fit.z[fit.signal == s] ** 2)) for s in np.unique(fit.signal)}
    rms = math.sqrt(float(np.mean(fit.z**2)))
    low = float(np.mean(fit.z[fit.order <= 3] ** 2)) ** 0.5
    worst = max(power, key=lambda s: power[s])
    where = f", most in {problem.signals[worst]}" if len(power) > 1 else ""
    return f"whitened RMS {rms:.2g} ({low:.2g} up to the third harmonic){where}"
