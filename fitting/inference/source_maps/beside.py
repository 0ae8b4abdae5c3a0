"""Model discrepancy of a network hypothesis: free sources at places, integrated out of its evidence.

    C'_k = C_k + Σ_p G_pk v_pk G_pkᴴ

is the covariance of the channels with sources of variances v at places p
(:mod:`~fitting.inference.source_maps.place_model`). This model error has only patterns that waves can carry. The places
are selected by the evidence of the linear problem about the hypothesis, or are those of the source map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver.errors import InputError

from ..fit import Fit
from ..model_discrepancy import Beside, settled
from ..models.network import NetworkProblem
from ..runs import Runs
from .place_model import MOST, Active, PlaceModel, Point
from .source_evidence import PRICE
from .source_map import SourceMap

_NO_ANSWER = (InputError, np.linalg.LinAlgError)  # small waves have no steady state or no start


def found_beside(problem: NetworkProblem, fit: Fit) -> Beside | None:
    """The model discrepancy at the places that the evidence of the linear problem about a fit selects.

    None if it selects none, or only outlying parameters, which belong to this subject. None also if the small waves
    have no solution: the fit is then at the limit of the equations.
    """
    model = PlaceModel(problem, Runs(), fit.terms, fit.unknowns)
    nothing = np.zeros((problem.K + 1, 0), complex)
    widths: Mapping[str, float] = {u.group: 1.0 for u in fit.unknowns if u.group}
    D, J = (problem.target.unwhiten(a) for a in (fit.z[:, None], fit.J))
    try:
        point = Point((), fit.x, nothing, widths, D[..., 0], J, model.responses(fit.x))
    except _NO_ANSWER:
        return None
    normal = model.normal(point, 0.0)
    for _ in range(MOST + 2):
        point = model.with_evidence(normal, point)
        move = model.best_move(normal, point)
        if move is None:
            break
        point = replace(point, active=move[1])
    return _integrated_out(model, point, fit) if any(a.law for a in point.active) else None


def map_beside(problem: NetworkProblem, none: Fit, found: SourceMap, runs: Runs) -> Beside | None:
    """The subject of the source map with its free sources; None if it cannot be simulated, or if the small waves have
    no solution. none : gives order and signal; its x, z and J are replaced."""
    model = PlaceModel(problem, runs)
    active = tuple(Active(s.place, s.law) for s in found.signals)
    columns = model.columns_of(active)
    g = np.concatenate([s.g for s in found.signals], axis=1) / model.units[columns]
    D = model.residual(active, found.x, g)
    if D is None:
        return None
    try:
        G = model.responses(found.x)
    except _NO_ANSWER:
        return None
    residual = D - np.einsum("kms,ks->km", G[:, :, columns], g)  # in the linear model: without the sources
    z, J = problem.target.whiten(residual[..., None])[:, 0], problem.target.whiten(found.J)
    fit = replace(none, x=found.x, z=z, J=J, log_volume=0.0)
    return _integrated_out(model, Point(active, found.x, g, {}, D, found.J, G), fit)


def _integrated_out(model: PlaceModel, point: Point, fit: Fit) -> Beside:
    """The fit with sources at 0, and those of a point integrated out."""
    problem, own = model.problem, point.G[:, :, model.columns_of(point.active)]
    parts = np.where(np.arange(len(own)) == 0, 1.0, 2.0)[:, None, None]  # real and imaginary
    covariance = (own * parts * model.variance(point.active)[:, None]) @ own.conj().swapaxes(1, 2)
    covariance[0] = covariance[0].real
    wide = problem.widened(covariance)
    (fit,) = wide.restated([fit], problem)
    log_volume = fit.log_volume + wide.target.log_volume - problem.target.log_volume
    fit = replace(fit, unknowns=model.unknowns_of(point.active), log_volume=log_volume)
    cost = sum((PRICE if a.law else 0.0) + model.worth for a in point.active)
    return Beside(settled(fit), covariance, cost, tuple(a.place for a in point.active))
