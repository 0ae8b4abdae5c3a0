"""Hypotheses of a network that is only approximately right, each with the model error that its own residual shows.

If no hypothesis leaves only noise, the noise is a wrong weight. Where harmonics are known to 0.01 mmHg and means to 0.5
mmHg, a fit weighted by it sacrifices the means, and every search ends in the minimum nearest to its start. Hypotheses
are therefore fitted with the model error of a calibration (:mod:`fitting.inference.joint.model_error`): a random error
of every channel, of the size that makes the residual most probable, stands for the physics that the network lacks. A
law that explains more leaves a smaller error, and the evidence contains its volume,

    -2 ln p = zᵀ (1 + E)⁻¹ z + ln det(1 + E) + …,    E : covariance of the error, whitened as z is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.calibrate.first_search import FAR
from fitting.inference.extended_network import allowed
from fitting.inference.fit import Fit, Member
from fitting.inference.forward import Forward
from fitting.inference.gauss_newton import Trial
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.joint.model_error import Networks, covariances, granted, joint, log_volume, minimum
from fitting.inference.model_discrepancy import PART, Beside
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.source_maps.source_map import LEVELS, is_noise
from fitting.inference.unknown import Unknown, absent
from solver.errors import InputError

from .. import thresholds as at
from .scoring import Compared, Named, apart, promised, there, weighed, with_errors


@dataclass(frozen=True)
class Approximate:
    """A hypothesis fitted with its model error. fit : whitened by the noise alone. named : scored and whitened with the
    error; None if only noise is left."""

    fit: Fit
    named: Named | None = None

    @property
    def score(self) -> float:
        """-2 ln of evidence and prior; below any other if only noise is left."""
        return -np.inf if self.named is None else self.named.score


def compared_first_model(
    problem: Networks, terms: tuple[PlacedEffect, ...], runs: Runs, likely: Sequence[tuple[PlacedEffect, ...]] = ()
) -> Compared:
    """The comparison for a first model, which is approximate by its construction: no law is sought at single places,
    unlike for a network whose arteries are those of the subject. If the model fits within its stated accuracy, no law
    is compared with it: the accuracy is a bound that recordings of one subject share, not a random error which evidence
    could weigh. likely : hypotheses that are fitted in any case.

    Raises InputError if the model as given cannot be simulated with this record.
    """
    unlimited = replace(runs, deadline=None)
    none = from_afar(problem, problem.hypothesis(()), unlimited) or problem.refit([()], runs=unlimited)[0]
    if none is None:
        raise InputError("the model as given cannot be simulated with this record")
    sharp: Networks = problem.sharpened(none, unlimited)
    whole: Forward = sharp
    (base,) = there([_with_derivatives(sharp, none, unlimited)]) or whole.restated([none], problem)
    found = Compared.of(sharp, [base], {}, terms)
    if found.none.explains:
        return replace(found, columns=sharp.columns(base, found.sought, unlimited))
    return _with_errors(sharp, found, [base], [], runs, likely)


def compared_with_errors(found: Compared, runs: Runs) -> Compared:
    """The comparison of the model without effect, the effects that promise most beside it, and the best hypothesis so
    far, each fitted with its own model error."""
    problem, unlimited = found.problem, replace(runs, deadline=None)
    assert isinstance(problem, Networks)
    none = _with_derivatives(problem, found.none.fit, unlimited)
    starts = there([none, from_afar(problem, found.none.fit.unknowns, unlimited)])
    best = [_with_derivatives(problem, found.best.fit, unlimited)] if found.best.fit.terms else []
    return _with_errors(problem, found, starts, there(best), runs) if starts else found


def _with_errors(
    problem: Networks,
    found: Compared,
    starts: Sequence[Fit],
    others: Sequence[Fit],
    runs: Runs,
    likely: Sequence[tuple[PlacedEffect, ...]] = (),
) -> Compared:
    """The comparison with hypotheses at the points that they have with their model errors; ``approximate`` are these,
    without those that leave only noise.

    starts : of the model without effect, which is fitted whatever the time limit. others : fits with effects. The
    derivatives at the model without effect, weighted with its model error, promise the evidence of every candidate."""
    unlimited, complete = replace(runs, deadline=None), found.complete
    bases = there([_fitted(problem, fit, found.terms, unlimited) for fit in starts])
    if not bases:
        return found
    each = [min(bases, key=lambda a: a.score)]
    try:
        found = replace(found, columns=problem.columns(each[0].fit, found.sought, runs))
        for fit in (*others, *_promising(problem, each[0], found, runs, likely)):
            each += there([_fitted(problem, fit, found.terms, runs)])
    except OutOfTime:
        complete = False
    noise = there(problem.refine([a.fit for a in each if a.named is None], unlimited))
    own = dict[str, Named]()
    for n in sorted((a.named for a in each if a.named is not None), key=lambda n: n.score):
        own.setdefault(n.key, n)
    found = _at_these_points(found.joined_by(noise), [*map(Approximate, noise), *(a for a in each if a.named)])
    return replace(found, approximate=tuple(own.values()), complete=complete)


def from_afar(problem: Networks, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, fitted from the network's own values while a model error shrinks; whitened by the noise
    alone. None if these values cannot be simulated."""
    member, fit = Member((), unknowns, absent(unknowns)), None
    whole: Forward = problem
    for level in LEVELS[1:-1]:
        wide = granted(problem, np.full(2, level))
        (fit,) = wide.searched_from([member], runs)
        if fit is None:
            return None
        member = fit.member
    return None if fit is None else whole.restated([fit], wide)[0]


