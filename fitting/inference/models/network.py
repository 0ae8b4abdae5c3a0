"""The network problem: inlet flow in, P, Q and R at some sites compared; batches of the solver refit hypotheses.

The residual is that of :mod:`fitting.records.channels.noise`: whitened Fourier coefficients of the mean beats. Their
covariance includes the noise of the inflow, which all channels share, and the solver's own error. Hypotheses are
re-simulated, not linearised: each has its own unknowns, and all are members of one batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Self

import numpy as np

from solver.network.description import Network
from solver.quantities.units import INFLOW

from ...records.alignment.beats import Beats
from ...records.channels.inflow import flowed, inflow, undone
from ...records.channels.noise import (
    Target,
    degrees_of_freedom,
    inflow_noise,
    mean_beat,
    pulses,
    solver_error,
    steady_beats,
    under_drive_of,
)
from ...records.channels.variability import BeatVariation, of_other_beats
from ..extended_network import allowed
from ..fit import Array, Fit, Member, begun, sizes_of, taken_over
from ..forward import Drive, Single
from ..gauss_newton import Point, Rules, Search, Trial, continued, promised, search
from ..hypothesis import EVERY, PlacedEffect, about_common, of_animal, refined, rewired
from ..jackknife import Rest, leave_one_site_out, without_each_site
from ..model_discrepancy import sizes
from ..runs import Runs
from ..unknown import Unknown, absent, finite_steps, free
from .batches import simulated
from .bench_observation import meter, shown, zeros_apart
from .simulator import Simulator, varying, weighted

_STEP = 0.02  # finite difference step of x
# A comparison needs costs within a few tenths: the odds that rule out are 9 (-2 ln). Of 8, 6 and 4 steps with updated
# derivatives, 8 took least time on seven batches of searches; of 119 searches one that was within 10 of the best ended
# 7 higher than with 4
_RULES = Rules(gain=0.1, fresh=8)
_FINE = replace(_RULES, gain=0.02)  # for intervals: within a seventh of a standard deviation
_SHARPER = 2  # times that the elements are halved, at most
_NEGLIGIBLE = 0.05  # of the noise's variance, on average: a smaller solver error needs no shorter elements


@dataclass(frozen=True)
class NetworkProblem(Single):
    """A network record with the network for comparison.

    error : (K+1, m) standard deviation of the errors of solver and network. accuracy : of the network, its stated error
    at every harmonic as a fraction of a channel's pulsation. exact : target without model error, if there is any, and
    model_error : its covariance (K+1, m, m). More beats reduce neither. response : (K+1, m) of the channels to the
    inflow. variation : of the network without effects, to beats that differ, at the parameters variation_at.
    deviations : unknowns of individual arteries; empty for common walls. possible : those that may be used. step :
    finite difference step of x.
    """

    kind = "network"
    site = None

    beats: Beats
    simulator: Simulator
    target: Target
    error: Array
    response: Array
    variation: BeatVariation | None = None
    variation_at: Mapping[str, float] = field(default_factory=dict)
    exact: Target | None = None
    model_error: Array | float = 0.0
    deviations: tuple[Unknown, ...] = ()
    possible: tuple[Unknown, ...] = ()
    step: float = _STEP
    accuracy: float = 0.0

    rules, fine = _RULES, _FINE

    @classmethod
    def of(
        cls, beats: Beats, simulator: Simulator, member: Member, error: Array, possible: tuple[Unknown, ...] = (),
        step: float = _STEP, accuracy: float = 0.0,
    ) -> NetworkProblem:  # fmt: skip
        """The problem of a record weighted at a member. error : (K+1, m) standard deviation of the solver's."""
        error = np.hypot(error, accuracy * pulses(beats, simulator.names))
        own, H, variation, at = weighted(beats, simulator, member, error)
        return cls(beats, simulator, own, error, H, variation, at, possible=possible, step=step, accuracy=accuracy)

    @property
    def network(self) -> Network:  # type: ignore[override]
        return self.simulator.network

    @property
    def signals(self) -> tuple[str, ...]:  # type: ignore[override]
        return self.simulator.names

    @property
    def K(self) -> int:  # type: ignore[override]
        return self.simulator.K

    @property
    def dof_of_noise(self) -> float:
        return degrees_of_freedom(self.beats.n_beats)

    @property
    def highest(self) -> float:
        return 0.5 * self.beats.N / self.beats.T

    @property
    def entries(self) -> tuple[Array, Array]:
        m, K = len(self.signals), self.K
        order = np.concatenate([np.zeros(m, int), np.tile(np.repeat(np.arange(1, K + 1), m), 2)])
        return order, np.tile(np.arange(m), 2 * K + 1)

    def refined(self, fit: Fit, term: PlacedEffect) -> PlacedEffect | None:
        return (about_common if self.deviations else refined)(self.network, term, sizes_of(fit, term))

    def held_out(self, beats: Beats, fitted: Beats) -> NetworkProblem:
        drive = inflow(beats, self.simulator.settings.dt, self.network)
        variation = varying(beats, self.network, self.signals, self.K, self.variation_at)
        own = (self.exact or self.target).covariance
        covariance = of_other_beats(own, beats, fitted, self.signals, self.error)
        other = Target.of(self.signals, mean_beat(beats, self.signals, self.K, variation), covariance)
        found = replace(self, beats=beats, simulator=replace(self.simulator, drive=drive), target=other)
        found = replace(found, variation=variation)
        return found if self.exact is None else replace(found, exact=None).widened(self.model_error)

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        z = [None if X is None else self.residual(X) for X in self.observe([f.member for f in fits])]
        return [(np.nan, 1.0) if r is None else (float(r @ r), float(len(r))) for r in z]

    def without_each(self, fit: Fit) -> list[Rest]:
        return without_each_site(self.target, fit)

    def left_out(self, fit: Fit) -> dict[str, float]:
        return leave_one_site_out(self.target, fit)

    def measured_wave(self, beats: Beats) -> Array:
        """(N,) [m³/s] the mean inflow, before the meter's filter."""
        return flowed(beats, self.network)

    def wave(self, beats: Beats, fit: Fit) -> Array:
        """(N,) [m³/s] the inflow given all channels: the measured one minus E[q | x] = -S_q H† C⁻¹ x for the residual x
        = n - H q + e of a hypothesis, through its flow meter; as measured if the simulation breaks down."""
        (X,) = self.observe([fit.member])
        if X is None:
            return self.measured_wave(beats)
        gain, offset = meter(fit.member, self.K + 1, self.simulator.T)
        gain = gain * undone(self.network, INFLOW, self.simulator.drive)[: self.K + 1]
        full = np.fft.rfft(beats.mean(INFLOW), norm="forward")
        weights = np.linalg.inv(self.target.covariance)
        S = inflow_noise(beats, self.signals, self.response, weights, self.variation)
        full[: self.K + 1] += S * np.einsum("ki,kij,kj->k", self.response.conj(), weights, self.target.X - X)
        full[0] -= offset
        full[: self.K + 1] /= gain
        return np.fft.irfft(full, beats.N, norm="forward")

    def answer(self, wave: Array, fit: Fit) -> Array | None:
        driven = replace(self.simulator, drive=shown(fit.member, wave, self.simulator.T))
        return replace(self, simulator=driven).observe([fit.member])[0]

    def repeated(self, beats: Beats, fitted: Beats, K: int) -> Array:
        if beats is fitted:
            return self.target.X[: K + 1]
        X = self.held_out(beats, fitted).target.X
        return under_drive_of(fitted, X, beats, self.signals, self.response, self.variation)[: K + 1]

    def steady(self, beats: Beats, fitted: Beats) -> Beats:
        share, steady = steady_beats(fitted, self.signals, self.response, self.variation)
        if beats is fitted:
            return steady
        variation = varying(beats, self.network, self.signals, self.K, self.variation_at)
        return steady_beats(beats, self.signals, self.response, variation, share=share)[1]

    def driven(self, wave: Array) -> Drive:
        """The inflow."""
        return Drive(INFLOW)

    def noise(self, beats: Beats, fitted: Beats) -> Array:
        own = (self.exact or self.target).covariance - self.error[..., None] ** 2 * np.eye(len(self.signals))
        return own if beats is fitted else of_other_beats(own, beats, fitted, self.signals)

    def covariance(self, beats: Beats) -> Array:
        """(K+1, m, m) of sensors, inflow, solver and network."""
        return self.target.covariance

    # --- hypotheses ---------------------------------------------------------------------------------------------------

    def hypothesis(self, terms: Sequence[PlacedEffect]) -> tuple[Unknown, ...]:
        mine = {variable for term in terms if term.rewires for u in term.unknowns for variable in u.variables}
        # parameters of a rewired outlet are unknowns of its term, not of a nuisance of all outlets
        nuisance = [u for u in of_animal(rewired(self.network, terms), self.deviations) if not set(u.variables) <= mine]
        return (*nuisance, *(u for term in terms for u in term.unknowns))

    def individual(self) -> Self:
        return replace(self, deviations=self.possible)

    def observe(
        self, members: Sequence[Member], runs: Runs | None = None, near: Sequence[int] | None = None
    ) -> list[Array | None]:
        """X : (K+1, m) after the sensors, of every member; None if the simulation broke down.

        runs : counts the simulations and limits their time. near : the member near which each one lies, whose
        difference from it is wanted. Zeros of sensors that are unknowns shift the means.
        """
        each = [zeros_apart(member, self.signals) for member in members]
        found = simulated(self.simulator, [member for member, _ in each], runs or Runs(), near)
        pairs = zip(found, each, strict=True)
        return [X if X is None or zeros is None else X + np.eye(len(X), 1) * zeros for X, (_, zeros) in pairs]

    def residual(self, X: Array) -> Array:
        """(n,) whitened."""
        return self.target.residual(X[None])[0]

    # --- derivatives --------------------------------------------------------------------------------------------------

    def points(self, trials: Sequence[Trial], runs: Runs) -> list[Point | None]:
        found = list[Point | None]()
        for each in self.linearised(trials, runs):
            found.append(None)
            if each is not None:
                white = self.target.whiten(np.concatenate([(each[0] - self.target.X)[..., None], each[1]], axis=-1))
                found[-1] = Point(white[:, 0], white[:, 1:])
        return found

    def linearised(self, trials: Sequence[Trial], runs: Runs) -> list[tuple[Array, Array] | None]:
        """X : (K+1, m) of every trial and its derivatives (K+1, m, q), by finite differences; all in one batch."""
        steps = [finite_steps(t.member.unknowns, t.member.x, self.step)[t.by] for t in trials]
        moved, near = list[Member](), list[int]()
        for t, s in zip(trials, steps, strict=True):
            near += [len(moved)] * (1 + len(s))
            moved.append(t.member)
            moved += [replace(t.member, x=x) for x in t.member.x + s[:, None] * np.eye(len(t.member.x))[t.by]]
        X, found = self.observe(moved, runs, near), list[tuple[Array, Array] | None]()
        for step in steps:
            there, X = [x for x in X[: 1 + len(step)] if x is not None], X[1 + len(step) :]
            whole = np.stack(there, axis=-1) if len(there) > len(step) else None
            found.append(None if whole is None else (whole[..., 0], (whole[..., 1:] - whole[..., :1]) / step))
        return found

    def columns(self, at: Fit, terms: Sequence[PlacedEffect], runs: Runs | None = None) -> dict[str, Array]:
        terms, trials = [t for t in terms if not t.rewires], list[Trial]()
        for term in terms:
            x = np.concatenate([at.x, absent(term.unknowns)])
            by = len(at.x) + np.flatnonzero(free(term.unknowns))
            trials.append(Trial(Member((*at.terms, term), (*at.unknowns, *term.unknowns), x), by, None, 0.0 * x))
        found = self.points(trials, runs or Runs())
        return {term.label: point.J for term, point in zip(terms, found, strict=True) if point is not None}

    # --- search -------------------------------------------------------------------------------------------------------

    def refit(self, hypotheses: Sequence[tuple[PlacedEffect, ...]], start: Fit | None = None, runs: Runs | None = None,
              columns: Mapping[str, Array] | None = None, known: float = np.inf) -> list[Fit | None]:  # fmt: skip
        """The most probable unknowns of every hypothesis, all fitted together in batches.

        start : a fit to another hypothesis; if that is simpler, ``columns`` of the new terms there (:meth:`columns`)
        save the first derivatives. known : a cost; searches that promise to stay far above it end early.
        """
        runs = runs or Runs()
        return self._searched([self._begin(terms, start, columns or {}, runs) for terms in hypotheses], runs, known)

    def _searched(self, searches: Sequence[Search], runs: Runs, known: float = np.inf) -> list[Fit | None]:
        search(partial(self.points, runs=runs), searches, known)
        found = [None if s.failed or s.here is None else s.fit(*self.entries) for s in searches]
        return [None if f is None else allowed(self.network, f) for f in found]

    def _begin(
        self, terms: tuple[PlacedEffect, ...], start: Fit | None, columns: Mapping[str, Array], runs: Runs
    ) -> Search:
        unknowns = self.hypothesis(terms)
        there = taken_over(terms, unknowns, start)
        begun = self._started(there, start, runs)
        old = set() if start is None else {t.label for t in start.terms}
        new = [t for t in terms if t.label not in old]
        simpler = start is not None and old <= {t.label for t in terms}  # else its residual is of a larger hypothesis
        predicted = all(t.label in columns and not (t.rewires or t.moves_along) for t in new)
        if start is None or not (simpler and predicted and np.array_equal(begun.x, there.x)):
            return Search(begun, _RULES)
        own = dict(start.columns)
        for t in new:
            own |= {u.name: columns[t.label][:, i] for i, u in enumerate(t.unknowns)}
        if not all(u.name in own for u in unknowns):
            return Search(begun, _RULES)
        return Search(begun, _RULES, Point(start.z, np.stack([own[u.name] for u in unknowns], axis=1)))

    def searched_from(
        self, members: Sequence[Member], runs: Runs, known: Mapping[str, Array] | None = None, cost: float = np.inf
    ) -> list[Fit | None]:
        """The most probable unknowns of hypotheses, fitted from given starting points.

        known : whitened derivatives (n,) by unknown, which save the first simulations. cost : of a hypothesis; searches
        that promise to stay far above it end early.
        """
        rules = replace(_RULES, afar=True)
        return self._searched([Search(m, rules, known=known) for m in members], runs, cost)

    def refine(self, fits: Sequence[Fit], runs: Runs | None = None) -> list[Fit | None]:
        return self._searched([continued(f, _FINE) for f in fits], runs or Runs())

    def relaxed(self, fits: Sequence[Fit], runs: Runs | None = None, rough: bool = False) -> list[Fit | None]:
        rules = _RULES if rough else _FINE
        return self._searched([Search(f.member, rules, known=f.columns) for f in fits], runs or Runs())

    def sharpened(self, fit: Fit, runs: Runs | None = None) -> Self:
        """The same problem weighted for a fit: with the solver's error there, and the response to the inflow.

        If the error is not negligible against the noise, the elements become shorter. If these break down, as with a
        quadratic viscosity near its turning point, the problem stays unchanged.
        """
        member, problem, runs = fit.member, self, runs or Runs()
        stated = self.accuracy * pulses(self.beats, self.signals)
        for _ in range(_SHARPER):
            finer = replace(problem, simulator=problem.simulator.finer())
            X, X_finer = (p.observe([member], runs)[0] for p in (problem, finer))
            if X is None or X_finer is None:
                return self
            error = solver_error(X, X_finer, pulses(self.beats, self.signals))
            own = np.einsum("kii->ki", self.target.covariance).real - self.error**2 + stated**2
            weight = np.where(np.arange(len(own)) == 0, 0.5, 1.0)[:, None]
            if np.sum(weight * error**2 / own) < _NEGLIGIBLE * weight.sum() * own.shape[1]:
                break
            problem = finer
        return problem._weighted(fit.member, np.hypot(error, stated))

    # --- errors of the model --------------------------------------------------------------------------------------

    def granted(self, part: float | Array, alike: bool = False) -> NetworkProblem:
        """The problem with an independent model error of every harmonic and channel.

        part : its fraction of the size of the harmonic in the channel or, if ``alike``, of the channel's pulsation; one
        for all harmonics, or (K+1,).
        """
        size = pulses(self.beats, self.signals) if alike else sizes(self.target.X)
        variance = np.broadcast_to((np.reshape(part, (-1, 1)) * size) ** 2, self.target.X.shape)[..., None]
        return self.widened(variance * np.eye(len(self.signals))) if np.any(part) else self

    def widened(self, errors: Array | float) -> Self:
        """The problem with model errors of covariance (K+1, m, m) added to the covariance of the channels."""
        exact = self.exact or self.target
        errors = errors if self.exact is None else self.model_error + errors
        target = Target.of(exact.names, exact.X, exact.covariance + errors)
        return replace(self, target=target, exact=exact, model_error=errors)

    def restated(self, fits: Sequence[Fit], before: NetworkProblem) -> list[Fit]:
        """Fits under earlier weights of the same record, with z and J under these weights and x unchanged."""
        own, old, found = self.target, before.target, list[Fit]()
        for f in fits:
            D = old.unwhiten(f.z[:, None]) + (old.X - own.X)[..., None]
            at = f.derived_at if self.simulator is before.simulator else None
            found.append(replace(f, z=own.whiten(D)[:, 0], J=own.whiten(old.unwhiten(f.J)), derived_at=at))
        return found

    def rewhitened(self, columns: Mapping[str, Array], before: NetworkProblem) -> dict[str, Array]:
        own, old = self.target, before.target
        return {label: own.whiten(old.unwhiten(column)) for label, column in columns.items()}

    def rms(self, z: Array) -> Array:
        """(m,) [SI] RMS of each channel's residual over a beat. z : (n,) whitened."""
        power = np.abs(self.target.unwhiten(z[:, None])[..., 0]) ** 2
        return np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0))

    def left_of_pulsation(self, z: Array) -> Array:
        """(m,) RMS residual of each channel over the RMS of its pulsation. z : (n,) whitened."""
        return self.rms(z) / pulses(self.beats, self.signals)

    def at(self, terms: Sequence[PlacedEffect], unknowns: tuple[Unknown, ...], x: Array) -> NetworkProblem:
        """The same problem weighted for these parameters."""
        return self._weighted(Member(tuple(terms), unknowns, x), self.error)

    def _weighted(self, member: Member, error: Array) -> Self:
        """The same problem with the solver's error (K+1, m), and the responses to the inflow's noise and to beats that
        differ, at a member."""
        now = self.variation, self.variation_at
        own, response, variation, at = weighted(self.beats, self.simulator, member, error, *now)
        found = replace(self, target=own, exact=None, error=error, response=response)
        return replace(found, variation=variation, variation_at=at)

    def _started(self, member: Member, start: Fit | None, runs: Runs) -> Member:
        """New sensors and positions along a segment at the best of their starting points; one simulation each."""
        before = set() if start is None else set(start.unknowns)
        for term in member.terms:
            few = term.is_sensor or term.place == EVERY or term.moves_along
            if term.starts and few and not set(term.unknowns) <= before:
                trials = begun(member, term)
                costs = [np.inf if X is None else promised(self.residual(X), start) for X in self.observe(trials, runs)]
                member = trials[int(np.argmin(costs))]
        return member
