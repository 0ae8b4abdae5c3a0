"""Least squares when both pressure and radius are noisy: the functional errors-in-variables model.

The mean beats are P̄ = F(R; θ) + n_P and R̄ = R + n_R with the true radius R : (N,) unknown beside the parameters θ.
With J = ∂F/∂R, linearised at the present R and θ, the residual

    u = P̄ - F(R; θ) - J (R̄ - R) = n_P - J n_R + C δθ,    V = ⟨u uᵀ⟩ = C_PP - J C_RP - C_PR Jᵀ + J C_RR Jᵀ

gives δθ by generalised least squares, and then the most probable radius R = R̄ - (C_RP - C_RR Jᵀ) V⁻¹ u. Iterated,
this is the maximum of the joint likelihood (Britt and Luecke, Technometrics 15, 1973, 233–247): columns evaluated at
the noisy R̄ would bias θ, columns at the estimated R do not. The noise need not be white: its covariance is circulant,
one 2×2 matrix a harmonic, so that a beat-to-beat variation that P and R share is not taken for noise of the law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular, toeplitz

from ..records import spectral
from ..wall_model import Evaluated, Values, WallModel, evaluate

Array = np.ndarray

_ITERATIONS = 200
_STEEPEST = 12.0  # of |2 r ε̇|: a viscosity that varies by e^12 along a loop is noise, no wall
_FULL_STEPS = 10
_CONVERGED = 1e-3  # of a standard deviation: a smaller step ends the iteration
_FLOOR = 1e-10  # noise assumed at least, relative to the pulse: keeps V regular for noise-free data


class NoFit(ValueError):
    """No wall of this model describes the loop."""


@dataclass(frozen=True)
class Loop:
    """Mean beats P, R : (N,) [Pa], [m] of period T [s] and the noise of their Fourier coefficients.

    noise : (N//2 + 1, 2, 2) covariance of (P̂_k, R̂_k).
    """

    P: Array
    R: Array
    T: float
    noise: Array

    @property
    def N(self) -> int:
        return len(self.P)

    @property
    def floor(self) -> tuple[float, float]:
        """Variances of a Fourier coefficient that stand for rounding."""
        return tuple(float((_FLOOR * np.ptp(x)) ** 2) / self.N for x in (self.P, self.R))  # type: ignore[return-value]

    def earlier(self, lag: float) -> Loop:
        """The loop with P moved forward in time by ``lag`` [s]."""
        return replace(self, P=spectral.shift(self.P, -lag / self.T)) if lag else self

    def covariances(self) -> tuple[Array, Array, Array]:
        """C_PP, C_RR, C_RP : (N, N) of the samples."""
        floor = self.floor
        PP, RR = (_circulant(self.noise[:, i, i] + floor[i], self.N) for i in (0, 1))
        return PP, RR, _circulant(self.noise[:, 1, 0], self.N)


@dataclass(frozen=True)
class Solution:
    """values : all parameters. covariance : (p, p) of the free ones (``lag`` last if it is free), for the given noise.

    R, R_t : (N,) the most probable radius and its rate. residual : (N,) P̄ - F - J (R̄ - R). chi2 : uᵀ V⁻¹ u.
    expected : (N//2 + 1,) standard deviation of the residual's Fourier coefficients. by_lag : (p,) change of the free
    parameters per second by which P is delayed. condition : of the whitened, normalised columns.
    """

    values: dict[str, float]
    covariance: Array
    lag: float
    R: Array
    R_t: Array
    residual: Array
    expected: Array
    chi2: float
    by_lag: Array
    condition: float


def solve(
    loop: Loop, model: WallModel, start: Values, *, lag: float | None = None, steps: int = _ITERATIONS
) -> Solution:
    """Iterate from ``start`` until a step is a thousandth of its standard deviation, or ``steps`` are done.

    lag : of P behind R to start from [s], if it is to be found, too.
    Raises NoFit if the parameters leave what a wall can have (E, R0, φ0 > 0), do not converge in 200 steps, or if P is
    a function of R to rounding, which leaves nothing to weigh the two by.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # what is not finite is refused below
        return _iterate(loop, model, start, lag, steps)


def _iterate(loop: Loop, model: WallModel, start: Values, start_lag: float | None, steps: int) -> Solution:
    noise, D = loop.covariances(), _derivative_matrix(loop.N, loop.T)
    lag_free, lag = start_lag is not None, start_lag or 0.0
    values, R = dict(start), loop.R
    for iteration in range(steps):
        relax = 1.0 if iteration < _FULL_STEPS else 0.5  # a model that misses the loop may swing about its best
        system = _linearise(loop.earlier(lag), noise, D, R, evaluate(model, values, R, D @ R), lag_free)
        step = relax * system.step
        step *= _admissible(model, values, step)
        for name, change in zip(model.free, step, strict=False):
            values[name] += float(change)
        lag += float(step[-1]) if lag_free else 0.0
        R = R + relax * (system.radius(loop) - R)
        _check_bend(model, values, D @ R, iteration)
        misfit = np.sqrt(max(1.0, system.chi2 / loop.N))
        if iteration and np.all(np.abs(step) <= _CONVERGED * misfit * system.sd):
            break
    else:
        if steps == _ITERATIONS:
            raise NoFit(
                f"the {model.name} model with the {model.elastic} law did not converge (chi²/dof = "
                f"{system.chi2 / loop.N:.3g}); try another model or law, check R0 if it was given, and fit no lag."
            )
    spectrum = np.sqrt(np.maximum(_spectrum(system.V), 0.0))
    return Solution(
        values,
        system.covariance,
        lag,
        R,
        D @ R,
        system.left,
        spectrum,
        system.chi2,
        system.by_lag[: len(model.free)],
        system.condition,
    )


def _check_bend(model: WallModel, values: Values, R_t: Array, iteration: int) -> None:
    """NoFit where φ0 and φ_NL run away together, which no step brings back; the first few may overshoot."""
    r = values["phiNL"] / values["phi0"]
    bend = 2.0 * abs(r) * float(np.abs(R_t).max()) / values["R0"]
    if model.viscous == "monotone" and iteration >= 3 and not bend < _STEEPEST:
        raise NoFit(
            f"phi0 and phiNL run away (phiNL/phi0 = {r:.3g} s): noise, a slow sensor, a time lag or another elastic "
            "law hides them; fit the linear model, check law and timing, R0 if it was given, or record more beats."
        )


@dataclass(frozen=True)
class _System:
    """The linear problem u = C δθ + noise of covariance V at one point, solved.

    step, sd, by_lag : (p,), of the parameters and the lag, if it is free. left : u - C step. to_R : V-weighted residual
    to radius.
    """

    step: Array
    sd: Array
    covariance: Array
    by_lag: Array
    condition: float
    left: Array
    chi2: float
    V: Array
    factor: tuple[Array, bool]
    to_R: Array

    def radius(self, loop: Loop) -> Array:
        """The most probable radius after the step."""
        return loop.R + self.to_R @ cho_solve(self.factor, self.left, check_finite=False)


def _linearise(
    loop: Loop, noise: tuple[Array, Array, Array], D: Array, R: Array, at: Evaluated, lag_free: bool
) -> _System:
    """The linear problem at the radius R, where the law is ``at``."""
    C_PP, C_RR, C_RP = noise
    P_t = D @ at.P  # of the law: the measured one has the noise of u in it
    J = at.by_R_t[:, None] * D
    J[np.diag_indices(loop.N)] += at.by_R
    u = loop.P - at.P - J @ (loop.R - R)
    JC = J @ C_RR - C_RP.T
    V = C_PP + JC @ J.T - J @ C_RP
    C = np.column_stack([at.by_parameter, -P_t]) if lag_free else at.by_parameter
    scale = np.linalg.norm(C, axis=0)
    if not (np.isfinite(V).all() and np.isfinite(C).all()):
        raise NoFit("the law overflows on this loop; check the units of P, R and h.")
    try:
        factor = cho_factor(V, lower=True, check_finite=False)
    except LinAlgError:
        raise NoFit(
            "P and R are noise-free functions of one another, with no noise to weigh them by; "
            "check that one was not computed from the other."
        ) from None
    white = solve_triangular(factor[0], np.column_stack([C / scale, u, P_t]), lower=True, check_finite=False)
    columns, r = white[:, :-2], white[:, -2]
    q, triangle = np.linalg.qr(columns)
    step = solve_triangular(triangle, q.T @ r)
    inverse = solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return _System(
        step / scale,
        np.linalg.norm(inverse, axis=1),
        inverse @ inverse.T,
        -inverse @ (q.T @ white[:, -1]),
        float(np.linalg.cond(columns / np.linalg.norm(columns, axis=0))),
        u - (C / scale) @ step,
        float(np.sum((r - columns @ step) ** 2)),
        V,
        factor,
        JC.T,
    )


def plain(loop: Loop, model: WallModel, start: Values, R: Array) -> dict[str, float]:
    """Ordinary least squares of P on the loop with the radius R as it is: what ignoring the noise of R gives."""
    values, R_t = dict(start), spectral.derivative(R, loop.T)
    for _ in range(_ITERATIONS):
        at = evaluate(model, values, R, R_t)
        scale = np.linalg.norm(at.by_parameter, axis=0)
        step = np.linalg.lstsq(at.by_parameter / scale, loop.P - at.P, rcond=None)[0] / scale
        step *= _admissible(model, values, step)
        for name, change in zip(model.free, step, strict=True):
            values[name] += float(change)
        if all(abs(change) <= 1e-9 * abs(values[name]) for name, change in zip(model.free, step, strict=True)):
            break
    return values


def _admissible(model: WallModel, values: Values, step: Array) -> float:
    """The largest of 1, 1/2, 1/4 … of the step that leaves E, R0 and φ0 positive."""
    if not np.all(np.isfinite(step)):
        raise NoFit(f"the {model.name} model has no solution on this loop.")
    fraction = 1.0
    for name, change in zip(model.free, step, strict=False):
        while name in ("E", "R0", "phi0") and values[name] + fraction * change <= 0.1 * values[name]:
            fraction *= 0.5
    return fraction


@lru_cache(maxsize=8)
def _derivative_matrix(N: int, T: float) -> Array:
    """D : (N, N) with D x = dx/dt of periodic samples."""
    return np.ascontiguousarray(spectral.derivative(np.eye(N), T).T)


def _circulant(S: Array, N: int) -> Array:
    """⟨x_i y_j⟩ of samples whose Fourier coefficients have the (cross-)spectrum S_k = ⟨x̂_k ŷ_k*⟩."""
    c = np.fft.irfft(S, N) * N
    return toeplitz(c, c[-np.arange(N) % N])


def _spectrum(V: Array) -> Array:
    """Variances of the Fourier coefficients of samples with covariance V : (N, N)."""
    N = len(V)
    F = np.fft.rfft(V, axis=0) / N
    return np.array(np.fft.ifft(F, axis=1)[np.arange(N // 2 + 1), np.arange(N // 2 + 1)].real)
