"""The bench: pressure and radius of one site, compared through the local wall law, both of them noisy.

With the true waves P and R = r, the channels measure C_P P and C_R R, where C is the measurement chain (1 if perfect).
The law, with a viscous stress that may have a memory τ,

    P = P_ref + P_ext + P_el(R) + (h/(1-η²)/R) M σ_v(R'/R0),    M = 1/(1 + iωτ)

makes of the measured radius r = C_R R the measured pressure G(r). The residual of the two mean beats, linearised at the
most probable r,

    u = P̄ - G(r) - A (r̄ - r),    A = dG/dr,    V = C_PP - A C_RP - C_PR Aᵀ + A C_RR Aᵀ

is whitened by V: errors in variables (Britt and Luecke 1973), for every effect
that a bench can show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular, toeplitz

from fitting.records import spectral
from fitting.records.beats import Beats
from fitting.wall import mean_loop
from solver.network import Network
from solver.wall import ELASTIC_LAWS, VISCOUS_LAWS

from .add import allowed, extended
from .fits import Fit, bounded_step, bounds, penalty
from .observation import mean_wander, transfer
from .terms import Term, Unknown, followers, nuisances, values
from .thresholds import PRIOR_WIDTH

Array = np.ndarray

_ITERATIONS = 40
_MOST_HARMONICS = 40
_ABOVE_NOISE = 4.0  # standard deviations
_EQUAL = 1e-3  # of the cost: a smaller decrease ends the search
_STEP = 1e-4  # of x, for derivatives of the law, which is smooth
_LARGEST = 3.0  # of a step in x, typical sizes
_FLOOR = 1e-9  # of the pulse: noise assumed at least


@dataclass(frozen=True)
class Bench:
    """A bench record of one site and the network whose wall it is compared with.

    P, R : (N,) mean beats; noise : (N//2 + 1, 2, 2) covariance of their Fourier coefficients; K : harmonics above the
    noise; n_beats : behind the means.
    """

    network: Network
    site: str
    T: float
    P: Array
    R: Array
    noise: Array
    K: int
    n_beats: int

    @property
    def n_effective(self) -> int:
        """Independent numbers of the record: 2K + 1 per signal."""
        return 2 * (2 * self.K + 1)

    @property
    def dof_of_noise(self) -> float:
        """Degrees of freedom that the noise of a harmonic is known from."""
        return 14.0 * (self.n_beats - 1.0)

    @property
    def signals(self) -> tuple[str, str]:
        return f"{self.site}.P", f"{self.site}.R"

    def nuisances(self) -> tuple[Unknown, ...]:
        return nuisances(self.network, self.site)

    def refit(
        self,
        hypotheses: Sequence[tuple[Term, ...]],
        start: Fit | None = None,
        columns: Mapping[str, Array] | None = None,
        known: float = np.inf,
    ) -> list[Fit | None]:
        """The most probable unknowns of every hypothesis; ``start`` : of another one."""
        return [_fitted(self, terms, start) for terms in hypotheses]

    def refine(self, fits: Sequence[Fit]) -> list[Fit | None]:
        """The same fits: their Jacobians are up to date."""
        return list(fits)

    def sharpened(self, fit: Fit) -> Bench:
        """The same problem: the law is evaluated without a solver's error."""
        return self

    def rested(self) -> Bench:
        """The same problem: nothing is simulated."""
        return self

    def restated(self, fits: Sequence[Fit], before: Bench) -> list[Fit]:
        """The same fits: there is one weighting."""
        return list(fits)

    def columns(self, at: Fit, terms: Sequence[Term]) -> dict[str, Array]:
        """Whitened columns (n, q) of every term that may be added to a fit, by label."""
        found = {}
        for term in terms:
            unknowns = (*at.unknowns, *term.unknowns)
            x = np.concatenate([at.x, np.zeros(len(term.unknowns))])
            state = _settled(self, unknowns, x)
            if state is not None:
                found[term.label] = state.J[:, len(at.x) :]
        return found

    def followers(self, fit: Fit, terms: Sequence[Term]) -> tuple[Term, ...]:
        """Terms that can act only beside those of a fit."""
        return followers(extended(self.network, fit), self.site, terms)

    def refined(self, fit: Fit, term: Term) -> Term | None:
        """None: on a bench there is one segment."""
        return None

    def held_out(self, beats: Beats, fitted: Beats) -> Bench:
        """Other beats of the same record, with the noise that the fitted ones showed."""
        other = bench(beats, self.network, self.site)
        noise = self.noise * (self.n_beats / beats.n_beats)
        wander = mean_wander(beats, fitted, self.signals)
        noise[0] += np.diag(np.maximum(wander - np.diag(noise[0]).real, 0.0))
        return replace(other, noise=noise, K=self.K)

    def predict(self, fits: Sequence[Fit]) -> list[tuple[float, float]]:
        """χ² of this record under the parameters of fits to another, and how many data; NaN if one breaks down."""
        states = [_settled(self, f.unknowns, f.x) for f in fits]
        return [(np.nan, 1.0) if s is None else (float(s.z @ s.z), float(len(s.z))) for s in states]


def bench(beats: Beats, network: Network, site: str) -> Bench:
    """The bench of a record. Raises ValueError if P or R of the site is missing."""
    loop = mean_loop(beats, site)
    own = beats.covariance((f"{site}.P", f"{site}.R"))
    pulse = [np.ptp(loop.P), np.ptp(loop.R)]
    noise = loop.noise.copy()
    highest = []
    for i, x in enumerate((loop.P, loop.R)):
        noise[:, i, i] += (_FLOOR * pulse[i]) ** 2 / loop.N
        X = np.abs(spectral.coefficients(x)) ** 2
        above = np.flatnonzero(X > _ABOVE_NOISE**2 * own[: len(X), i, i].real)
        highest.append(int(above[-1]) if len(above) else 1)
    # where one of the two is noise alone, a sensor or wall that is slow enough would explain it
    K = min(_MOST_HARMONICS, max(1, min(highest)))
    return Bench(network, site, loop.T, loop.P, loop.R, noise, K, beats.n_beats)


def fit(problem: Bench, terms: Sequence[Term], start: Fit | None = None) -> Fit:
    """The most probable size of the terms and of the nuisances.

    start : of a simpler hypothesis, whose unknowns are taken over.
    Raises ArithmeticError if no wall of this kind carries the loop.
    """
    unknowns = (*problem.nuisances(), *(u for term in terms for u in term.unknowns))
    n = len(problem.nuisances())
    prior = np.concatenate([np.ones(n), np.full(len(unknowns) - n, PRIOR_WIDTH**-2.0)])
    low, high = bounds(unknowns)
    x, r, damping = _begin(problem, unknowns, terms, start, prior), problem.R, 0.0
    state = _linearise(problem, unknowns, x, r)
    if state is None:
        raise ArithmeticError(f"{problem.site}: the wall law has no pressure on the measured loop.")
    best, converged = np.inf, False
    for _ in range(_ITERATIONS):
        # z as it will be at the most probable radius: the residual is quadratic in what is left to move
        cost = float(state.z @ state.z) + penalty(prior, x) + state.log_volume
        if cost < best + _EQUAL:
            converged = best - cost < _EQUAL
            best, kept, damping = min(cost, best), (x, r, state), 0.2 * damping if damping > 1e-4 else 0.0
            if converged:
                break
        else:
            damping = max(5.0 * damping, 1e-3)
        step = trial = None
        while trial is None and damping < 1e8:
            x, r, state = kept
            step = bounded_step(state.J, state.z, prior, x, low, high, damping)
            step *= min(1.0, _LARGEST / max(np.abs(step).max(), 1e-300))
            trial = _linearise(problem, unknowns, x + step, state.radius(step))
            damping = damping if trial is not None else max(10.0 * damping, 1e-2)
        if trial is None or step is None:
            break
        x, r, state = x + step, state.radius(step), trial
    x, r, state = kept
    order, signal = _orders(len(state.z))
    return Fit(tuple(terms), unknowns, x, state.z, state.J, prior, order, signal, converged, state.log_volume)


def _begin(
    problem: Bench, unknowns: Sequence[Unknown], terms: Sequence[Term], start: Fit | None, prior: Array
) -> Array:
    """Where the search begins: at the simpler fit, the new terms at the best of their starting points."""
    before = {} if start is None else dict(zip((u.name for u in start.unknowns), start.x, strict=True))
    low, high = bounds(unknowns)
    x = np.clip([before.get(u.name, 0.0) for u in unknowns], low, high)
    for term in terms:
        if term.starts and term.unknowns[0].name not in before:
            at = [i for i, u in enumerate(unknowns) if u in term.unknowns]
            trials = [x]
            for values_ in term.starts:
                trial = x.copy()
                trial[at] = values_
                trials.append(trial)
            x = min(trials, key=lambda trial: _promise(problem, unknowns, trial, prior))
    return x


def _promise(problem: Bench, unknowns: Sequence[Unknown], x: Array, prior: Array) -> float:
    """The cost that one linear step from x promises."""
    state = _linearise(problem, unknowns, x, problem.R)
    if state is None:
        return np.inf
    low, high = bounds(unknowns)
    step = bounded_step(state.J, state.z, prior, x, low, high)
    step *= min(1.0, _LARGEST / max(np.abs(step).max(), 1e-300))
    left = state.z + state.J @ step
    return float(left @ left) + penalty(prior, x + step) + state.log_volume


def _fitted(problem: Bench, terms: Sequence[Term], start: Fit | None) -> Fit | None:
    """The fit from where a simpler one ended, or else from nothing; None if no wall of this kind carries the loop."""
    for begin in (start, None):
        try:
            found = fit(problem, terms, begin)
        except ArithmeticError:
            continue
        return found if allowed(problem.network, found) else None
    return None


def most_probable(problem: Bench, at: Fit) -> Array:
    """The true pressure (N,) [Pa] at the site that P and R together make most probable under a hypothesis."""
    state = _settled(problem, at.unknowns, at.x)
    if state is None:
        return problem.P
    v = _values(problem, at.unknowns, at.x)
    perfect = {n: value for n, value in v.items() if not n.startswith(f"{problem.site}.P.")}
    r = state.radius(np.zeros_like(at.x))
    return _law(problem, {**_neutral(problem.site), **perfect}, r, slope=False)[0]


def _settled(problem: Bench, unknowns: Sequence[Unknown], x: Array) -> _State | None:
    """The linear problem at given parameters, at the radius that is most probable under them."""
    r = problem.R
    for _ in range(3):
        state = _linearise(problem, unknowns, x, r)
        if state is None:
            return None
        r = state.radius(np.zeros_like(x))
    return state


@dataclass(frozen=True)
class _State:
    """The whitened linear problem, harmonic by harmonic up to K: z = L⁻¹ F u, J = dz/dx with F the real Fourier basis.

    Harmonics beyond K hold noise alone; a sensor that is slow enough would explain it away. all_z, all_J : with
    them; to_r : (N, N) from all of z to the most probable r; r_bar : the measured one. log_volume : log det of V up
    to K, which keeps a hypothesis from explaining the residual by a larger noise.
    """

    z: Array
    J: Array
    all_z: Array
    all_J: Array
    to_r: Array
    r_bar: Array
    log_volume: float

    def radius(self, step: Array) -> Array:
        return np.asarray(self.r_bar + self.to_r @ (self.all_z + self.all_J @ step))


def _linearise(problem: Bench, unknowns: Sequence[Unknown], x: Array, r: Array) -> _State | None:
    """The linear problem at x and the measured radius r; None where the law has no pressure there."""
    C_PP, C_RR, C_RP = _covariances(problem)
    with np.errstate(all="ignore"):
        G, A = _law(problem, _values(problem, unknowns, x), r)
        columns = np.stack([_column(problem, unknowns, x, r, G, i) for i in range(len(x))], axis=1)
        u = problem.P - G - A @ (problem.R - r)
        B = A @ C_RR - C_RP.T
        V = C_PP + B @ A.T - A @ C_RP
    if not (np.isfinite(V).all() and np.isfinite(u).all() and np.isfinite(columns).all()):
        return None
    F = _fourier(len(u))
    try:
        L = cholesky(F @ V @ F.T, lower=True, check_finite=False)
    except LinAlgError:
        return None
    # L in the order of the harmonics: an entry of z depends on harmonics up to its own only
    white = solve_triangular(L, F @ np.column_stack([u, -columns, B]), lower=True, check_finite=False)
    p, n = len(x), 2 * problem.K + 1
    # r = r̄ - (C_RP - C_RR Aᵀ) V⁻¹ u = r̄ + Bᵀ V⁻¹ u
    z, J = white[:, 0], white[:, 1 : p + 1]
    return _State(z[:n], J[:n], z, J, white[:, p + 1 :].T, problem.R, 2.0 * float(np.log(np.diag(L)[:n]).sum()))


def _column(problem: Bench, unknowns: Sequence[Unknown], x: Array, r: Array, G: Array, i: int) -> Array:
    moved = x.copy()
    step = -_STEP if x[i] + _STEP > unknowns[i].high else _STEP
    moved[i] += step
    return np.asarray((_law(problem, _values(problem, unknowns, moved), r, slope=False)[0] - G) / step)


def _values(problem: Bench, unknowns: Sequence[Unknown], x: Array) -> dict[str, float]:
    present = problem.network.parameters()
    moved = values(unknowns, x, {**_neutral(problem.site), **present})
    return {**_neutral(problem.site), **present, **{name: float(value) for name, value in moved.items()}}


@lru_cache(maxsize=64)
def _neutral(site: str) -> dict[str, float]:
    sensors = {"lag": 0.0, "gain": 1.0, "offset": 0.0, "slow": 0.0, "resonance": 0.0}
    wall = {f"{site}.tau": 0.0, f"{site}.P_ext": 0.0, f"{site}.E_scale": 1.0}
    return {**wall, **{f"{site}.{c}.{key}": v for c in "PR" for key, v in sensors.items()}}


def _law(problem: Bench, v: Mapping[str, float], r: Array, slope: bool = True) -> tuple[Array, Array]:
    """The measured pressure G(r) : (N,) of a measured radius r, and dG/dr : (N, N)."""
    s, N = problem.site, len(r)
    network, omega = problem.network, 2.0 * np.pi / problem.T * np.arange(N // 2 + 1)
    to_P, to_R = _chain(v, f"{s}.P", omega), _chain(v, f"{s}.R", omega)
    R = _apply(1.0 / to_R, r - v[f"{s}.R.offset"])
    R0, E, phi0 = v[f"{s}.R0"], v[f"{s}.E"] * v[f"{s}.E_scale"], v[f"{s}.phi0"]
    thickness = v[f"{s}.h"] / (1.0 - v["network.eta"] ** 2)
    elastic, viscous = ELASTIC_LAWS[network.elastic_law], VISCOUS_LAWS[network.viscous_law]
    rate = spectral.derivative(R, problem.T) / R0
    stretch, K, e = R / R0, np.array(E * thickness / R0), np.array(v[f"{s}.ENL"] / E)
    bend = v[f"{s}.phiNL"] / phi0 if phi0 > 0.0 else 0.0
    memory = 1.0 / (1.0 + 1j * omega * v[f"{s}.tau"])
    stress = _apply(memory, phi0 * rate * viscous.factor(bend * rate))
    P = v["network.P_ref"] + v[f"{s}.P_ext"] + elastic.pressure(stretch, K, e) + thickness / R * stress
    G = _apply(to_P, P) + v[f"{s}.P.offset"]
    if not slope:
        return G, r
    D = _differentiation(N, problem.T)
    A = (thickness / R)[:, None] * (_circulant(memory, N) @ ((phi0 * viscous.slope(bend * rate) / R0)[:, None] * D))
    A[np.diag_indices(N)] += elastic.derivative(stretch, K, e) / R0 - thickness * stress / R**2
    if np.any(to_P != 1.0):
        A = _circulant(to_P, N) @ A
    if np.any(to_R != 1.0):
        A = A @ _circulant(1.0 / to_R, N)
    return G, A


def _chain(v: Mapping[str, float], channel: str, omega: Array) -> Array:
    """Transfer function (K+1,) of a measurement chain."""
    return transfer(omega, v[f"{channel}.lag"], v[f"{channel}.gain"], v[f"{channel}.slow"], v[f"{channel}.resonance"])


def _apply(h: Array, x: Array) -> Array:
    return np.fft.irfft(np.fft.rfft(x) * h, len(x))


def _circulant(h: Array, N: int) -> Array:
    c = np.fft.irfft(h, N)
    return toeplitz(c, c[-np.arange(N) % N])


@lru_cache(maxsize=4)
def _differentiation(N: int, T: float) -> Array:
    return np.ascontiguousarray(spectral.derivative(np.eye(N), T).T)


def _covariances(problem: Bench) -> tuple[Array, Array, Array]:
    """C_PP, C_RR, C_RP : (N, N) of the samples."""
    N, S = len(problem.P), problem.noise
    return tuple(_covariance(S[:, i, j], N) for i, j in ((0, 0), (1, 1), (1, 0)))  # type: ignore[return-value]


def _covariance(S: Array, N: int) -> Array:
    c = np.fft.irfft(S, N) * N
    return toeplitz(c, c[-np.arange(N) % N])


@lru_cache(maxsize=4)
def _fourier(N: int) -> Array:
    """(N, N) orthonormal real Fourier basis by rows: mean, cos 1, sin 1, cos 2 …"""
    rows = [np.full(N, N**-0.5)]
    phase = 2.0 * np.pi * np.arange(N) / N
    for k in range(1, N // 2 + 1):
        if 2 * k == N:
            rows.append(np.cos(k * phase) * N**-0.5)
        else:
            rows += [np.cos(k * phase) * (2.0 / N) ** 0.5, np.sin(k * phase) * (2.0 / N) ** 0.5]
    return np.array(rows)


def _orders(N: int) -> tuple[Array, Array]:
    order = (np.arange(N) + 1) // 2
    return order, np.zeros(N, int)
