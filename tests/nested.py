"""Evidence by nested sampling, with the likelihood and the priors that the score of hypotheses has.

The likelihood of a bench is written here once more, for many walls at once and by another derivative of the law. Priors
are those of :mod:`fitting.inference.hierarchy` as densities: Student's t of nuisances, and of sizes of effects
1/(signs max(|x|, sd) (1 + (x/10)²) ln 1000) with the standard deviation ``sd`` that the record has for them, so far as
their range goes; the factor 1/(1 + (x/10)²) is taken with the likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from fitting.inference.fit import Fit, Member
from fitting.inference.forward import Forward
from fitting.inference.hierarchy import LARGE, LOG_RANGE
from fitting.inference.models.bench import Bench, Seen
from fitting.inference.models.loop import fourier
from fitting.inference.models.network import NetworkProblem
from fitting.inference.unknown import TAILS, Unknown, bounds, precision
from solver import loop as law

Array = np.ndarray

NOTHING = -1e30  # ln likelihood where a law or a simulation breaks down
_ROUNDING = 1e-12  # of a covariance: walls of which so much differs are far from any record
_SETTLED = 3  # linearisations of the radius: as many as the bench has
_LIVE, _SAMPLES, _BATCH = 100, 500, 100


# --- likelihoods ------------------------------------------------------------------------------------------------------


def log_likelihood(problem: Forward, fit: Fit, x: Array) -> Array:
    """-½ (|z|² + ln det V) : (B,) of a hypothesis at points x : (B, p), as ``fit`` has it."""
    if isinstance(problem, Bench):
        return of_bench(problem, fit, x)
    assert isinstance(problem, NetworkProblem)
    X = problem.observe([replace(fit.member, x=each) for each in x])
    z = [None if each is None else problem.residual(each) for each in X]
    return np.array([NOTHING if each is None else max(-0.5 * float(each @ each), NOTHING) for each in z])


def of_bench(problem: Bench, fit: Fit, x: Array) -> Array:
    """That of a loop at its most probable radius: u = P̄ - G(R) - A (R̄ - R), V = Cov(n_P - A n_R), harmonics up to K."""
    loop, F, n = problem.loop, fourier(problem.loop.N), 2 * problem.K + 1
    PP, RR, RP = loop.covariances
    h = 1e-6 * float(np.ptp(loop.R))
    steps, r = h * np.eye(loop.N), np.tile(problem.start, (len(x), 1))
    with np.errstate(all="ignore"):
        seen = problem.seen(Member(fit.terms, fit.unknowns, fit.x), x)
        for _ in range(_SETTLED):
            A = np.stack([_pressure(seen, r + s) - _pressure(seen, r - s) for s in steps], axis=-1) / (2.0 * h)
            u = loop.P - _pressure(seen, r) - (A @ (loop.R - r)[..., None])[..., 0]
            B = A @ RR - RP.T
            V = F @ (PP + B @ A.swapaxes(1, 2) - A @ RP) @ F.T
            works = np.isfinite(V).all(axis=(1, 2)) & np.isfinite(u).all(axis=1)
            V[~works] = np.eye(loop.N)
            spread = np.linalg.eigvalsh(V)
            works &= spread[:, 0] > _ROUNDING * spread[:, -1]
            V[~works] = np.eye(loop.N)
            L = np.linalg.cholesky(V)
            z = np.linalg.solve(L, (np.where(works[:, None], u, 0.0) @ F.T)[..., None])
            w = np.linalg.solve(L.swapaxes(1, 2), z)[..., 0] @ F
            r = loop.R + (w[:, None] @ B)[:, 0]
    volume = np.log(np.diagonal(L, axis1=1, axis2=2)[:, :n]).sum(axis=1)
    value = -0.5 * (z[:, :n, 0] ** 2).sum(axis=1) - volume
    return np.where(works & np.isfinite(value), np.maximum(value, NOTHING), NOTHING)


def _pressure(seen: Seen, r: Array) -> Array:
    """G : (B, N) of measured radii (B, N), one for every wall."""
    (to_P, o_P), (to_R, o_R) = (map(np.atleast_2d, each) for each in (seen.P, seen.R))
    N = r.shape[-1]
    R = np.fft.irfft(np.fft.rfft(r - o_R) / to_R, N)
    P = law.pressure(seen.wall, R, R @ law.derivative_matrix(N, seen.T).T, seen.T)
    return np.fft.irfft(np.fft.rfft(P) * to_P, N) + o_P


# --- priors -----------------------------------------------------------------------------------------------------------


def resolution(fit: Fit) -> Array:
    """(p,) standard deviations of the unknowns, with no prior of sizes."""
    own = np.where([u.of_size for u in fit.unknowns], 1e-9, precision(fit.prior, fit.x))
    return np.sqrt(np.diag(np.linalg.inv(fit.J.T @ fit.J + np.diag(own))))


def prior_of(unknown: Unknown, sd: float) -> tuple[Callable[[Array], Array], float]:
    """x of a probability in (0, 1), and ln of what the prior has in all: less than 0 where its range is short."""
    if not unknown.of_size:  # -2 ln p = ν ln(1 + x²/ν) is Student's t of ν - 1
        assert unknown.prior_sd is not None
        t = student(TAILS - 1.0, scale=unknown.prior_sd * math.sqrt(TAILS / (TAILS - 1.0)))
        a, b = t.cdf(unknown.low), t.cdf(unknown.high)
        return lambda q: t.ppf(a + q * (b - a)), 0.0
    farthest = sd * math.exp(LOG_RANGE - 1.0)  # where 1/(|x| ln 1000) beyond sd, and 1/(sd ln 1000) below, come to 1

    def mass(x: float) -> float:
        return math.copysign(abs(x) / sd if abs(x) < sd else 1.0 + math.log(abs(x) / sd), x)

    low, high = mass(max(unknown.low, -farthest)), mass(min(unknown.high, farthest))

    def at(q: Array) -> Array:
        y = low + q * (high - low)
        return np.sign(y) * sd * np.where(np.abs(y) < 1.0, np.abs(y), np.exp(np.maximum(np.abs(y), 1.0) - 1.0))

    return at, math.log((high - low) / ((2.0 if unknown.low < 0.0 else 1.0) * LOG_RANGE))


# --- evidence ---------------------------------------------------------------------------------------------------------


def log_evidence(problem: Forward, fit: Fit, seed: int = 0) -> tuple[float, float]:
    """ln ∫ likelihood × priors over all that the unknowns of a hypothesis may be, and its standard error.

    ``fit`` says which hypothesis, and what sizes the record resolves; where its unknowns are does not matter.
    """
    from nautilus import Sampler  # takes a second, with pandas and scikit-learn

    priors = [prior_of(u, float(sd)) for u, sd in zip(fit.unknowns, resolution(fit), strict=True)]
    low, high = bounds(fit.unknowns)

    def unit_to_x(q: Array) -> Array:
        x = np.stack([at(q[..., i]) for i, (at, _) in enumerate(priors)], axis=-1)
        return np.clip(x, low, high)

    sizes = np.array([u.of_size for u in fit.unknowns])

    def weighed(x: Array) -> Array:
        return log_likelihood(problem, fit, x) - np.log1p((x[:, sizes] / LARGE) ** 2).sum(axis=1)

    sampler = Sampler(unit_to_x, weighed, n_dim=len(fit.x), n_live=_LIVE,
                      n_networks=0, n_batch=_BATCH, vectorized=True, pass_dict=False, seed=seed)  # fmt: skip
    sampler.run(n_eff=_SAMPLES, discard_exploration=False)
    return float(sampler.log_z) + sum(whole for _, whole in priors), float(sampler.n_eff) ** -0.5
