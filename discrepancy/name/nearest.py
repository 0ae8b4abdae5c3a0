"""The best model without effect if much is missing; every named effect must fit better than this model.

The map of a wrong model distorts the walls, and a search from these may end far from the record. So may the one linear
step that takes a hypothesis to the last weights. Any effect then seems to close a part of the gap of a bad fit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fitting.calibrate.first_search import FAR
from fitting.inference.fit import Fit
from fitting.inference.models.from_afar import from_afar, left_of_pulsation
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs

from .. import thresholds as at
from .scoring import Compared, exact, there


def nearest(found: Compared, runs: Runs) -> Fit | None:
    """The network without effect of lowest cost, refitted from its present point and, with a shrinking model error,
    from the file's values. None if the present fit leaves so little of the pulsation that its minimum is right."""
    problem, none = found.problem, found.none
    if none.explains or not isinstance(problem, NetworkProblem):
        return None
    (X,) = problem.observe([none.fit.member], runs)
    if X is not None and np.sqrt(np.mean(left_of_pulsation(problem, problem.residual(X)) ** 2)) <= FAR:
        return None
    fits = there([*problem.refine([none.fit], runs), from_afar(problem, none.fit.unknowns, runs)])
    return min(fits, key=lambda f: f.cost, default=None)


def compared_with(found: Compared, near: Fit, runs: Runs) -> Iterator[Compared]:
    """The comparison with the nearest model without effect, and with the best effects refitted from it. The latter are
    skipped if its outliers are bounded, as these are beside the effects that replace them."""
    yield (found := _with_none(found, near))
    if near.unknowns != tuple(found.problem.hypothesis(())):
        return
    plain = [n.fit.terms for n in found.ranked if set(n.fit.terms) <= set(found.terms)]  # refined laws start from these
    beside = found.problem.refit(plain[: at.FEW], near, runs)
    again = exact(found.problem, [*found.fits, *there(beside)], found.columns, found.terms, runs)
    (fit,) = again.problem.refine(again.problem.restated([near], found.problem), runs)
    yield again if fit is None else _with_none(again, fit)


def _with_none(found: Compared, none: Fit) -> Compared:
    """The same comparison with another fit without effect."""
    return Compared.of(found.problem, [none, *(n.fit for n in found.ranked)], found.columns, found.terms)
