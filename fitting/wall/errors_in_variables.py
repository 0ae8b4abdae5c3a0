"""The regression of a wall on a loop of noisy pressure and radius (:mod:`fitting.inference.models.loop`), without
priors, and the error of its law.

The search (:mod:`fitting.inference.gauss_newton`) minimises -2 ln of the joint likelihood of the parameters and of the
true radius, which is a hidden unknown: |z|² of the linear problem, plus the cost of the change that the radius has yet
to make.

A law that misses the loop by many times the noise cannot be weighted by the noise: the harmonics that the sensors
happen to measure best would decide. So a random error of P of equal size at every harmonic joins the noise, estimated
by restricted maximum likelihood from the residual of the fit (:mod:`fitting.inference.model_discrepancy`), alternating
with the fit, as in a network (:mod:`fitting.inference.joint.model_error`). It is 0 if the law leaves only noise. It is
also 0 if noise that is larger than the scatter between beats by one common factor, as with gaps, explains the residual
about as well; then the covariance is multiplied by χ²/dof.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from solver.loop import derivative_matrix
from solver.quantities.coordinate import SHIFT

from ..inference.fit import Array, Fit, Member
from ..inference.gauss_newton import Point, Rules, Search, Trial, one_by_one, search
from ..inference.joint.model_error import CHANCE
from ..inference.model_discrepancy import Block, estimated, settled, widened, worst_octave
from ..inference.models.loop import Linear, Loop, NoFit, linearise, spectrum
from ..inference.unknown import Unknown
from ..records.channels import spectral
from .elastic_law import DECIDED
from .wall_model import Values, WallModel, evaluate

_ROUNDS = 200
_SETTLED = 1e-2  # gain of a tenth of a standard deviation: what rounding leaves of loops without noise is far less
_STEEPEST = 12.0  # of |2 r ε̇|: a viscosity that varies by e^12 along a loop is noise, no wall
_RULES = Rules(gain=1e-6, latent=True, hopeless=np.inf, damped=0.0)  # ends at a thousandth of a standard deviation


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


@dataclass(frozen=True)
class _Regression:
    """The free parameters and a delay of P as unknowns x, 0 at the start, in units of ``sizes`` : (p + 1,)."""

    loop: Loop
    model: WallModel
    start: Values
    lag: float
    sizes: Array

    @classmethod
    def of(cls, loop: Loop, model: WallModel, start: Values, lag: float = 0.0) -> _Regression:
        """In units of the start; of φ_NL and E_NL, of what makes half of the law nonlinear."""
        rate = float(np.std(derivative_matrix(loop.N, loop.T) @ loop.R)) / start["R0"]
        bent = {"phiNL": start["phi0"] / rate, "ENL": start["E"] * start["R0"] / float(np.std(loop.R))}
        sizes = [*(bent.get(name, start[name]) for name in model.free), 0.1 * loop.T]
        return cls(loop, model, start, lag, np.array(sizes))

    def at(self, x: Array) -> tuple[dict[str, float], float]:
        """The parameters and the delay [s] of unknowns x. Raises NoFit for E, R0 or φ0 that are not positive."""
        *changes, lag = (x * self.sizes).tolist()
        moved = {name: self.start[name] + change for name, change in zip(self.model.free, changes, strict=True)}
        values = {**self.start, **moved}
        if not min(values["E"], values["R0"], values["phi0"]) > 0.0:
            raise NoFit(f"the {self.model.name} model has no solution on this loop.")
        return values, self.lag + lag

    def point(self, x: Array, R: Array) -> Point:
        """The linear problem at x and the radius R : (N,). Raises NoFit as :func:`linearise`."""
        (values, lag), loop = self.at(x), self.loop
        D = derivative_matrix(loop.N, loop.T)
        at = evaluate(self.model, values, R, D @ R)
        A = at.by_R_t[:, None] * D
        A[np.diag_indices(loop.N)] += at.by_R
        law = np.column_stack([at.P, -D @ at.P, at.by_parameter, A])
        law = spectral.shift(law.T, lag / loop.T).T if lag else law
        P, by_lag, columns, A = np.split(law, (1, 2, 2 + len(self.model.free)), axis=1)
        linear = linearise(loop, R, P[:, 0], A, np.column_stack([columns, by_lag]) * self.sizes)
        hidden = loop.misfit(P[:, 0], R) - float(linear.z @ linear.z)
        return Point(linear.z, -linear.columns, hidden, (linear, R))

    def searched(self, first: Point, point: Callable[[Trial], Point], rounds: int, lag_free: bool = False) -> Search:
        """The search from the start, whose point is the ``first``."""
        ends = [*(np.inf for _ in self.model.free), np.inf if lag_free else 0.0]
        unknowns = tuple(Unknown("", SHIFT, (), -end, end, prior_sd=None) for end in ends)
        found = Search(Member((), unknowns, 0.0 * self.sizes), replace(_RULES, rounds=rounds), first)
        search(one_by_one(point, NoFit), [found])
        return found


def solve(loop: Loop, model: WallModel, start: Values, *, lag: float | None = None, rounds: int = _ROUNDS) -> Solution:
    """The most probable wall, from ``start``, after ``rounds`` steps at most.

    lag : start value [s] of a fitted delay of P relative to R.
    Raises NoFit if the parameters leave their range (E, R0, φ0 > 0), do not converge in 200 steps, or if P is
    a function of R to rounding, which leaves nothing to weigh the two by.
    """

    def point(trial: Trial) -> Point:
        assert trial.before is not None
        linear, R = trial.before.memory
        return problem.point(trial.member.x, R + trial.share * (linear.after(trial.step) - R))

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # non-finite values are rejected
        problem = _Regression.of(loop, model, start, lag or 0.0)
        found = problem.searched(problem.point(0.0 * problem.sizes, loop.R), point, rounds, lag is not None)
        solution = _solution(problem, found, lag is not None)
    if rounds == _ROUNDS:
        _check(model, solution, found.cost - found.promised())
    return solution


def whitened(loop: Loop, model: WallModel, found: Solution) -> tuple[Fit, Array]:
    """The linear problem at a solution, and L⁻¹ : (N, N), which whitens an error of the samples of P."""
    problem, p, order = _Regression.of(loop, model, found.values, found.lag), len(found.covariance), np.arange(loop.N)
    here = problem.point(0.0 * problem.sizes, found.R)
    unknowns = (Unknown("", SHIFT, (), -np.inf, np.inf, prior_sd=None),) * p
    fit = Fit((), unknowns, np.zeros(p), here.z, here.J[:, :p], order, 0 * order)
    return fit, solve_triangular(here.memory[0].L, np.eye(loop.N), lower=True)


def plain(loop: Loop, model: WallModel, start: Values, R: Array) -> dict[str, float]:
    """Ordinary least squares of P on the loop with the measured radius R, which ignores the noise of R."""
    problem, R_t = _Regression.of(loop, model, start), spectral.derivative(R, loop.T)

    def point(x: Array) -> Point:
        at = evaluate(model, problem.at(x)[0], R, R_t)
        return Point(loop.P - at.P, -np.column_stack([at.by_parameter, 0.0 * at.P]) * problem.sizes)

    found = problem.searched(point(0.0 * problem.sizes), lambda trial: point(trial.member.x), _ROUNDS)
    return problem.at(found.x)[0]


def _check(model: WallModel, found: Solution, gain: float) -> None:
    """NoFit if φ0 and φ_NL ran away together, or if a further step still promises a ``gain`` of the cost."""
    r = found.values["phiNL"] / found.values["phi0"]
    bend = 2.0 * abs(r) * float(np.abs(found.R_t).max()) / found.values["R0"]
    if model.viscous == "monotone" and not bend < _STEEPEST:
        raise NoFit(
            f"phi0 and phiNL run away (phiNL/phi0 = {r:.3g} s): noise, a slow sensor, a time lag or another elastic "
            "law hides them; fit the linear model, check law and timing, R0 if it was given, or record more beats."
        )
    if not gain < _SETTLED * max(1.0, found.chi2 / len(found.R)):
        raise NoFit(
            f"the {model.name} model with the {model.elastic} law did not converge (chi²/dof = "
            f"{found.chi2 / len(found.R):.3g}); try another model or law, check R0 if it was given, and fit no lag."
        )


def _solution(problem: _Regression, found: Search, lag_free: bool) -> Solution:
    """What the linear problem at the minimum tells."""
    here, free = found.here, np.arange(len(problem.sizes) - (not lag_free))
    assert here is not None
    linear: Linear = here.memory[0]
    R, (values, lag), columns = linear.radius(here.z), problem.at(found.x), here.J / problem.sizes
    scale = np.linalg.norm(columns[:, free], axis=0)
    q, triangle = np.linalg.qr(columns[:, free] / scale)
    inverse = solve_triangular(triangle, np.eye(len(scale))) / scale[:, None]
    return Solution(
        values=values,
        covariance=inverse @ inverse.T,
        lag=lag,
        R=R,
        R_t=derivative_matrix(len(R), problem.loop.T) @ R,
        residual=linear.unwhiten(here.z),
        expected=np.sqrt(np.maximum(spectrum(linear.V), 0.0)),
        chi2=float(here.z @ here.z),
        by_lag=(inverse @ (q.T @ columns[:, -1]))[: len(problem.model.free)],
        condition=float(np.linalg.cond(triangle)),
    )


MISSED = 1e-5  # of the pulse: a smaller residual of a noise-free loop is that of its integration
# Largest factor of the variance of the noise: of 40 recordings of 15 beats with gaps, where a twentieth of the beat was
# measured once, the law being right, χ²/dof is 2.0 (median) and 3.1 (largest), and none has a model error
_MISJUDGED = 4.0
_ALTERNATIONS = 12  # of fit and error estimate, at most
_SAME = 1e-2  # relative change of the error that is negligible


def with_model_error(loop: Loop, model: WallModel, found: Solution, lag_free: bool) -> Loop:
    """The loop with the model error that a solution ``found`` by the noise alone calls for; as given if it is 0.

    Raises NoFit as :func:`fitting.wall.errors_in_variables.solve`.
    """
    dof, pulse, wide = loop.N - len(found.covariance), float(np.std(loop.P)), loop
    if found.chi2 < dof + CHANCE * math.sqrt(2.0 * dof):
        return loop
    for _ in range(_ALTERNATIONS):
        fit, white = whitened(loop, model, found)
        each = [Block(np.arange(loop.N), pulse * white, np.zeros(loop.N, int))]
        share = estimated(fit, each, 1)
        # the first error must be decidedly more probable than misjudged noise
        if not wide.model_error and (
            share[0] < MISSED or not _scaled(fit) - _cost(widened(fit, each, share)) > 2.0 * DECIDED
        ):
            return loop
        error = float(share[0]) * pulse / math.sqrt(loop.N)
        if abs(error - wide.model_error) <= _SAME * error:
            break
        wide = replace(loop, model_error=error)
        found = solve(wide, model, found.values, lag=found.lag if lag_free else None)
    return wide


def _cost(fit: Fit) -> float:
    """-2 ln of the restricted likelihood of a linear problem at its minimum, up to a constant."""
    return fit.chi2 + fit.log_volume + float(np.linalg.slogdet(fit.J.T @ fit.J)[1])


def _scaled(fit: Fit) -> float:
    """The same with all noise multiplied by its most probable factor."""
    best, dof = settled(fit), len(fit.z) - len(fit.x)
    factor = min(best.chi2 / dof, _MISJUDGED)
    return _cost(best) + best.chi2 * (1.0 / factor - 1.0) + dof * math.log(factor)


def widening(loop: Loop, found: Solution) -> float:
    """Factor by which the covariance of a solution is too small: χ²/dof by the noise alone; with a model error that of
    the worst octave."""
    dof = loop.N - len(found.covariance)
    if not loop.model_error:
        return max(1.0, found.chi2 / dof)
    k = np.abs(np.fft.fftfreq(loop.N, 1.0 / loop.N)).round().astype(int)
    ratio = (np.abs(spectral.coefficients(found.residual)) / found.expected)[k] ** 2
    return max(1.0, worst_octave(ratio * loop.N / dof, k))
