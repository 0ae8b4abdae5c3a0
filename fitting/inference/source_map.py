"""The source map: where in a network something acts that the model lacks, before anybody asks what it is.

    D_k = F_k(θ, g) - X_k,    k = 0 … K,    all channels,

is the residual of the full nonlinear harmonic balance F with the animal's own numbers θ and sources g_p(t) in it.
Places (:mod:`~fitting.inference.places`) are added, swapped and dropped while the evidence of the linear problem about
the present point (:mod:`~fitting.inference.source_evidence`) says so, and θ and g move to where they are most probable.

What decides is the order: first the model is granted an error of every channel, of LEVELS[0] of its pulse, under which
θ moves no further than it is likely to; then less and less. Walls fitted to the noise at once would bend, and take up
what is missing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.balance import NoSteadyState
from solver.small_waves import source_responses
from solver.sources import Source

from ..records.noise import pulses
from .fit import Member
from .hierarchy import APART, Linear, beforehand
from .network import NetworkProblem
from .places import Place, places
from .simulator import Forced, Runs
from .source_evidence import FIRST_LOOK, PRICE, Law, Normal, marginal
from .unknown import Unknown, bounds, finite_steps, parameter_values, precisions

Array = np.ndarray

LEVELS = (0.2, 0.05, 0.015, 0.003, 0.0)  # of every channel's pulse: the error that the model is granted
MOST = 3  # places at once
_STEP = 0.02  # of x: finite differences
_UNIT = 0.01  # of a pulse: the sources' units
_CLOSELY = 14  # places that are looked at closely, of all
_SWEEPS = 3  # over amplitudes and widths in turn
_SETTLED = 0.3  # of -2 ln evidence: less is no change
_WORSE = 1.5  # times chi2 after a step: it is shortened
_SHORTER = 0.35
_BACK = 6  # times at most
_FARTHEST = 20.0  # stated spreads that a number may be off
_ADVANCES = 4


@dataclass(frozen=True)
class Active:
    """A place in which something acts, with how large it is beforehand; None of a number that stands out."""

    place: Place
    law: Law | None = None


@dataclass(frozen=True)
class Signal:
    """What acts at a place. g : (K+1, q) harmonics of its sources in ``units``, sd : (K+1, q) their standard
    deviations; of a number that stands out no harmonics."""

    place: Place
    g: Array
    sd: Array
    units: tuple[float, ...]


@dataclass(frozen=True)
class Rival:
    """Other places that nearly do: those that act, and by how much -2 ln of their evidence is more."""

    places: tuple[Place, ...]
    above: float


@dataclass(frozen=True)
class SourceMap:
    """Where something acts.

    signals : of the most probable places. x : (p,) the animal's own numbers there, of ``unknowns``. widths : of their
    groups. score : -2 ln evidence. rivals : best first. chi2 : what is left, of n data. J : (K+1, m, p) derivatives.
    """

    signals: tuple[Signal, ...]
    unknowns: tuple[Unknown, ...]
    x: Array
    widths: Mapping[str, float]
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
        """Whether it leaves noise alone."""
        return is_noise(self.chi2, self.n)

    def forced(self, problem: NetworkProblem, which: Sequence[int]) -> NetworkProblem:
        """The problem with some of the signals in it."""
        return with_signals(problem, [(self.signals[i].place, self.signals[i].g) for i in which])


@dataclass(frozen=True)
class _Point:
    """Where the search is: active places, θ : (p,), g : (K+1, q) of all their sources; widths. Where it is linearised,
    D : (K+1, m), J : (K+1, m, p) and G : (K+1, m, S) of all places."""

    active: tuple[Active, ...]
    x: Array
    g: Array
    widths: Mapping[str, float]
    D: Array
    J: Array
    G: Array
    score: float = math.inf


def source_map(problem: NetworkProblem, runs: Runs | None = None) -> SourceMap:
    """The map of a record. Raises NonPhysicalState and ValueError as the balance of the model as given, OutOfTime after
    the deadline."""
    work = _Work(problem, runs or Runs())
    found = [work.annealed(LEVELS)]
    if not is_noise(work.chi2(found[0].D), normal_size(found[0])):  # what is cheap at a wide error may have come first
        found.append(work.annealed(LEVELS[1:]))
    return work.told(min(found, key=lambda point: point.score))


def is_noise(chi2: float, n: int) -> bool:
    """Whether chi2 of n data is no more than chance: three of its standard deviations above n."""
    return chi2 < n + 3.0 * math.sqrt(2.0 * n)


class _Work:
    """One search: the places of a record, and how they are simulated and compared."""

    def __init__(self, problem: NetworkProblem, runs: Runs) -> None:
        self.problem, self.runs = problem, runs
        self.unknowns = problem.hypothesis(())
        self.places = places(problem.network, problem.signals, self.unknowns)
        self.worth = 2.0 * math.log(len(self.places))  # any place is as likely beforehand
        ends = np.cumsum([p.columns for p in self.places])
        self.columns = {p.key: np.arange(e - p.columns, e) for p, e in zip(self.places, ends, strict=True)}
        pulse = pulses(problem.beats, problem.signals)
        pressure, flow = _units(problem)
        self.units = np.concatenate([self._units_of(p, pressure, flow, pulse) for p in self.places])
        self.low, self.high = (np.clip(b, -_FARTHEST, _FARTHEST) for b in bounds(self.unknowns))
        self.sd0 = np.array([1.0 if p == 0.0 else p**-0.5 for p in precisions(self.unknowns)])

    def _units_of(self, place: Place, pressure: float, flow: float, pulse: Array) -> Array:
        if place.channel is not None and not place.sources:
            return np.array([_UNIT * pulse[self.problem.signals.index(place.channel)]])
        return np.array([pressure if s.unit == "Pa" else flow for s in place.sources])

    # --- simulation ---------------------------------------------------------------------------------------------------

    def _columns(self, active: Sequence[Active]) -> Array:
        found = [self.columns[a.place.key] for a in active]
        return np.concatenate(found) if found else np.zeros(0, int)

    def _forced(self, active: Sequence[Active], g: Array) -> NetworkProblem:
        """The problem with sources in it."""
        sized = g * self.units[self._columns(active)]
        return with_signals(
            self.problem, [(a.place, sized[:, own]) for a, own in zip(active, _slices(active), strict=True)]
        )

    def residual(self, active: Sequence[Active], x: Array, g: Array) -> Array | None:
        """D : (K+1, m); None without balance."""
        (X,) = self._forced(active, g).observe([Member((), self.unknowns, x)], self.runs)
        return None if X is None else X - self.problem.target.X

    def jacobian(self, active: Sequence[Active], x: Array, g: Array) -> Array | None:
        """J : (K+1, m, p); None where a member has no balance."""
        steps = finite_steps(self.unknowns, x, _STEP)
        at = np.concatenate([x[None], x + np.diag(steps)])
        found = self._forced(active, g).observe([Member((), self.unknowns, each) for each in at], self.runs)
        if any(X is None for X in found):
            return None
        X = np.stack([each for each in found if each is not None])
        return np.moveaxis((X[1:] - X[0]) / steps[:, None, None], 0, -1)

    def responses(self, x: Array) -> Array:
        """G : (K+1, m, S) of all places, in their units."""
        p, s = self.problem, self.problem.simulator
        at = {name: float(value) for name, value in parameter_values(self.unknowns, s.network, x).items()}
        sources = [source for place in self.places for source in place.sources]
        physical = np.concatenate([self.columns[q.key] for q in self.places if q.sources])
        G = np.zeros((p.K + 1, len(p.signals), len(self.units)), complex)
        found = source_responses(s.network, p.signals, p.K, sources, self.units[physical], s.drive, s.T,
                                 parameters=at, settings=s.settings)  # fmt: skip
        G[:, :, physical] = np.moveaxis(found, 0, -1)
        for place in self.places:
            if place.channel is not None and not place.sources:
                column = self.columns[place.key][0]
                G[:, p.signals.index(place.channel), column] = self.units[column]
        return G

    # --- inference at a point -----------------------------------------------------------------------------------------

    def normal(self, point: _Point, error: float) -> Normal:
        """The linear problem about a point, with an error granted to the model."""
        wide = self.problem.widened(np.full(len(self.problem.parts), error)) if error else self.problem
        y = point.D - point.J @ point.x - np.einsum("kms,ks->km", point.G[:, :, self._columns(point.active)], point.g)
        return Normal.of(wide.target.whitener, y, point.J, point.G)

    def unknowns_of(self, active: Sequence[Active]) -> tuple[Unknown, ...]:
        """The unknowns, those apart that stand out."""
        apart = {a.place.unknown.name for a in active if a.place.unknown is not None}
        return tuple(u.set_apart() if u.name in apart else u for u in self.unknowns)

    def sd(self, active: Sequence[Active], widths: Mapping[str, float]) -> Array:
        """(p,) of the priors."""
        return np.array([
            widths.get(u.group, 1.0) if u.group and not u.stated else s
            for u, s in zip(self.unknowns_of(active), self.sd0, strict=True)
        ])  # fmt: skip

    def variance(self, active: Sequence[Active]) -> Array:
        """(K+1, q) of the sources of places."""
        K = self.problem.K
        found = [a.law.variance(K, a.place.relative) for a in active if a.law is not None]
        return np.concatenate(found, axis=1) if found else np.zeros((K + 1, 0))

    def inferred(
        self, normal: Normal, active: tuple[Active, ...], widths: Mapping[str, float], x: Array, sweeps: int = _SWEEPS
    ) -> tuple[float, tuple[Active, ...], Mapping[str, float]]:
        """-2 ln evidence and prior of places, with the amplitudes and widths that make the record most probable."""
        best, unknowns = math.inf, self.unknowns_of(active)
        normal, columns = normal.only(self._columns(active)), _slices(active)
        for _ in range(sweeps):
            for i, a in enumerate(active):
                if a.law is not None:
                    others = [j for j in range(len(active)) if j != i]
                    beside = np.concatenate([columns[j] for j in others]) if others else np.zeros(0, int)
                    reduced = normal.without(beside, self.variance([active[j] for j in others]))
                    _, law = reduced.best_law(columns[i], a.place.relative, self.sd(active, widths))
                    active = (*active[:i], replace(a, law=law), *active[i + 1 :])
            reduced = normal.without(np.arange(sum(map(len, columns))), self.variance(active))
            found = Linear(reduced.of_unknowns, x, unknowns, reduced.log_volume).inferred()
            widths, before, best = found.of, best, min(best, found.score)
            if before - best < _SETTLED or not any(a.law for a in active):
                break
        return best + PRICE * sum(a.law is not None for a in active) + self.worth * len(active), active, widths

    def most_probable(self, normal: Normal, point: _Point) -> tuple[Array, Array]:
        """θ and g of a point's places."""
        reduced = normal.without(self._columns(point.active), self.variance(point.active)).of_unknowns
        sd = self.sd(point.active, point.widths)
        A = np.eye(len(sd)) + sd[:, None] * reduced[:-1, :-1] * sd
        x = np.clip(-sd * np.linalg.solve(A, sd * reduced[:-1, -1]), self.low, self.high)
        columns = self._columns(point.active)
        if not len(columns):
            return x, np.zeros((self.problem.K + 1, 0), complex)
        return x, normal.amplitudes(columns, self.variance(point.active), x)[0]

    # --- steps --------------------------------------------------------------------------------------------------------

    def linearised(self, point: _Point, fresh: bool) -> _Point | None:
        """The same point with what is simulated there; fresh : its derivatives by the unknowns, too."""
        D = self.residual(point.active, point.x, point.g)
        if D is None:
            return None
        J = self.jacobian(point.active, point.x, point.g) if fresh else point.J
        try:
            return None if J is None else replace(point, D=D, J=J, G=self.responses(point.x))
        except (NoSteadyState, np.linalg.LinAlgError):
            return None

    def chi2(self, D: Array, error: float = 0.0) -> float:
        """Σ |z|² of a residual."""
        wide = self.problem.widened(np.full(len(self.problem.parts), error)) if error else self.problem
        z = wide.target.whiten(D[..., None])
        return float((z**2).sum())

    def advanced(self, point: _Point, error: float, fresh: bool) -> _Point:
        """One step to the most probable θ and g; shortened where that makes the record less probable by far."""
        normal = self.normal(point, error)
        score, active, widths = self.inferred(normal, point.active, point.widths, point.x)
        point = replace(point, active=active, widths=widths, score=score)
        x, g = self.most_probable(normal, point)
        enough = max(_WORSE * self.chi2(point.D, error), 3.0 * 2.0 * point.D.size)
        for _ in range(_BACK):
            there = self.linearised(replace(point, x=x, g=g), fresh)
            if there is not None and self.chi2(there.D, error) < enough:
                return there
            x, g = (_SHORTER * a + (1.0 - _SHORTER) * b for a, b in ((x, point.x), (g, point.g)))
        return point

    # --- the search ---------------------------------------------------------------------------------------------------

    def annealed(self, levels: Sequence[float]) -> _Point:
        """Places added, swapped and dropped while the error granted to the model shrinks."""
        none = np.zeros((self.problem.K + 1, 0), complex)
        widths = {u.group: 1.0 for u in self.unknowns if u.group and not u.stated}
        D, J = self.residual((), np.zeros(len(self.unknowns)), none), np.zeros(0)
        assert D is not None
        begun = self.linearised(_Point((), np.zeros(len(self.unknowns)), none, widths, D, J, J), True)
        assert begun is not None
        point = begun
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
        return self.pruned(self.settled(self.advanced(point, 0.0, True), 0.0))

    def settled(self, point: _Point, error: float) -> _Point:
        """With steps until the evidence stays."""
        for _ in range(_ADVANCES if error < LEVELS[1] else 1):
            before, point = point.score, self.advanced(point, error, False)
            if abs(before - point.score) < _SETTLED:
                break
        return point

    def with_places(self, point: _Point, active: Sequence[Active]) -> _Point:
        """The same point with other places, what is new still 0."""
        old = {a.place.key: point.g[:, own] for a, own in zip(point.active, _slices(point.active), strict=True)}
        none = np.zeros((self.problem.K + 1, 0), complex)
        g = [old.get(a.place.key, np.zeros((len(none), a.place.columns), complex)) for a in active]
        return replace(point, active=tuple(active), g=np.concatenate([none, *g], axis=1))

    def moved(self, point: _Point, error: float) -> _Point | None:
        """With the move that the evidence gains most by; None where none is worth it."""
        normal = self.normal(point, error)
        here = self.inferred(normal, point.active, point.widths, point.x)
        point = replace(point, active=here[1], widths=here[2], score=here[0])
        best = min(self.moves(normal, point), key=lambda move: move[0], default=(math.inf, point.active))
        if best[0] > here[0] - _SETTLED:
            return None
        # g goes on from where it was: only what left is taken out, which the next step makes good
        return self.relinearised(self.with_places(point, best[1]))

    def relinearised(self, point: _Point) -> _Point:
        D = self.residual(point.active, point.x, point.g)
        return point if D is None else replace(point, D=D)

    def moves(self, normal: Normal, point: _Point) -> Iterator[tuple[float, tuple[Active, ...]]]:
        """Places added; where that gains nothing, dropped and swapped."""
        adds = self.looked(normal, point.active, point, _CLOSELY) if len(point.active) < MOST else []
        yield from adds
        if min((score for score, _ in adds), default=math.inf) > point.score - _SETTLED:
            yield from self.without_each(normal, point, _CLOSELY // 2)

    def without_each(self, normal: Normal, point: _Point, closely: int) -> Iterator[tuple[float, tuple[Active, ...]]]:
        """Places dropped and swapped."""
        same = {a.place.key for a in point.active}
        for i in range(len(point.active)):
            rest = (*point.active[:i], *point.active[i + 1 :])
            score, rest, _ = self.inferred(normal, rest, point.widths, point.x)
            yield score, rest
            for other in self.looked(normal, rest, point, closely):
                if {a.place.key for a in other[1]} != same:
                    yield other

    def looked(
        self, normal: Normal, active: tuple[Active, ...], point: _Point, closely: int
    ) -> list[tuple[float, tuple[Active, ...]]]:
        """-2 ln evidence with one place more: of all places at a few sizes, then of the best with all inferred."""
        sd = self.sd(active, point.widths)
        reduced = normal.without(self._columns(active), self.variance(active))
        there, quick = {a.place.key for a in active}, list[tuple[float, Active]]()
        for place in (p for p in self.places if p.key not in there):
            if place.unknown is not None:
                i = self.unknowns.index(place.unknown)
                wider = np.tile(sd, (len(APART), 1))
                wider[:, i] = APART
                score = float(marginal(reduced.of_unknowns, wider).min()) + reduced.log_volume
                quick.append((score + beforehand(APART[0], True), Active(place)))
            else:
                score, law = reduced.best_law(self.columns[place.key], place.relative, sd, *FIRST_LOOK)
                quick.append((score + PRICE, Active(place, law)))
        quick.sort(key=lambda each: each[0])
        found = []
        for _, added in quick[:closely]:
            score, both, _ = self.inferred(normal, (*active, added), point.widths, point.x, 1)
            found.append((score, both))
        return sorted(found, key=lambda each: each[0])

    def pruned(self, point: _Point) -> _Point:
        """Without places that are not worth their price, all refitted."""
        for _ in range(len(point.active)):
            normal = self.normal(point, 0.0)
            without = [(*point.active[:i], *point.active[i + 1 :]) for i in range(len(point.active))]
            scores = [self.inferred(normal, rest, point.widths, point.x)[0] for rest in without]
            if not scores or min(scores) > point.score + self.worth:  # linear: they are refitted
                break
            rest = self.with_places(point, without[int(np.argmin(scores))])
            fewer = self.settled(self.advanced(self.relinearised(rest), 0.0, True), 0.0)
            if fewer.score > point.score:
                break
            point = fewer
        return point

    # --- what is told -------------------------------------------------------------------------------------------------

    def told(self, point: _Point) -> SourceMap:
        """The map of a point."""
        normal = self.normal(point, 0.0)
        score, active, widths = self.inferred(normal, point.active, point.widths, point.x)
        point = replace(point, active=active, widths=widths, score=score)
        columns, signals = self._columns(active), []
        sd = np.zeros_like(point.g, float)
        if len(columns):
            sd = normal.amplitudes(columns, self.variance(active), point.x)[1]
        for a, own in zip(active, _slices(active), strict=True):
            units = self.units[columns[own]]
            signals.append(Signal(a.place, point.g[:, own] * units, sd[:, own] * units, tuple(units.tolist())))
        rivals = [Rival(tuple(a.place for a in other), s - score) for s, other in self._rivals(normal, point)]
        return SourceMap(
            tuple(signals), self.unknowns_of(active), point.x, widths, score, self.chi2(point.D), normal_size(point),
            tuple(sorted(rivals, key=lambda r: r.above)), point.J,
        )  # fmt: skip

    def _rivals(self, normal: Normal, point: _Point) -> Iterator[tuple[float, tuple[Active, ...]]]:
        yield from self.looked(normal, point.active, point, MOST)
        yield from self.without_each(normal, point, _CLOSELY)


def with_signals(problem: NetworkProblem, signals: Sequence[tuple[Place, Array]]) -> NetworkProblem:
    """A problem whose simulations hold what acts at some places, with harmonics (K+1, q) [SI] each; of balances alone:
    what has none is not run in time, which takes a hundred times as long."""
    sources, amplitudes = list[Source](), list[Array]()
    shown = np.zeros((problem.K + 1, len(problem.signals)), complex)
    for place, g in signals:
        if place.sources:
            sources += place.sources
            amplitudes += list(g.T)
        elif place.channel is not None:
            shown[:, problem.signals.index(place.channel)] += g[:, 0]
    forced = Forced(tuple(sources), np.stack(amplitudes, axis=1) if sources else np.zeros((1, 0)), shown)
    return replace(problem, simulator=replace(problem.simulator, forced=forced))


def _slices(active: Sequence[Active]) -> list[Array]:
    """The columns of every place among those of all."""
    ends = np.cumsum([a.place.columns for a in active])
    return [np.arange(end - a.place.columns, end) for a, end in zip(active, ends, strict=True)]


def normal_size(point: _Point) -> int:
    """How many real numbers a record has."""
    return point.D.shape[1] * (2 * len(point.D) - 1)


def _units(problem: NetworkProblem) -> tuple[float, float]:
    """Units of sources that are pressures [Pa] and flows [m³/s]: a part of the inflow's pulse, and of that times the
    impedance by which it becomes a pressure."""
    from solver.effect import small_wave_impedance

    inflow = problem.simulator.drive.X
    flow = _UNIT * math.sqrt(2.0 * float((np.abs(inflow[1:]) ** 2).sum()))
    network = problem.network
    return small_wave_impedance(network, network.segment(network.inlet.segment)) * flow, flow
