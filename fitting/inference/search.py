"""Searches of many hypotheses together: each asks for one simulation at a time, and those of all are one batch.

A damped Gauss–Newton step in every turn, whose Jacobian is kept up to date from the simulations themselves (Broyden
1965) and simulated anew now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from .fit import Fit, Member
from .simulator import Runs
from .unknown import bounds, penalty, precision, precisions

Array = np.ndarray

_LARGEST = 2.0  # of a step in x
_ROUNDS = 30  # simulations of a hypothesis at most
_FRESH = 4  # of them after which derivatives are simulated anew: the updated ones are too far off by then
_ALL_FRESH = 8  # from which on also those of what every artery has of its own, which are many and hardly change
_FEW = 100  # of which all are fresh at once
_SMALL = 0.02  # decrease of the cost that ends a search, for each unit of cost per datum
_ABSURD = 1e6  # times the root of the cost: a residual as good as broken down, which says nothing of slopes
_STEEPEST = 1e100  # slope of a residual: what is steeper has broken down beside the point, and its square overflows
_HOPELESS = 150.0  # by which a search may promise to stay above the best one and still go on


def bounded_step(J: Array, z: Array, prior: Array, x: Array, low: Array, high: Array, damping: float = 0.0) -> Array:
    """The step (p,) to the minimum of |z + J s|² + Σ w (x + s)², those that would leave their range held there.

    w : the precision of the priors at x. damping : of the columns' squares.
    """
    w = precision(prior, x)
    normal = J.T @ J + np.diag(w) + damping * np.diag(np.maximum((J**2).sum(axis=0), 1e-12))
    return held_step(normal, J.T @ z + w * x, x, low, high, 1e-12)


def held_step(normal: Array, gradient: Array, x: Array, low: Array, high: Array, rcond: float) -> Array:
    """The step (p,) with normal s = -gradient, where those that would leave their range stop at its end.

    One that was held stays held, which costs a few per cent of the gain of scipy.optimize.lsq_linear at worst, and a
    hundredth of its time. One that may have one value only does not move.
    """
    free, step = low < high, np.zeros(len(x))
    for _ in range(int(free.sum())):
        held = normal[np.ix_(free, ~free)] @ step[~free]
        step[free] = np.linalg.lstsq(normal[np.ix_(free, free)], -(gradient[free] + held), rcond=rcond)[0]
        outside = free & ((x + step < low) | (x + step > high))
        step[outside] = np.clip(x + step, low, high)[outside] - x[outside]
        free &= ~outside
        if not outside.any() or not free.any():
            break
    return step


class Searched(Protocol):
    """What simulates hypotheses and compares them with a record."""

    def observe(self, members: Sequence[Member], runs: Runs) -> list[Array | None]:
        """Observations of every member; None where the simulation broke down."""

    def residual(self, X: Array) -> Array:
        """(n,) whitened."""

    def derivatives(
        self, members: Sequence[Member], runs: Runs, by: Sequence[Array] | None = None
    ) -> list[tuple[Array, Array] | None]:
        """z : (n,) and its columns (n, q) by the unknowns ``by`` : (q,) indices, default all, of every member."""


class Search:
    """A damped Gauss–Newton search that asks for one simulation at a time."""

    def __init__(self, member: Member) -> None:
        self.terms, self.unknowns, self.x = member.terms, member.unknowns, member.x
        self.prior = precisions(self.unknowns)
        self.z: Array = np.zeros(0)
        self.J: Array | None = None
        self.damping, self.failed, self.converged = 0.0, False, False
        self.low, self.high = bounds(self.unknowns)
        self.cost = self.promise = np.inf
        self._step: Array = np.zeros_like(self.x)

    def member(self) -> Member:
        return Member(self.terms, self.unknowns, self.x)

    def settle(self, z: Array) -> None:
        self.z, self.cost = z, float(z @ z) + penalty(self.prior, self.x)

    def proposes(self) -> bool:
        """Whether another step is worth a simulation."""
        if self.failed or self.converged or self.J is None:
            return False
        step = bounded_step(self.J, self.z, self.prior, self.x, self.low, self.high, self.damping)
        size = np.abs(step).max(initial=0.0)
        step *= min(1.0, _LARGEST / size) if size > 0.0 else 1.0
        left = self.z + self.J @ step
        gain = self.cost - (float(left @ left) + penalty(self.prior, self.x + step))
        self.promise = self.cost - 3.0 * gain
        if gain < _SMALL * max(1.0, self.cost / len(self.z)):
            self.converged = True
            return False
        self._step = step
        return True

    def trial(self) -> Member:
        return Member(self.terms, self.unknowns, self.x + self._step)

    def answer(self, z: Array | None) -> None:
        assert self.J is not None
        step = self._step
        if z is None or not np.abs(z).max() < _ABSURD * max(self.cost, 1.0) ** 0.5:
            self.damping = max(10.0 * self.damping, 1.0)
            self.failed = self.damping > 1e7
            return
        x = self.x + step
        cost = float(z @ z) + penalty(self.prior, x)
        # Broyden: the Jacobian that would have foretold what was found
        self.J = self.J + np.outer(z - self.z - self.J @ step, step) / float(step @ step)
        if cost < self.cost:
            self.x, self.damping = x, self.damping / 5.0 if self.damping > 1e-3 else 0.0
            self.settle(z)
        else:
            self.damping = max(5.0 * self.damping, 0.05)
            if self.damping > 1e6:
                self.converged = True


def search(problem: Searched, searches: Sequence[Search], runs: Runs, known: float = np.inf) -> None:
    """Steps of all searches, one batch after the other, until none has any worth its simulation.

    known : the cost of a hypothesis found before; a search that promises to stay far above it ends.
    """
    _derive(problem, [s for s in searches if s.J is None], runs)
    for turn in range(_ROUNDS):
        active = [s for s in searches if s.proposes()]
        best = min((s.cost for s in searches if not s.failed), default=known)
        active = [s for s in active if s.promise < min(best, known) + _HOPELESS]
        if not active:
            break
        if turn and turn % _FRESH == 0:
            few = sum(len(s.x) for s in active) <= _FEW
            _derive(problem, active, runs, everything=few or turn >= _ALL_FRESH)
            active = [s for s in active if s.proposes()]
        X = problem.observe([s.trial() for s in active], runs)
        for s, x in zip(active, X, strict=True):
            s.answer(None if x is None else problem.residual(x))


def relax(problem: Searched, fits: Sequence[Fit], runs: Runs) -> list[Search]:
    """Searches from where fits are, with the derivatives that they have."""
    searches = [Search(f.member) for f in fits]
    for s, f, X in zip(searches, fits, problem.observe([f.member for f in fits], runs), strict=True):
        s.J, s.failed = f.J, X is None
        if X is not None:
            s.settle(problem.residual(X))
    search(problem, searches, runs)
    return searches


def _derive(problem: Searched, searches: Sequence[Search], runs: Runs, everything: bool = False) -> None:
    """Residuals and Jacobians of searches, simulated where they are.

    everything : else columns of what every artery has of its own, once simulated, are kept up to date.
    """
    by = [
        np.array([i for i, u in enumerate(s.unknowns) if everything or s.J is None or not u.group], int)
        for s in searches
    ]
    for s, i, found in zip(searches, by, problem.derivatives([s.member() for s in searches], runs, by), strict=True):
        if found is None or not np.abs(found[1]).max(initial=0.0) < _STEEPEST:
            s.failed = True
            continue
        J = np.empty((len(found[0]), len(s.x))) if s.J is None else s.J.copy()
        J[:, i] = found[1]
        s.J = J
        s.settle(found[0])
