"""The bench: pressure and radius of one site, compared through the local wall law; both are noisy.

With the true waves P and R, the channels measure p = H_P P + o_P and r = H_R R + o_R, where H and o are the measurement
chain (1 and 0 if perfect). The law of :mod:`solver.loop`, with all effects of the wall, then gives the measured
pressure G(r) for the measured radius r. This is an errors-in-variables model (:mod:`fitting.inference.models.loop`)
with every effect that a bench can show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from solver import loop as law
from solver.laws.catalogue import filtered, neutral_value, terms_of, zero_of
from solver.network.description import Network

from ...records.alignment.beats import Beats
from ...records.channels import spectral
from ...records.channels.inflow import undoable
from ...records.channels.noise import degrees_of_freedom
from ...records.channels.variability import of_other_beats
from ...records.limits import SAFE
from ..extended_network import allowed
from ..fit import Array, Fit, Member, begun, taken_over
from ..forward import Drive, Single
from ..gauss_newton import Point, Rules, Search, Trial, search
from ..hypothesis import PlacedEffect, nuisances
from ..jackknife import Rest, without_groups
from ..model_discrepancy import Beside, Block, beside, sizes
from ..runs import Runs
from ..unknown import Unknown, finite_steps, values
from .bench_network import on_bench
from .bench_observation import chain
from .loop import Loop, NoFit, fourier, leading, linearise, mean_loop

Chain = tuple[Array, Array]

_MOST_HARMONICS = 40
_ABOVE_NOISE = 4.0  # standard deviations
_RULES = Rules(gain=1e-3, latent=True)  # a step of a thirtieth of a standard deviation changes no verdict
_STEP = 1e-4  # finite difference step of x for derivatives of the smooth law
_FLOOR = 1e-9  # of the pulse: least noise
_BEATS = 3  # of an FMU: a wall forgets its initial state within φ0/E or τ, a small fraction of a beat


@dataclass(frozen=True)
class Seen:
    """The law of a batch of walls, with the period T [s], between two channels: pressure(r) of a measured radius.

    wall : arrays (B, 1); the first wall is linearised. P, R : transfer function and offset of each channel, which
    broadcast to (B, N//2 + 1) and (B, 1).
    """

    wall: law.Wall
    T: float
    P: Chain
    R: Chain

    def radius(self, r: Array) -> Array:
        """True radius (B, N) for the measured radius r : (N,)."""
        transfer, offset = map(np.atleast_2d, self.R)
        return _chained(1.0 / transfer, r - offset)

    def true(self, r: Array) -> tuple[Array, Array]:
        """True radius and pressure (B, N) for the measured radius r : (N,)."""
        R = self.radius(r)
        return R, law.pressure(self.wall, R, R @ law.derivative_matrix(len(r), self.T).T, self.T)

    def pressure(self, r: Array) -> Array:
        """G : (B, N), the measured pressure for a measured radius."""
        transfer, offset = map(np.atleast_2d, self.P)
        return _chained(transfer, self.true(r)[1]) + offset

    def slope(self, r: Array) -> Array:
        """dG/dr : (N, N) of the first wall of the batch."""
        N, R = len(r), self.radius(r)[0]
        to_P, to_R = (np.atleast_2d(transfer)[0] for transfer, _ in (self.P, self.R))
        A = law.slope(self.wall, R, law.derivative_matrix(N, self.T) @ R, self.T)
        if np.any(to_P != 1.0):
            A = law.circulant(to_P, N) @ A
        if np.any(to_R != 1.0):
            A = A @ law.circulant(1.0 / to_R, N)
        return A


def _chained(h: Array, x: Array) -> Array:
    """Harmonics of x : (…, N) times h : (B, N//2 + 1)."""
    return x if np.all(h == 1.0) else np.fft.irfft(np.fft.rfft(x) * h, x.shape[-1])


@dataclass(frozen=True)
class Bench(Single):
    """A bench record of one site, and the network whose wall is compared with it.

    loop : the mean beats; K : harmonics above the noise; n_beats : averaged ones. error : (N//2 + 1,) [Pa] of the law.
    highest : half the sampling rate [Hz].
    """

    kind = "bench"
    deviations = ()
    rules = fine = _RULES

    network: Network
    site: str
    signals: tuple[str, ...]
    loop: Loop
    K: int
    n_beats: int
    error: Array = field(default_factory=lambda: np.zeros(1))
    highest: float = np.inf

    @cached_property
    def artery(self) -> Network:
        """The site's artery alone, with all possible wall terms at their neutral values."""
        neutral = {f"{self.site}.{key}": neutral_value(key) for key in terms_of("segment")}
        alone = self.part(self.network)
        return alone.with_terms(neutral | alone.parameters())

    @cached_property
    def _present(self) -> dict[str, float]:
        return self.artery.parameters()

    @cached_property
    def start(self) -> Array:
        """(N,) [m] the radius up to harmonic K, where searches start: inverting a ringing sensor amplifies noise."""
        X = spectral.coefficients(self.loop.R)
        X[self.K + 1 :] = 0.0
        return np.fft.irfft(X * self.loop.N, self.loop.N)

    @property
    def entries(self) -> tuple[Array, Array]:
        order = (np.arange(2 * self.K + 1) + 1) // 2
        return order, np.zeros_like(order)

    def points(self, trials: Sequence[Trial], runs: Runs) -> list[Point | None]:
        """The linear problems of trials, each at the most probable radius after its step."""
        runs.check()
        radius = [self.start if t.before is None else t.before.memory.after(t.step) for t in trials]
        return [_linearised(self, t.member, r, t.by) for t, r in zip(trials, radius, strict=True)]

    @property
    def dof_of_noise(self) -> float:
        return degrees_of_freedom(self.n_beats, real=True)

    def hypothesis(self, terms: Sequence[PlacedEffect]) -> tuple[Unknown, ...]:
        return (*nuisances(self.network, self.site), *(u for term in terms for u in term.unknowns))

    def refit(self, hypotheses: Sequence[tuple[PlacedEffect, ...]], start: Fit | None = None, runs: Runs | None = None,
              columns: Mapping[str, Array] | None = None, known: float = np.inf) -> list[Fit | None]:  # fmt: skip
        """The most probable unknowns of every hypothesis; ``start`` : a fit to another one.

        known : cost of an earlier fit; if given, a search that promises to stay far above the best ends.
        """
        runs, found = runs or Runs(), list[Fit | None]()
        for terms in hypotheses:
            runs.check()
            best = self._fitted(terms, start, known) or (start and self._fitted(terms, None, known))
            found.append(best)
            if best is not None and known < np.inf:
                known = min(known, best.cost)
        return found

    def _fitted(self, terms: tuple[PlacedEffect, ...], start: Fit | None, known: float) -> Fit | None:
        """The best fit of all starting points of a hypothesis; ``start`` : a fit to a simpler one."""
        found = [self._searched(member, known) for member in _begin(self, terms, start)]
        best = min((f for f in found if f is not None), key=lambda f: f.cost, default=None)
        return best and allowed(self.network, best)

    def _searched(self, member: Member, known: float = np.inf) -> Fit | None:
        """The minimum that a search from one point reaches; None if the law has no pressure on the measured loop."""
        found = Search(member, _RULES)
        with suppress(NoFit, np.linalg.LinAlgError):
            search(partial(self.points, runs=Runs()), [found], known)
            return None if found.here is None else found.fit(*self.entries)
        return None

    def relaxed(self, fits: Sequence[Fit], runs: Runs | None = None, rough: bool = False) -> list[Fit | None]:
        found = list[Fit | None]()
        for f in fits:
            (runs or Runs()).check()
            there = self._searched(f.member)
            found.append(there and allowed(self.network, there))
        return found

    def columns(self, at: Fit, terms: Sequence[PlacedEffect], runs: Runs | None = None) -> dict[str, Array]:
        found = {}
        for term in terms:
            x = np.concatenate([at.x, np.zeros(len(term.unknowns))])
            state = _settled(self, Member((*at.terms, term), (*at.unknowns, *term.unknowns), x))
            if state is not None:
                found[term.label] = state.J[:, len(at.x) :]
        return found

    def without_each(self, fit: Fit) -> list[Rest]:
        state = _settled(self, fit.member)
        return [] if state is None else without_groups(fit, fit.order, state.memory.L[: len(fit.z), : len(fit.z)])

    def beside(self, fit: Fit) -> Beside | None:
        """The fit with errors of the wall law in pressure, one of the mean and one of the harmonics."""
        state = _settled(self, fit.member)
        if state is None:
            return None
        size = np.concatenate([self._law_error[:1], np.repeat(self._law_error[1 : self.K + 1], 2)])
        n = len(size)
        L = state.memory.L[:n, :n]
        B = np.linalg.solve(L, np.diag(size * np.sqrt(self.loop.N)))
        return beside(fit, [Block(np.arange(n), B, np.minimum(np.arange(n), 1))], 2)

    def widened(self, parts: Array) -> Self:
        noise = self.loop.noise.copy()
        noise[:, 0, 0] += (error := self._law_error[: len(noise)] * parts[np.minimum(np.arange(len(noise)), 1)]) ** 2
        return replace(self, loop=replace(self.loop, noise=noise), error=np.hypot(self.error, error))

    def restated(self, fits: Sequence[Fit], before: Bench) -> list[Fit]:
        states = [_settled(self, f.member) for f in fits]
        return [
            f if s is None else replace(f, z=s.z, J=s.J, log_volume=s.log_volume)
            for f, s in zip(fits, states, strict=True)
        ]

    @property
    def _law_error(self) -> Array:
        """(N//2 + 1,) [Pa] standard deviations of harmonics of an error as large as the pulse."""
        return sizes(spectral.coefficients(self.loop.P)[:, None])[:, 0]

    def held_out(self, beats: Beats, fitted: Beats) -> Bench:
        other = bench(beats, self.network, self.site)
        error = np.stack([self.error, 0.0 * self.error], axis=1)
        noise = of_other_beats(self.loop.noise, beats, fitted, self.signals, error)
        return replace(other, loop=replace(other.loop, noise=noise), K=self.K)

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        states = [_settled(self, f.member) for f in fits]
        return [(np.nan, 1.0) if s is None else (float(s.z @ s.z), float(len(s.z))) for s in states]

    def part(self, network: Network) -> Network:
        """A millimetre of the site's artery."""
        return on_bench(network, self.site)

    def measured_wave(self, beats: Beats) -> Array:
        """(N,) [Pa] the mean pressure, before its filter."""
        X = np.fft.rfft(self.loop.P - zero_of(self.network, self.signals[0]))
        X[: self.K + 1] /= undoable(self.network, self.signals[0], beats.omega * np.arange(self.K + 1))
        return np.fft.irfft(X, self.loop.N)

    def wave(self, beats: Beats, fit: Fit) -> Array:
        """(N,) [Pa] the most probable true pressure at the site given P and R, under a hypothesis."""
        state = _settled(self, fit.member)
        if state is None:
            return self.loop.P
        observed = self.seen(fit.member, fit.x[None])
        return observed.true(state.memory.radius(state.memory.z))[1][0]

    def driven(self, wave: Array) -> Drive:
        """The pressure at the artery's end, which is the site's."""
        start = {"network.P_0": float(wave[0])}
        return Drive(f"{self.site}.outlet.P_venous", start, self.signals[0], _BEATS)

    def seen(self, member: Member, x: Array) -> Seen:
        """The channels for some points x : (B, p) of a hypothesis."""
        present = self._present
        moved = values(member.unknowns, x, present)
        wall = law.wall_of(self.artery, self.site, {n: v for n, v in moved.items() if n in present})
        omega = 2.0 * np.pi / self.loop.T * np.arange(self.loop.N // 2 + 1)
        (P, o_P), (R, o_R) = (chain(moved, name, omega) for name in self.signals)
        to_P, to_R = (filtered(self.network, name, omega) for name in self.signals)
        to_R[self.K + 1 :] = 1.0  # noise only; the law would amplify it by inverting a filter
        z_P, z_R = (zero_of(self.network, name) for name in self.signals)
        return Seen(wall, self.loop.T, (P * to_P, o_P + z_P), (R * to_R, o_R + z_R))

    def noise(self, beats: Beats, fitted: Beats) -> Array:
        own = self.loop.noise[: self.K + 1].copy()
        own[:, 0, 0] -= np.broadcast_to(self.error**2, len(self.loop.noise))[: self.K + 1]
        if beats is fitted:
            return own
        # Other beats have other waves: the change that P and R share is in the scatter of both means. Of the noise of
        # the fitted ones, half stays in the inferred wave: two channels determine its one wave.
        scatter = fitted.covariance(self.signals)[: self.K + 1]
        return of_other_beats(scatter, beats, fitted, self.signals) + scatter - 0.5 * own

    def covariance(self, beats: Beats) -> Array:
        """(N//2 + 1, 2, 2) of the sensors."""
        return beats.covariance(self.signals)


def bench(beats: Beats, network: Network, site: str) -> Bench:
    """The bench of a record. Raises ValueError if P or R of the site is missing."""
    loop = mean_loop(beats, site)
    signals = (f"{site}.P", f"{site}.R")
    own, noise, highest = loop.noise, loop.noise.copy(), []
    for i, x in enumerate((loop.P, loop.R)):
        noise[:, i, i] += (_FLOOR * np.ptp(x)) ** 2 / loop.N
        X = np.abs(spectral.coefficients(x)) ** 2
        above = np.flatnonzero(X > _ABOVE_NOISE**2 * own[: len(X), i, i].real)
        highest.append(int(above[-1]) if len(above) else 1)
    # if one of the two is noise only, a sufficiently slow sensor or wall would explain it
    usable = np.flatnonzero(np.abs(filtered(network, signals[1], beats.omega * np.arange(len(own)))) >= SAFE)
    K = min(_MOST_HARMONICS, max(1, min(*highest, int(usable[-1]))))
    return Bench(network, site, signals, replace(loop, noise=noise), K, beats.n_beats, highest=0.5 * beats.N / beats.T)


# --- the search -------------------------------------------------------------------------------------------------------


def _begin(problem: Bench, terms: tuple[PlacedEffect, ...], start: Fit | None) -> list[Member]:
    """Starting points: the simpler fit, with new terms at the best of their own starts.

    If a term has several starts or the simpler fit has an odd wall, also one with a nominal wall: a slow sensor and a
    viscous wall look alike, and the simpler fit may have taken the one for the other.
    """
    unknowns = problem.hypothesis(terms)
    known = () if start is None else [u.name for u in start.unknowns]
    new = [term for term in terms if term.starts and term.unknowns[0].name not in known]
    anew = start is not None and (new or start.odd)
    members = [taken_over(terms, unknowns, s) for s in ((start, None) if anew else (start,))]
    for term in new:
        members = [min(begun(m, term), key=lambda trial: _promise(problem, trial)) for m in members]
    return members


def _promise(problem: Bench, member: Member) -> float:
    """The cost predicted by one linear step from a point."""
    point = _linearised(problem, member, problem.start, radius=False)
    try:
        return np.inf if point is None else Search(member, _RULES, point).promised()
    except np.linalg.LinAlgError:  # a law that nearly overflows
        return np.inf


# --- the linear problem -----------------------------------------------------------------------------------------------


def _settled(problem: Bench, member: Member) -> Point | None:
    """The linear problem at given parameters, at the most probable radius for these."""
    r = problem.start
    for _ in range(2):
        point = _linearised(problem, member, r, np.arange(0))
        if point is None:
            return None
        r = point.memory.radius(point.memory.z)
    return _linearised(problem, member, r)


def _linearised(problem: Bench, member: Member, r: Array, by: Array | None = None, radius: bool = True) -> Point | None:
    """The whitened linear problem at a point and the measured radius r, harmonic by harmonic up to K, with derivatives
    by the unknowns ``by`` : (q,), default all; None if the law has no pressure there. radius : whether the
    point's memory gives the most probable radius, which needs all harmonics.

    Harmonics beyond K contain only noise, which a sufficiently slow sensor would explain. log_volume : log det of V up
    to K, which penalises hypotheses that explain the residual by a larger noise.
    """
    by = np.arange(len(member.x)) if by is None else by
    steps, n = finite_steps(member.unknowns, member.x, _STEP), 2 * problem.K + 1
    F, memory = fourier(len(r)), None
    with np.errstate(all="ignore"):
        observed = problem.seen(member, np.concatenate([member.x[None], (member.x + np.diag(steps))[by]]))
        G = observed.pressure(r)
        columns = (G[1:] - G[0]).T / steps[by]
        try:
            # L in the order of the harmonics: an entry of z depends only on harmonics up to its own
            if radius:
                memory = linearise(problem.loop, r, G[0], observed.slope(r), columns, F)
                z, columns, L = memory.z[:n], memory.columns[:n], memory.L
            else:
                z, columns, L = leading(problem.loop, r, G[0], observed.slope(r), columns, F[:n])
        except NoFit:
            return None
    return Point(z, -columns, 2.0 * float(np.log(np.diag(L)[:n]).sum()), memory)