def nearest(problem: Networks, none: Fit, runs: Runs) -> Fit | None:
    """The model without effect of lowest cost, refitted from its present point and from afar. None if the present fit
    is near the record (:func:`is_far`). Every name must fit better: the map of a wrong model distorts the walls, a
    search from these may end far from the record, and any effect then seems to close a part of the gap.
    """
    (point,) = problem.points([Trial(none.member, np.arange(0), None, 0.0 * none.x)], runs)
    if point is not None and not is_far(problem, replace(none, z=point.z)):
        return None
    fits = there(problem.refine([none, *there([from_afar(problem, none.unknowns, runs)])], runs))
    return min(fits, key=lambda f: f.cost, default=None)


def is_far(problem: Networks, fit: Fit) -> bool:
    """True if a fit leaves so much of the pulsation (the limit of a calibration) that its minimum may be wrong."""
    return not is_noise(fit.chi2, len(fit.z)) and joint(problem).left_of_pulsation(fit) > FAR


def _with_derivatives(problem: Forward, fit: Fit, runs: Runs) -> Fit | None:
    """A fit with residual and derivatives simulated at its point; they may have been predicted. None if it has no
    beat."""
    (point,) = problem.points([Trial(fit.member, np.arange(len(fit.x)), None, 0.0 * fit.x)], runs)
    return None if point is None else replace(fit, z=point.z, J=point.J, derived_at=fit.x)


def _promising(
    problem: Forward, base: Approximate, found: Compared, runs: Runs, likely: Sequence[tuple[PlacedEffect, ...]]
) -> list[Fit]:
    """Likely hypotheses and the effects that promise more evidence than none, at most FEW, refitted with the model
    error of ``base``, the model without effect, at which ``found`` has its columns; whitened by the noise alone."""
    wide = problem
    if base.named is not None:
        assert base.named.errors is not None
        wide = problem.widened(base.named.errors)
    (none,) = wide.restated([base.fit], problem)
    columns = wide.rewhitened(found.columns, problem)
    without, gained = promised(none, found.sought, columns)
    best = list(dict.fromkeys([*likely, *[(term,) for score, term in gained if score < without][: at.FEW]]))
    return problem.restated(there(wide.refit(best, none, runs, columns)), wide)


def _fitted(problem: Networks, fit: Fit, terms: Sequence[PlacedEffect], runs: Runs) -> Approximate | None:
    """A hypothesis refitted with its model error; None if a parameter left its range."""
    whole = joint(problem)
    ended = minimum(whole, fit, problem.rules, runs)
    if any(allowed(problem.network, whole.of(ended.fit, i)) is None for i in range(len(whole.parts))):
        return None
    exact = weighed(problem, ended.fit, terms)
    if exact.explains and not ended.errors.any():  # the latter is a test of the linear problem
        return Approximate(ended.fit)
    wide = granted(problem, ended.errors)
    weighted: Forward = wide
    (restated,) = weighted.restated([ended.fit], problem)
    restated = replace(restated, log_volume=log_volume(wide) - log_volume(problem))
    cost = PART * len({*ended.errors.tolist()} - {0.0})  # equal ones are one
    return Approximate(ended.fit, with_errors(exact, Beside(restated, covariances(wide), cost)))


def _at_these_points(found: Compared, each: Sequence[Approximate]) -> Compared:
    """The comparison of these hypotheses at these points, most probable first, and of all others that leave only noise.
    At other points the misfit was minimised with other weights. above_best is the difference of the scores with model
    errors, by which they are in order, if all have one."""
    weighted = [(a.score, weighed(found.problem, a.fit, found.terms)) for a in each]
    best = dict[str, tuple[float, Named]]()
    for score, exact in sorted(weighted, key=lambda pair: (pair[0], pair[1].score)):
        best.setdefault(exact.key, (score, exact))
    none = best.pop("", (0.0, found.none))[1]
    named = [*(n for _, n in best.values()), *(n for n in found.ranked if n.key not in best and n.explains)]
    order = apart(sorted(named, key=lambda n: not n.shown))
    scores = [best[n.key][0] if n.key in best else -np.inf for n in order]
    if np.isfinite(scores).all():
        order = tuple(replace(n, above_best=score - scores[0]) for n, score in zip(order, scores, strict=True))
    return replace(found, none=none, ranked=order)
