"""The one least-squares search: Gauss–Newton with bounds and priors, many searches in one batch.

A search minimises, over unknowns x within their bounds,

    C(x) = |z(x)|² + Σ ρ(x_i) + log V(x),    ρ : the priors (:func:`fitting.inference.unknown.penalty`)

by steps s with (JᵀJ + W + λ diag JᵀJ) s = -(Jᵀz + W x), where W is the precision of the priors at x, to the minimum
within the bounds. No step exceeds the reach, which shrinks if the cost rises or if z is undefined. If the cost rises
again, λ increases as well (D. W. Marquardt, J. SIAM 11 (1963) 431). The search ends if the linear problem predicts a
gain of less than g². If C is quadratic, each unknown is then within g of its standard deviation from the minimum, as
s_i² ≤ (A⁻¹)_ii sᵀA s with A = JᵀJ + W. J is computed at every point, or updated from the residuals (C. G. Broyden,
Math. Comput. 19 (1965) 577) and recomputed at intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .fit import Array, Fit, Member
from .unknown import TAILS, bounds, penalty, precision, precisions

LARGEST = 2.0  # of a step, in typical sizes
# Parts of a step to which the reach falls: where there is no residual, and where the cost rises. With 0.5 there, one of
# four benches with a flat valley of R0 and an external pressure ended 4 above the lowest cost known, with 0.3 none
_BROKEN, _VAIN = 0.5, 0.3
_TRIES, _ROUNDS = 3, 10  # of principal pivoting: in vain, and per unknown at most
_MOST_DAMPING = 1e6  # λ that leaves no step
_ABSURD = 1e6  # times the root of the cost: a residual as good as broken down, which carries no information on slopes
_STEEPEST = 1e100  # slope of a residual: a steeper one indicates a failed neighbour, and its square overflows


def bounded_step(
    J: Array, z: Array, prior: Array, x: Array, low: Array, high: Array, damping: float = 0.0, tails: float = TAILS
) -> Array:
    """The step (p,) to the minimum of |z + J s|² + Σ w (x + s)² within the bounds.

    w : the precision of the priors at x. damping : of the columns' squares.
    """
    w = precision(prior, x, tails)
    normal = J.T @ J + np.diag(w) + damping * np.diag(np.maximum((J**2).sum(axis=0), 1e-12))
    return held_step(normal, J.T @ z + w * x, x, low, high)


def held_step(normal: Array, gradient: Array, x: Array, low: Array, high: Array) -> Array:
    """The step (p,) to the minimum of sᵀ normal s/2 + gradientᵀ s within the bounds.

    Unknowns outside their range stop at its bound, and those at a bound where the slope leads inwards are freed, all at
    once; where that does not lower their number, only the last of them (block principal pivoting: L. F. Portugal,
    J. J. Júdice, L. N. Vicente, Math. Comput. 63 (1994) 625). Unknowns with equal bounds stay fixed. If ``normal`` is
    nearly singular the rounds may run out; then the step is the best of theirs.
    """
    lower, upper, moves = low - x, high - x, low < high
    free, step, fewest, tries = moves, np.clip(np.zeros(len(x)), lower, upper), len(x) + 1, _TRIES
    best, least = step, np.inf
    for _ in range(_ROUNDS * len(x)):
        coupling = normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], -(gradient[free] + coupling), rcond=1e-12)[0]
        slope = normal @ step + gradient
        inwards = moves & ~free & np.where(step <= lower, slope < 0.0, slope > 0.0)
        wrong = inwards | free & ((step < lower) | (step > upper))
        step = np.clip(step, lower, upper)
        if not wrong.any():
            return step
        if (value := float(step @ (normal @ step / 2.0 + gradient))) < least:
            best, least = step.copy(), value
        tries = _TRIES if wrong.sum() < fewest else tries - 1
        fewest = min(fewest, int(wrong.sum()))
        if tries < 0:
            wrong &= np.arange(len(x)) == np.flatnonzero(wrong)[-1]
        free = free ^ wrong
    return best


def linear_step(fit: Fit, J: Array, z: Array) -> Array:
    """The step (p,) from a fit to the minimum of a linear problem (J, z) about it, within the bounds."""
    return bounded_step(J, z, fit.prior, fit.x, *bounds(fit.unknowns))


def promised(z: Array, start: Fit | None) -> float:
    """χ² of a residual (n,), or its prediction by the linear problem if the unknowns of ``start`` are refitted."""
    if start is not None and len(start.x):
        z = z + start.J @ linear_step(start, start.J, z)
    return float(z @ z)


@dataclass(frozen=True)
class Rules:
    """The settings of a kind of search.

    gain : predicted gain of the cost, per unit of cost per datum, at which a search ends. tails : of the priors, as in
    :func:`fitting.inference.unknown.penalty`. rounds : maximum number of evaluations. fresh : number of evaluations
    after which derivatives are recomputed, with Broyden updates between; 0 if every evaluation computes them. error :
    relative error of a column of J; λ is at least its square, which damps directions that J does not determine.
    latent : a point has hidden unknowns, which change with every step; the search then ends after a step with too
    small a gain, and relaxes them once after a step without gain. hopeless : a search continues only if its predicted
    cost is at most this far above the best of its batch. damped : λ where the cost rises again. afar : the search
    starts far from its minimum, so that its prediction counts only after the derivatives were recomputed.
    """

    gain: float
    tails: float = TAILS
    rounds: int = 40
    fresh: int = 0
    error: float = 0.0
    latent: bool = False
    hopeless: float = 150.0
    damped: float = 0.05
    afar: bool = False

    def goes_on(self, promise: float, best: float, turn: int) -> bool:
        """True if a search with this predicted cost deserves another evaluation, given the best of its batch."""
        return (self.afar and turn < self.fresh) or promise < best + self.hopeless


@dataclass(frozen=True)
class Point:
    """The linear problem at some x. z : (n,) whitened residual, J : (n, q) its derivatives by the requested unknowns.

    log_volume : the cost beside |z|² and the priors: log det of the covariance of z, if it depends on x, or the
    decrease that hidden unknowns have yet to bring. memory : data of the caller.
    """

    z: Array
    J: Array
    log_volume: float = 0.0
    memory: Any = None


@dataclass(frozen=True)
class Trial:
    """A point to evaluate. by : (q,) unknowns whose derivatives are needed. before : the previous point, from which
    ``step`` : (p,) leads here, if any; ``share`` : of a full step, which hidden unknowns move with it."""

    member: Member
    by: Array
    before: Point | None
    step: Array
    share: float = 1.0


Evaluate = Callable[[Sequence[Trial]], list[Point | None]]  # None where a trial has no residual


def one_by_one(point: Callable[[Trial], Point], *broken: type[Exception]) -> Evaluate:
    """Evaluates trials one after the other; one that raises an error of ``broken`` has no residual."""

    def evaluate(trials: Sequence[Trial]) -> list[Point | None]:
        found: list[Point | None] = []
        for trial in trials:
            found.append(None)
            with suppress(*broken):
                found[-1] = point(trial)
        return found

    return evaluate


class Search:
    """One search: its point, the linear problem there, and the next step.

    known : whitened derivatives (n,) by name of the unknown, known at the start.
    history : the cost at every accepted point. failed : no residual at the start. converged : ended at a minimum.
    derived : all derivatives were computed at the present point.
    """

    def __init__(
        self, member: Member, rules: Rules, here: Point | None = None, known: Mapping[str, Array] | None = None,
        derived: bool = False,
    ) -> None:  # fmt: skip
        self.member, self.rules, self.here, self.known = member, rules, here, known or {}
        self.low, self.high = bounds(member.unknowns)
        self.size = np.array([u.typical_sd for u in member.unknowns])
        self.prior = precisions(member.unknowns)
        self.damping, self.reach, self.step = 0.0, LARGEST, np.zeros(len(member.x))
        self.settling = self.settled = False
        self.failed = self.ended = self.converged = False
        self.history: list[float] = []
        self.derived = derived
        self.cost = self.promise = np.inf
        if here is not None:
            self.settle(member.x, here)

    @property
    def x(self) -> Array:
        """(p,) the present point."""
        return self.member.x

    def settle(self, x: Array, here: Point) -> None:
        """Continue from x, with the linear problem there."""
        self.member, self.here, self.cost = replace(self.member, x=x), here, self._cost(here, x)
        self.history.append(self.cost)

    def fit(self, order: Array, signal: Array) -> Fit:
        """The present point as a fit. order, signal : (n,) harmonic and channel of every entry of z."""
        assert self.here is not None
        m, here = self.member, self.here
        return Fit(
            m.terms, m.unknowns, m.x, here.z, here.J, order, signal, self.converged, here.log_volume,
            derived_at=m.x if self.derived else None,
        )  # fmt: skip

    def asked(self) -> Array:
        """(q,) the unknowns whose derivatives are needed: at the start only those that are not known."""
        return np.flatnonzero([self.here is not None or u.name not in self.known for u in self.member.unknowns])

    def proposes(self) -> bool:
        """Whether another step is worth an evaluation; the step."""
        if self.failed or self.ended or self.here is None:
            return False
        step, gain = self._promised(self.damping, self.reach)
        self.step, self.promise, enough = 0.0 * step if self.settling else step, self.cost - 3.0 * gain, self._enough
        self.ended = not (gain >= enough or self.rules.latent and self.reach == LARGEST)
        if self.ended:
            self.converged = not self.cost - self.promised() >= enough
        return not self.ended

    def promised(self) -> float:
        """The predicted cost after one step, by the linear problem."""
        return self.cost - self._promised(0.0, LARGEST)[1]

    def _promised(self, damping: float, reach: float) -> tuple[Array, float]:
        """The step (p,) and its gain in the linear problem."""
        assert self.here is not None
        z, J, s, x = self.here.z, self.here.J, self.size, self.x
        damping = max(damping, self.rules.error**2)
        scaled = self.prior * s**2, x / s, self.low / s, self.high / s
        step = bounded_step(J * s, z, *scaled, damping, self.rules.tails)
        self.share = min(1.0, reach / max(float(np.abs(step).max(initial=0.0)), 1e-300))
        step *= s * self.share
        return step, self.cost - self._cost(replace(self.here, z=z + J @ step), x + step)

    def _cost(self, point: Point, x: Array) -> float:
        return float(point.z @ point.z) + penalty(self.prior, x, self.rules.tails) + point.log_volume

    @property
    def _enough(self) -> float:
        assert self.here is not None
        return self.rules.gain * max(1.0, (self.cost - self.here.log_volume) / len(self.here.z))

    def answer(self, found: Point | None) -> None:
        """Use the result of the trial: accept the step, or propose a shorter one."""
        assert self.here is not None
        if self.settling:
            self.settling, self.settled = False, True
            if found is not None:
                self.settle(self.x, found)
            return
        size = float(np.abs(self.step / self.size).max())
        most = _ABSURD * max(float(self.here.z @ self.here.z), 1.0) ** 0.5
        if found is None or not np.abs(found.z).max() < most or _too_steep(found):
            self.reach = _BROKEN * size
            return
        x = self.x + self.step
        gained, enough = self.cost - self._cost(found, x), self._enough
        if self.rules.fresh:  # Broyden: the Jacobian that would have predicted the residual
            missed = found.z - self.here.z - self.here.J @ self.step
            J = self.here.J + np.outer(missed, self.step) / float(self.step @ self.step)
            found, self.here, self.derived = replace(found, J=J), replace(self.here, J=J), False
        else:  # neither up nor down
            self.ended = self.converged = abs(gained) < enough and self.reach == LARGEST
        if gained > 0.0:
            self.settled = False
            self.damping = self.damping / 5.0 if self.damping > 1e-3 else 0.0
            self.reach = min(2.0 * self.reach, LARGEST)
            self.settle(x, found)
        else:
            if self.reach < LARGEST:
                self.damping = max(5.0 * self.damping, self.rules.damped)
            self.reach = _VAIN * size
            self.ended |= self.damping > _MOST_DAMPING
            self.settling = self.rules.latent and not self.settled


def _too_steep(found: Point) -> bool:
    """True if a derivative is so large, or NaN, that a neighbour of the point has broken down."""
    return not np.abs(found.J).max(initial=0.0) < _STEEPEST


def continued(fit: Fit, rules: Rules) -> Search:
    """A search from the point of a fit; with its linear problem, if this was computed there."""
    here = Point(fit.z, fit.J, fit.log_volume) if fit.derived else None
    return Search(fit.member, rules, here, derived=fit.derived)


def search(evaluate: Evaluate, searches: Sequence[Search], known: float = np.inf) -> None:
    """Advance all searches, batch by batch, until none has a step worth its evaluation.

    known : the cost of an earlier hypothesis; a search with a much larger predicted cost ends.
    """
    derive(evaluate, [s for s in searches if s.here is None])
    for turn in range(max((s.rules.rounds for s in searches), default=0)):
        active = [s for s in searches if s.proposes()]
        best = min((s.cost for s in searches if not s.failed), default=known)
        active = [s for s in active if s.rules.goes_on(s.promise, min(best, known), turn)]
        if not active:
            break
        fresh = active[0].rules.fresh
        if fresh and turn and turn % fresh == 0:
            derive(evaluate, active)
            active = [s for s in active if s.proposes()]
            if not active:
                break
        by = [np.arange(0 if fresh else len(s.x)) for s in active]
        trials = [
            Trial(replace(s.member, x=s.x + s.step), i, s.here, s.step, s.share)
            for s, i in zip(active, by, strict=True)
        ]
        for s, found in zip(active, evaluate(trials), strict=True):
            s.answer(found)


def derive(evaluate: Evaluate, searches: Sequence[Search]) -> None:
    """Residuals and derivatives of searches at their points; at the start only the unknown derivatives."""
    by = [s.asked() for s in searches]
    trials = [Trial(s.member, i, s.here, np.zeros(len(s.x))) for s, i in zip(searches, by, strict=True)]
    for s, i, found in zip(searches, by, evaluate(trials), strict=True):
        if found is None or _too_steep(found):
            s.failed, s.ended = s.here is None, True  # one that has come somewhere ends there
        else:
            J = np.empty((len(found.z), len(s.x)))
            for j, u in enumerate(s.member.unknowns):
                J[:, j] = s.known.get(u.name, 0.0)
            J[:, i] = found.J
            s.settle(s.x, replace(found, J=J))
            s.derived = len(i) == len(s.x)
