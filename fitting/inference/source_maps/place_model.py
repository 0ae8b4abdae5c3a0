"""The places of a record as a model: simulations with sources at places, and the evidence of these.

Everything refers to one point of a search (:mod:`~fitting.inference.source_maps.source_map`): the residual of the full
balance, its derivatives, and the linear problem of all places about it.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.laws.effect import small_wave_impedance
from solver.mesh.sources import Source
from solver.periodic.harmonic_balance import NoSteadyState
from solver.periodic.small_waves import source_responses

from ...records.channels.noise import pulses
from ..fit import Array, Member
from ..gauss_newton import Trial
from ..hierarchy import APART, Linear, beforehand
from ..hypothesis import PlacedEffect, rewired
from ..models.network import NetworkProblem
from ..models.simulator import Forced, filters
from ..places import Place, places
from ..runs import Runs
from ..unknown import Unknown, bounds, parameter_values, precisions
from .source_evidence import FIRST_LOOK, PRICE, Law, Normal, marginal

Move = tuple[float, tuple["Active", ...]]  # -2 ln evidence, and the active places

MOST = 3  # active places at once
CLOSELY = 14  # places of the first screening that are inferred in full
SETTLED = 0.3  # of -2 ln evidence: a smaller change counts as none
_UNIT = 0.01  # of a pulse: the unit of the sources
_SWEEPS = 3  # of alternating estimates of amplitudes and widths
_FARTHEST = 20.0  # stated spreads: bound on the deviation of a parameter


@dataclass(frozen=True)
class Active:
    """An active place with the prior of its harmonics; None for an outlying parameter."""

    place: Place
    law: Law | None = None


@dataclass(frozen=True)
class Point:
    """A point of the search: active places, θ : (p,), g : (K+1, q) of all their sources; widths. Its linearisation:
    D : (K+1, m), J : (K+1, m, p) and G : (K+1, m, S) of all places."""

    active: tuple[Active, ...]
    x: Array
    g: Array
    widths: Mapping[str, float]
    D: Array
    J: Array
    G: Array
    score: float = math.inf


class PlaceModel:
    """Simulation and inference for the places of a record, beside the effects ``terms``. unknowns : of a hypothesis
    that narrows some; by default those of the problem."""

    def __init__(
        self, problem: NetworkProblem, runs: Runs, terms: Sequence[PlacedEffect] = (), unknowns: Sequence[Unknown] = ()
    ) -> None:
        self.problem, self.runs, self.terms = problem, runs, tuple(terms)
        self.unknowns = tuple(unknowns) or problem.hypothesis(self.terms)
        self.places = places(problem.network, problem.signals, self.unknowns)
        self.worth = 2.0 * math.log(len(self.places))  # all places are equally likely a priori
        ends = np.cumsum([p.columns for p in self.places])
        self.columns = {p.key: np.arange(e - p.columns, e) for p, e in zip(self.places, ends, strict=True)}
        pulse = dict(zip(problem.signals, _UNIT * pulses(problem.beats, problem.signals), strict=True))
        pressure, flow = _units(problem)
        self.units = np.concatenate([
            [pressure if s.unit == "Pa" else flow for s in p.sources] if p.sources or p.channel is None
            else [pulse[p.channel]] for p in self.places
        ])  # fmt: skip
        self.low, self.high = (np.clip(b, -_FARTHEST, _FARTHEST) for b in bounds(self.unknowns))
        self.volume = problem.target.log_volume  # reference of ln det C
        self.sd0 = np.array([1.0 if p == 0.0 else p**-0.5 for p in precisions(self.unknowns)])

    def update_weights(self, x: Array) -> None:
        """Update the weights of the record to the response to inflow noise at the parameters x : (p,), which may be far
        from the file's. The data stay: the correction for variable beats is not recomputed."""
        self.problem = self.problem.at(self.terms, self.unknowns, x)

    # --- simulation ---------------------------------------------------------------------------------------------------

    def columns_of(self, active: Sequence[Active]) -> Array:
        found = [self.columns[a.place.key] for a in active]
        return np.concatenate(found) if found else np.zeros(0, int)

    def _forced(self, point: Point) -> tuple[NetworkProblem, Member]:
        """The problem with the sources of a point in its equations, and its parameters."""
        g = point.g * self.units[self.columns_of(point.active)]
        signals = [(a.place, g[:, own]) for a, own in zip(point.active, slices(point.active), strict=True)]
        return with_signals(self.problem, signals), Member(self.terms, self.unknowns, point.x)

    def simulated(self, point: Point) -> Point | None:
        """The same point with its residual; None if it cannot be simulated."""
        problem, member = self._forced(point)
        (X,) = problem.observe([member], self.runs)
        return None if X is None else replace(point, D=X - self.problem.target.X)

    def linearised(self, point: Point) -> Point | None:
        """The same point with its derivatives by the unknowns and the responses to sources; None if it has none."""
        problem, member = self._forced(point)
        (found,) = problem.linearised([Trial(member, np.arange(len(member.x)), None, 0.0 * member.x)], self.runs)
        return None if found is None else self.answered(replace(point, J=found[1]))

    def answered(self, point: Point) -> Point | None:
        """The same point with the responses to sources there; None if it has none."""
        try:
            return replace(point, G=self.responses(point.x))
        except (NoSteadyState, np.linalg.LinAlgError):
            return None

    def responses(self, x: Array) -> Array:
        """G : (K+1, m, S) small-wave responses to the sources of all places, in their units."""
        p, s = self.problem, self.problem.simulator
        network = rewired(s.network, self.terms)
        at = {name: float(value) for name, value in parameter_values(self.unknowns, network, x).items()}
        sources = [source for place in self.places for source in place.sources]
        physical = np.concatenate([self.columns[q.key] for q in self.places if q.sources])
        G = np.zeros((p.K + 1, len(p.signals), len(self.units)), complex)
        found = source_responses(network, p.signals, p.K, sources, self.units[physical], s.drive, s.T,
                                 parameters=at, settings=s.settings)  # fmt: skip
        G[:, :, physical] = np.moveaxis(found * filters(network, p.signals, s.T, p.K), 0, -1)
        for place in self.places:
            if place.channel is not None and not place.sources:
                column = self.columns[place.key][0]
                G[:, p.signals.index(place.channel), column] = self.units[column]
        return G

    # --- inference at a point -----------------------------------------------------------------------------------------

    def normal(self, point: Point, error: float) -> Normal:
        """The linear problem about a point, with a given model error."""
        target = self.problem.granted(error).target
        y = point.D - point.J @ point.x - np.einsum("kms,ks->km", point.G[:, :, self.columns_of(point.active)], point.g)
        normal = Normal.of(target.whitener, y, point.J, point.G)
        return replace(normal, log_volume=target.log_volume - self.volume)

    def unknowns_of(self, active: Sequence[Active]) -> tuple[Unknown, ...]:
        """The unknowns; outliers have priors of their own."""
        apart = {a.place.unknown.name for a in active if a.place.unknown is not None}
        return tuple(u.set_apart() if u.name in apart else u for u in self.unknowns)

    def sd(self, active: Sequence[Active], widths: Mapping[str, float]) -> Array:
        """(p,) standard deviations of the priors."""
        return np.array([
            widths.get(u.group, 1.0) if u.group and not u.stated else s
            for u, s in zip(self.unknowns_of(active), self.sd0, strict=True)
        ])  # fmt: skip

    def variance(self, active: Sequence[Active]) -> Array:
        """(K+1, q) prior variances of the sources of places."""
        K = self.problem.K
        found = [a.law.variance(K, a.place.relative) for a in active if a.law is not None]
        return np.concatenate(found, axis=1) if found else np.zeros((K + 1, 0))

    def inferred(
        self, normal: Normal, active: tuple[Active, ...], widths: Mapping[str, float], x: Array, sweeps: int = _SWEEPS
    ) -> tuple[float, tuple[Active, ...], Mapping[str, float]]:
        """-2 ln of evidence and prior of places, with the amplitudes and widths that maximise the evidence. ∞ if the
        places absorb the response to a law completely, so that its size is undetermined."""
        best, unknowns = math.inf, self.unknowns_of(active)
        normal, columns = normal.only(self.columns_of(active)), slices(active)
        for _ in range(sweeps):
            for i, a in enumerate(active):
                if a.law is not None:
                    others = [j for j in range(len(active)) if j != i]
                    beside = np.concatenate([columns[j] for j in others]) if others else np.zeros(0, int)
                    reduced = normal.without(beside, self.variance([active[j] for j in others]))
                    own, relative = columns[i][None], np.array([a.place.relative])
                    ((_, law),) = reduced.best_laws(own, relative, self.sd(active, widths))
                    active = (*active[:i], replace(a, law=law), *active[i + 1 :])
            reduced = normal.without(np.arange(sum(map(len, columns))), self.variance(active))
            try:
                found = Linear(reduced.of_unknowns, x, unknowns, reduced.log_volume).inferred()
            except np.linalg.LinAlgError:
                return math.inf, active, widths
            widths, before, best = found.of, best, min(best, found.score)
            if before - best < SETTLED or not any(a.law for a in active):
                break
        return best + PRICE * sum(a.law is not None for a in active) + self.worth * len(active), active, widths

    def with_evidence(self, normal: Normal, point: Point) -> Point:
        """A point with its inferred amplitudes, widths and evidence."""
        score, active, widths = self.inferred(normal, point.active, point.widths, point.x)
        return replace(point, active=active, widths=widths, score=score)

    def _precision(self, normal: Normal, point: Point) -> tuple[Array, Array, Array]:
        """Standard deviations (p,) of the priors of θ, and in their units the precision (p, p) and gradient (p,) of the
        posterior at 0, with sources integrated out."""
        reduced = normal.without(self.columns_of(point.active), self.variance(point.active)).of_unknowns
        sd = self.sd(point.active, point.widths)
        return sd, np.eye(len(sd)) + sd[:, None] * reduced[:-1, :-1] * sd, sd * reduced[:-1, -1]

    def spread(self, normal: Normal, point: Point) -> Array:
        """(p, p) posterior covariance of θ."""
        sd, A, _ = self._precision(normal, point)
        return sd[:, None] * np.linalg.inv(A) * sd

    def most_probable(self, normal: Normal, point: Point) -> tuple[Array, Array]:
        """The most probable θ, and g of a point's places."""
        sd, A, gradient = self._precision(normal, point)
        x = np.clip(-sd * np.linalg.solve(A, gradient), self.low, self.high)
        columns = self.columns_of(point.active)
        if not len(columns):
            return x, np.zeros((self.problem.K + 1, 0), complex)
        return x, normal.amplitudes(columns, self.variance(point.active), x)[0]

    def chi2(self, D: Array, error: float = 0.0) -> float:
        """Σ |z|² of a residual."""
        z = self.problem.granted(error).target.whiten(D[..., None])
        return float((z**2).sum())

    # --- moves: add, drop or swap a place, by the evidence of the linear problem --------------------------------------

    def best_move(self, normal: Normal, point: Point) -> Move | None:
        """The move with the largest gain of evidence; None if no move is worth its price."""
        found = min(self._moves(normal, point), key=lambda move: move[0], default=(math.inf, point.active))
        return found if found[0] <= point.score - SETTLED else None

    def _moves(self, normal: Normal, point: Point) -> Iterator[Move]:
        """Additions; if these gain nothing, also removals and swaps."""
        adds = self.looked(normal, point.active, point, CLOSELY) if len(point.active) < MOST else []
        yield from adds
        if min((score for score, _ in adds), default=math.inf) > point.score - SETTLED:
            yield from self.without_each(normal, point, CLOSELY // 2)

    def without_each(self, normal: Normal, point: Point, closely: int) -> Iterator[Move]:
        """Removals and swaps of places."""
        same = {a.place.key for a in point.active}
        for i in range(len(point.active)):
            rest = (*point.active[:i], *point.active[i + 1 :])
            score, rest, _ = self.inferred(normal, rest, point.widths, point.x)
            yield score, rest
            for other in self.looked(normal, rest, point, closely):
                if {a.place.key for a in other[1]} != same:
                    yield other

    def looked(self, normal: Normal, active: tuple[Active, ...], point: Point, closely: int) -> list[Move]:
        """-2 ln evidence with one more place: all places for a few priors, then the best ones inferred in full."""
        sd = self.sd(active, point.widths)
        reduced = normal.without(self.columns_of(active), self.variance(active))
        there, quick = {a.place.key for a in active}, list[tuple[float, Active]]()
        alike = defaultdict[int, list[Place]](list)  # by the number of columns
        for place in (p for p in self.places if p.key not in there):
            if place.unknown is None:
                alike[place.columns].append(place)
                continue
            wider = np.tile(sd, (len(APART), 1))
            wider[:, self.unknowns.index(place.unknown)] = APART
            score = float(marginal(reduced.of_unknowns, wider).min()) + reduced.log_volume
            quick.append((score + beforehand(APART[0], True), Active(place)))
        for some in alike.values():
            columns, relative = np.stack([self.columns[p.key] for p in some]), np.array([p.relative for p in some])
            laws = reduced.best_laws(columns, relative, sd, *FIRST_LOOK)
            quick += [(score + PRICE, Active(p, law)) for p, (score, law) in zip(some, laws, strict=True)]
        quick.sort(key=lambda each: each[0])
        found = []
        for _, added in quick[:closely]:
            score, both, _ = self.inferred(normal, (*active, added), point.widths, point.x, 1)
            found.append((score, both))
        return sorted(found, key=lambda each: each[0])


def with_signals(problem: NetworkProblem, signals: Sequence[tuple[Place, Array]]) -> NetworkProblem:
    """A problem whose simulations contain sources at some places, with harmonics (K+1, q) [SI] each. It uses harmonic
    balance only: without a balance there is no time stepping, which takes a hundred times as long."""
    sources, amplitudes = list[Source](), list[Array]()
    spectra = np.zeros((problem.K + 1, len(problem.signals)), complex)
    for place, g in signals:
        if place.sources:
            sources += place.sources
            amplitudes += list(g.T)
        elif place.channel is not None:
            spectra[:, problem.signals.index(place.channel)] += g[:, 0]
    forced = Forced(tuple(sources), np.stack(amplitudes, axis=1) if sources else np.zeros((1, 0)), spectra)
    return replace(problem, simulator=replace(problem.simulator, forced=forced))


def slices(active: Sequence[Active]) -> list[Array]:
    """The columns of every place, numbered over all active places."""
    ends = np.cumsum([a.place.columns for a in active])
    return [np.arange(end - a.place.columns, end) for a, end in zip(active, ends, strict=True)]


def normal_size(point: Point) -> int:
    """The number of real data of a record."""
    return point.D.shape[1] * (2 * len(point.D) - 1)


def _units(problem: NetworkProblem) -> tuple[float, float]:
    """Units of pressure sources [Pa] and flow sources [m³/s]: a fraction of the inflow's pulse, times the impedance of
    the first segment for pressures."""
    inflow = problem.simulator.drive.X
    flow = _UNIT * math.sqrt(2.0 * float((np.abs(inflow[1:]) ** 2).sum()))
    network = problem.network
    return small_wave_impedance(network, network.segment(network.inlet.segment)) * flow, flow
