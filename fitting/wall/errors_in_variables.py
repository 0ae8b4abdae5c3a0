"""The regression of a wall on a loop of noisy pressure and radius (:mod:`fitting.inference.models.loop`), without
priors."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from solver.loop import derivative_matrix

from ..inference.models.loop import Loop, NoFit, linearise, spectrum
from ..records.channels import spectral
from .wall_model import Evaluated, Values, WallModel, evaluate

Array = np.ndarray

_ITERATIONS = 200
_STEEPEST = 12.0  # of |2 r ε̇|: a viscosity that varies by e^12 along a loop is noise, no wall
_FULL_STEPS = 10
_CONVERGED = 1e-3  # of a standard deviation: a smaller step ends the iteration


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

    lag : start value [s] of a fitted delay of P relative to R.
    Raises NoFit if the parameters leave their range (E, R0, φ0 > 0), do not converge in 200 steps, or if P is
    a function of R to rounding, which leaves nothing to weigh the two by.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # non-finite values are rejected below
        return _iterate(loop, model, start, lag, steps)


def _iterate(loop: Loop, model: WallModel, start: Values, start_lag: float | None, steps: int) -> Solution:
    D = derivative_matrix(loop.N, loop.T)
    lag_free, lag = start_lag is not None, start_lag or 0.0
    values, R = dict(start), loop.R
    for iteration in range(steps):
        relax = 1.0 if iteration < _FULL_STEPS else 0.5  # a model that misses the loop may swing about its best
        found, step, radius = _linearised(loop.earlier(lag), D, R, evaluate(model, values, R, D @ R), lag_free)
        step = relax * step
        step *= _admissible(model, values, step)
        for name, change in zip(model.free, step, strict=False):
            values[name] += float(change)
        lag += float(step[-1]) if lag_free else 0.0
        R = R + relax * (radius - R)
        _check_bend(model, values, D @ R, iteration)
        sd = np.sqrt(np.diag(found.covariance) * max(1.0, found.chi2 / loop.N))
        if iteration and np.all(np.abs(step) <= _CONVERGED * sd):
            break
    else:
        if steps == _ITERATIONS:
            raise NoFit(
                f"the {model.name} model with the {model.elastic} law did not converge (chi²/dof = "
                f"{found.chi2 / loop.N:.3g}); try another model or law, check R0 if it was given, and fit no lag."
            )
    return replace(found, values=values, lag=lag, R=R, R_t=D @ R, by_lag=found.by_lag[: len(model.free)])


def _check_bend(model: WallModel, values: Values, R_t: Array, iteration: int) -> None:
    """NoFit where φ0 and φ_NL run away together, which no step brings back; the first few may overshoot."""
    r = values["phiNL"] / values["phi0"]
    bend = 2.0 * abs(r) * float(np.abs(R_t).max()) / values["R0"]
    if model.viscous == "monotone" and iteration >= 3 and not bend < _STEEPEST:
        raise NoFit(
            f"phi0 and phiNL run away (phiNL/phi0 = {r:.3g} s): noise, a slow sensor, a time lag or another elastic "
            "law hides them; fit the linear model, check law and timing, R0 if it was given, or record more beats."
        )


def _linearised(loop: Loop, D: Array, R: Array, at: Evaluated, lag_free: bool) -> tuple[Solution, Array, Array]:
    """The linear problem u = C δθ + noise of covariance V at the radius R, where the law is ``at``, solved; its step
    (p,) of the parameters, and of the lag if it is free; and the most probable radius after it."""
    P_t = D @ at.P  # of the law: the measured one has the noise of u in it
    A = at.by_R_t[:, None] * D
    A[np.diag_indices(loop.N)] += at.by_R
    C = np.column_stack([at.by_parameter, -P_t]) if lag_free else at.by_parameter
    scale = np.linalg.norm(C, axis=0)
    linear = linearise(loop, R, at.P, A, np.column_stack([C / scale, P_t]))
    columns, by_lag = linear.columns[:, :-1], linear.columns[:, -1]
    q, triangle = np.linalg.qr(columns)
    step = solve_triangular(triangle, q.T @ linear.z)
    inverse = solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    left = linear.z - columns @ step
    condition = float(np.linalg.cond(columns / np.linalg.norm(columns, axis=0)))
    expected = np.sqrt(np.maximum(spectrum(linear.V), 0.0))
    found = Solution({}, inverse @ inverse.T, 0.0, R, D @ R, linear.unwhiten(left), expected, float(np.sum(left**2)),
                     -inverse @ (q.T @ by_lag), condition)  # fmt: skip
    return found, step / scale, linear.radius(left)


def plain(loop: Loop, model: WallModel, start: Values, R: Array) -> dict[str, float]:
    """Ordinary least squares of P on the loop with the measured radius R, which ignores the noise of R."""
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
