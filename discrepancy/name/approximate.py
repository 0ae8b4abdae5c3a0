"""Hypotheses of a network that is only approximately right, each with the model error that its own residual shows.

If no hypothesis leaves only noise, noise is a wrong weight. Where harmonics are known to 0.01 mmHg and means to 0.5
mmHg, it gives up the means, and every search ends in the minimum nearest to its start. So hypotheses are fitted as a
calibration is (:mod:`fitting.inference.joint.model_error`): a random error of every channel, of the size that makes the
residual most probable, stands for what the network lacks. A law that explains more leaves a smaller error, and the
evidence contains its volume,

    -2 ln p = zᵀ (1 + E)⁻¹ z + ln det(1 + E) + …,    E : covariance of the error, whitened as z is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.inference.fit import Array, Fit, Member
from fitting.inference.gauss_newton import Trial
from fitting.inference.hypothesis import Term
from fitting.inference.joint.joint_record import Several
from fitting.inference.joint.model_error import granted, minimum, networks
from fitting.inference.model_discrepancy import PART, Beside
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs
from fitting.inference.source_maps.source_map import LEVELS
from fitting.inference.unknown import Unknown, absent
from solver.errors import InputError

from .. import thresholds as at
from .scoring import Compared, Named, apart, promised, there, weighed, with_errors


@dataclass(frozen=True)
class Approximate:
    """A hypothesis fitted with its model error. fit : whitened by the noise alone. named : scored and whitened with the
    error; None if there is no error, because only noise is left."""

    fit: Fit
    named: Named | None = None

    @property
    def score(self) -> float:
        """-2 ln of evidence and prior; below any other if only noise is left."""
        return -np.inf if self.named is None else self.named.score


def of_first(problem: NetworkProblem, terms: tuple[Term, ...], runs: Runs) -> tuple[Compared, list[Named]]:
    """The comparison for a first model, which is approximate by its construction: no law is sought at single places, as
    for a network whose arteries are those of the subject.

    Raises InputError if the model as given cannot be simulated with this record.
    """
    none = from_afar(problem, problem.hypothesis(()), runs)
    if none is None:
        raise InputError("the model as given cannot be simulated with this record")
    sharp = problem.sharpened(none, runs)
    (base,) = there([_computed(sharp, none, runs)]) or sharp.restated([none], problem)
    return _compared(sharp, Compared.of(sharp, [base], {}, terms), [base], [], runs)


def approximated(found: Compared, runs: Runs) -> tuple[Compared, list[Named]]:
    """The comparison with hypotheses fitted with their own model errors, and these as they are scored with them: the
    model without effect, the effects that promise most beside it, and the best hypothesis so far."""
    problem = found.problem
    assert isinstance(problem, NetworkProblem)
    starts = [_computed(problem, found.none.fit, runs), from_afar(problem, found.none.fit.unknowns, runs)]
    best = [_computed(problem, found.best.fit, runs)] if found.best.fit.terms else []
    return _compared(problem, found, there(starts), there(best), runs)


def _compared(
    problem: NetworkProblem, found: Compared, starts: Sequence[Fit], others: Sequence[Fit], runs: Runs
) -> tuple[Compared, list[Named]]:
    """starts : of the model without effect. others : fits with effects. The derivatives at the model without effect,
    weighted with its model error, promise the evidence of every candidate."""
    base = min((_with_error(problem, fit, found.terms, runs) for fit in starts), key=lambda a: a.score)
    columns = problem.columns(base.fit, found.sought, runs)
    wide = problem if base.named is None else problem.widened(np.asarray(base.named.errors))
    (none,) = wide.restated([base.fit], problem)
    promising = _promising(wide, none, found.sought, wide.rewhitened(columns, problem), runs)
    fits = [*others, *problem.restated(promising, wide)]
    each = [base, *(_with_error(problem, fit, found.terms, runs) for fit in fits)]
    exact = problem.refine([a.fit for a in each if a.named is None], runs)
    found = _moved(replace(found, columns=columns), each).joined_by(exact)
    return found, [a.named for a in each if a.named is not None]


def from_afar(problem: NetworkProblem, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, fitted from the network's own values while a model error shrinks; whitened by the noise
    alone. None if these values cannot be simulated."""
    member, fit, wide = Member((), unknowns, absent(unknowns)), None, problem
    for level in LEVELS[1:-1]:
        wide = problem.granted(level, alike=True)
        (fit,) = wide.searched_from([member], runs)
        if fit is None:
            return None
        member = fit.member
    return None if fit is None else problem.restated([fit], wide)[0]


def _computed(problem: NetworkProblem, fit: Fit, runs: Runs) -> Fit | None:
    """A fit with the residual and derivatives at its point, which may be predicted ones; None if it has no beat."""
    (point,) = problem.points([Trial(fit.member, np.arange(len(fit.x)), None, 0.0 * fit.x)], runs)
    return None if point is None else replace(fit, z=point.z, J=point.J, derived_at=fit.x)


def _promising(
    problem: NetworkProblem, none: Fit, terms: Sequence[Term], columns: Mapping[str, Array], runs: Runs
) -> list[Fit]:
    """The effects that promise more evidence than ``none``, at most FEW, refitted. columns : of the terms there."""
    without, gained = promised(none, terms, columns)
    best = [(term,) for score, term in gained if score < without][: at.FEW]
    return there(problem.refit(best, none, runs, columns))


def _with_error(problem: NetworkProblem, fit: Fit, terms: Sequence[Term], runs: Runs) -> Approximate:
    """A hypothesis refitted with its model error."""
    whole = Several((problem,), ("",))
    ended = minimum(whole, fit, problem.rules, runs)
    if not ended.errors.any():
        return Approximate(ended.fit)
    (wide,) = networks(granted(whole, ended.errors))
    (seen,) = wide.restated([ended.fit], problem)
    seen = replace(seen, log_volume=wide.target.log_volume - problem.target.log_volume)
    cost = PART * float(np.count_nonzero(ended.errors))
    beside = Beside(seen, np.asarray(wide.model_error), cost)
    return Approximate(ended.fit, with_errors(weighed(problem, ended.fit, terms), beside))


def _moved(found: Compared, each: Sequence[Approximate]) -> Compared:
    """The comparison with hypotheses at the points that they have with their model errors, most probable first."""
    best = dict[str, Named]()
    for a in sorted(each, key=lambda a: a.score):
        exact = weighed(found.problem, a.fit, found.terms)
        best.setdefault(exact.key, exact)
    none = best.pop("", found.none)
    return replace(found, none=none, ranked=apart([*best.values(), *(n for n in found.ranked if n.key not in best)]))
