"""The source map: the places of a network where the model lacks something, found before any effect is named.

    D_k = F_k(θ, g) - X_k,    k = 0 … K,    all channels,

is the residual of the full nonlinear harmonic balance F with the subject's own parameters θ and sources g_p(t). Places
(:mod:`~fitting.inference.places`) are added, swapped and dropped while the evidence of the linear problem about the
present point (:mod:`~fitting.inference.source_maps.source_evidence`) increases, and θ and g move to their most probable
values.

The order matters (annealing). The model first has an error of LEVELS[0] of the pulse in every channel, which keeps θ
within its likely range; then the error shrinks. Walls fitted to the noise at once would be distorted and absorb the
sources.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from solver.errors import InputError
from solver.quantities.units import INFLOW

from ..fit import Fit
from ..model_discrepancy import Beside, settled
from ..models.network import NetworkProblem
from ..places import Place
from ..runs import OutOfTime, Runs
from ..unknown import Array, Unknown
from .place_model import CLOSELY, MOST, SETTLED, Active, PlaceModel, Point, normal_size, slices, with_signals
from .source_evidence import PRICE, Law

LEVELS = (0.2, 0.05, 0.015, 0.003, 0.0)  # model error at each stage, as a fraction of every channel's pulse
_WORSE = 1.5  # a step that raises chi2 by more than this factor is shortened
_SHORTER = 0.35
_BACK = 6  # times at most
_ADVANCES = 4
_NO_ANSWER = (InputError, np.linalg.LinAlgError)  # small waves have no steady state or no start


@dataclass(frozen=True)
class Signal:
    """The source at a place. g : (K+1, q) harmonics of its sources [SI], sd : (K+1, q) standard deviations of their
    real and imaginary parts; empty for an outlying parameter. law : prior of its harmonics; None for an outlying
    parameter."""

    place: Place
    g: Array
    sd: Array
    law: Law | None = None


@dataclass(frozen=True)
class Rival:
    """Other sets of places with nearly the same evidence, and by how much their -2 ln evidence is larger."""

    places: tuple[Place, ...]
    above: float


@dataclass(frozen=True)
class SourceMap:
    """The places where something acts.

    signals : at the most probable places. x : (p,) the subject's own parameters there, of ``unknowns``. score : -2 ln
    evidence. rivals : best first. chi2 : of the residual, of n data. J : (K+1, m, p) derivatives.
    """

    signals: tuple[Signal, ...]
    unknowns: tuple[Unknown, ...]
    x: Array
    score: float
    chi2: float
    n: int
    rivals: tuple[Rival, ...]
    J: Array

    @property
    def places(self) -> tuple[Place, ...]:
        return tuple(s.place for s in self.signals)

    @property
    def explains(self) -> bool:
        """True if it leaves only noise."""
        return is_noise(self.chi2, self.n)

    def standing_out(self, which: Sequence[int]) -> SourceMap:
        """The map with the outlying parameters of some places; those of other places are set to 0."""
        kept = {self.places[i].name for i in which}
        gone = {p.unknown.name for p in self.places if p.unknown is not None and p.name not in kept}
        return replace(
            self, x=np.array([0.0 if u.name in gone else x for u, x in zip(self.unknowns, self.x, strict=True)])
        )

    def forced(self, problem: NetworkProblem, which: Sequence[int]) -> NetworkProblem:
        """The problem with the sources of some places in its equations."""
        return with_signals(problem, [(self.signals[i].place, self.signals[i].g) for i in which])


def source_map(problem: NetworkProblem, runs: Runs | None = None) -> SourceMap:
    """The map of a record; after the deadline of ``runs`` the best so far.

    Raises InputError if the model as given has no periodic beat with this record, OutOfTime before that is known.
    """
    work = _Search(problem, runs or Runs())
    found = [work.annealed(LEVELS)]
    if not is_noise(
        work.model.chi2(found[0].D), normal_size(found[0])
    ):  # a wide error may have admitted wrong places first
        with suppress(OutOfTime):
            found.append(work.annealed(LEVELS[1:]))
    return min((work.told(point) for point in found), key=lambda m: m.score)  # the scores have no model error


def is_noise(chi2: float, n: int) -> bool:
    """True if chi2 of n data is at most three of its standard deviations above n."""
    return chi2 < n + 3.0 * math.sqrt(2.0 * n)


class _Search:
    """One search for places."""

    def __init__(self, problem: NetworkProblem, runs: Runs) -> None:
        self.model = PlaceModel(problem, runs)
        self.none = np.zeros((problem.K + 1, 0), complex)

    def advanced(self, point: Point, error: float, fresh: bool) -> Point:
        """One step to the most probable θ and g, shortened if it raises χ² too much. fresh : with derivatives and
        weights at the present point."""
        if fresh:
            self.model.update_weights(point.x)
        normal = self.model.normal(point, error)
        point = self.model.with_evidence(normal, point)
        x, g = self.model.most_probable(normal, point)
        enough = max(_WORSE * self.model.chi2(point.D, error), 3.0 * 2.0 * point.D.size)
        for _ in range(_BACK):
            there = self.model.simulated(replace(point, x=x, g=g))
            if there is not None and self.model.chi2(there.D, error) < enough:
                there = self.model.linearised(there) if fresh else there
                if there is not None:
                    return there
            x, g = (_SHORTER * a + (1.0 - _SHORTER) * b for a, b in ((x, point.x), (g, point.g)))
        return point

    # --- the search ---------------------------------------------------------------------------------------------------

    def annealed(self, levels: Sequence[float]) -> Point:
        """Add, swap and drop places while the model error shrinks."""
        model, rest = self.model, np.zeros(len(self.model.unknowns))
        widths = {u.group: 1.0 for u in model.unknowns if u.group and not u.stated}
        nothing = np.zeros(0)  # placeholder: simulated next
        point = model.simulated(Point((), rest, self.none, widths, nothing, nothing, nothing))
        point = point and model.linearised(point)
        if point is None:
            raise InputError(
                f"network {model.problem.network.name}: as given it has no beat that repeats with this inflow; check "
                f"the unit of {INFLOW}, or its outlets."
            )
        with suppress(OutOfTime):
            for error in levels:
                point = self.advanced(point, error, True)
                for _ in range(MOST + 2):
                    moved = self.moved(point, error)
                    if moved is None:
                        break
                    point = moved
                    for _ in range(2):
                        point = self.advanced(point, error, False)
                point = self.settled(point, error)
            point = self.settled(self.advanced(point, 0.0, True), 0.0)
            point = self.pruned(self.improved(point))
        return point

    def improved(self, point: Point) -> Point:
        """Add moves that pay only after θ has settled, while each increases the evidence."""
        for _ in range(MOST):
            moved = self.moved(point, 0.0)
            if moved is None:
                break
            there = self.settled(self.advanced(moved, 0.0, True), 0.0)
            if there.score > point.score - SETTLED:
                break
            point = there
        return point

    def settled(self, point: Point, error: float) -> Point:
        """Step until the evidence is stationary; in the end with new derivatives while more than noise is left."""
        for _ in range(_ADVANCES if error < LEVELS[1] else 1):
            fresh = error == 0.0 and not is_noise(self.model.chi2(point.D), normal_size(point))
            before, point = point.score, self.advanced(point, error, fresh)
            if abs(before - point.score) < SETTLED:
                break
        return point

    def with_places(self, point: Point, active: Sequence[Active]) -> Point:
        """The same point with other places; the sources of new ones are 0."""
        old = {a.place.key: point.g[:, own] for a, own in zip(point.active, slices(point.active), strict=True)}
        g = [old.get(a.place.key, np.zeros((len(self.none), a.place.columns), complex)) for a in active]
        return replace(point, active=tuple(active), g=np.concatenate([self.none, *g], axis=1))

    def moved(self, point: Point, error: float) -> Point | None:
        """The point after the move with the largest gain of evidence; None if no move is worth its price."""
        normal = self.model.normal(point, error)
        point = self.model.with_evidence(normal, point)
        best = self.model.best_move(normal, point)
        if best is None:
            return None
        # sources of kept places start from their values; the next step compensates those removed
        return self.resimulated(self.with_places(point, best[1]))

    def resimulated(self, point: Point) -> Point:
        """The same point with its residual; with the former one if it cannot be simulated."""
        return self.model.simulated(point) or point

    def pruned(self, point: Point) -> Point:
        """Drop places that are not worth their price after a refit."""
        for _ in range(len(point.active)):
            normal = self.model.normal(point, 0.0)
            without = [(*point.active[:i], *point.active[i + 1 :]) for i in range(len(point.active))]
            scores = [self.model.inferred(normal, rest, point.widths, point.x)[0] for rest in without]
            if not scores or min(scores) > point.score + self.model.worth:  # linear estimate; a refit decides
                break
            rest = self.with_places(point, without[int(np.argmin(scores))])
            fewer = self.settled(self.advanced(self.resimulated(rest), 0.0, True), 0.0)
            if fewer.score > point.score:
                break
            point = fewer
        return point

    # --- the result ---------------------------------------------------------------------------------------------------

    def told(self, point: Point) -> SourceMap:
        """The map of a point, under its weights; without places that had no size yet when time ran out."""
        sized = [a for a, own in zip(point.active, slices(point.active), strict=True)
                 if a.law is None or point.g[:, own].any()]  # fmt: skip
        point = self.with_places(point, sized)
        point = self.model.answered(point) or point
        self.model.update_weights(point.x)
        normal = self.model.normal(point, 0.0)
        point = self.model.with_evidence(normal, point)
        active = point.active
        columns, signals = self.model.columns_of(active), []
        sd = np.zeros_like(point.g, float)
        if len(columns):
            sd = normal.amplitudes(columns, self.model.variance(active), point.x, self.model.spread(normal, point))[1]
        for a, own in zip(active, slices(active), strict=True):
            units = self.model.units[columns[own]]
            signals.append(Signal(a.place, point.g[:, own] * units, sd[:, own] * units, a.law))
        others = [*self.model.looked(normal, active, point, MOST), *self.model.without_each(normal, point, CLOSELY)]
        rivals = [Rival(tuple(a.place for a in other), s - point.score) for s, other in others]
        return SourceMap(
            signals=tuple(signals),
            unknowns=self.model.unknowns_of(active),
            x=point.x,
            score=point.score,
            chi2=self.model.chi2(point.D),
            n=normal_size(point),
            rivals=tuple(sorted(rivals, key=lambda r: r.above)),
            J=point.J,
        )


# --- model discrepancy of a hypothesis: free sources at places, integrated out of its evidence ------------------------
#
#     C'_k = C_k + Σ_p G_pk v_pk G_pkᴴ
#
# is the covariance of the channels with sources of variances v at places p. This model error has only patterns that
# waves can carry. The places are selected by the evidence of the linear problem about the hypothesis, or are those of
# the map.


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
    nothing = np.zeros(0)  # placeholder: simulated next
    point = model.simulated(Point(active, found.x, g, {}, nothing, found.J, nothing))
    if point is None:
        return None
    try:
        point = replace(point, G=model.responses(found.x))
    except _NO_ANSWER:
        return None
    # in the linear model: without the sources
    residual = point.D - np.einsum("kms,ks->km", point.G[:, :, columns], g)
    z, J = problem.target.whiten(residual[..., None])[:, 0], problem.target.whiten(found.J)
    fit = replace(none, x=found.x, z=z, J=J, log_volume=0.0)
    return _integrated_out(model, point, fit)


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
