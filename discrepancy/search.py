"""Searches of many hypotheses together: each asks for one simulation at a time, and those of all are one batch.

A damped Gauss–Newton step in every turn, whose Jacobian is kept up to date from the simulations themselves (Broyden
1965) and simulated anew now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from .fits import Member, bounded_step, bounds, penalty
from .terms import Term, Unknown

Array = np.ndarray

_LARGEST = 2.0  # of a step in x
_ROUNDS = 14  # simulations of a hypothesis at most
_FRESH = (4, 8)  # of them before which derivatives are simulated anew: by then the updated ones have led astray
_SMALL = 0.02  # decrease of the cost that ends a search, for each unit of cost per datum
_HOPELESS = 150.0  # by which a search may promise to stay above the best one and still go on


class Searched(Protocol):
    """What simulates hypotheses and compares them with a record."""

    def observe(self, members: Sequence[Member]) -> list[Array | None]:
        """Observations of every member; None where the simulation broke down."""
        ...

    def residual(self, X: Array) -> Array:
        """(n,) whitened."""
        ...

    def derivatives(self, points: Sequence[tuple[Member, Sequence[Unknown]]]) -> list[tuple[Array, Array] | None]:
        """z : (n,) and its columns (n, q) by some unknowns, at every point."""
        ...


class Search:
    """A damped Gauss–Newton search that asks for one simulation at a time."""

    def __init__(self, terms: tuple[Term, ...], unknowns: tuple[Unknown, ...], prior: Array, x: Array) -> None:
        self.terms, self.unknowns, self.prior, self.x = terms, unknowns, prior, x
        self.z: Array = np.zeros(0)
        self.J: Array | None = None
        self.damping, self.failed, self.converged = 0.0, False, False
        self.low, self.high = bounds(unknowns)
        self.cost = self.promise = np.inf
        self._step: Array = np.zeros_like(x)

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
        if z is None:
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


def search(problem: Searched, searches: Sequence[Search], known: float = np.inf) -> None:
    """Steps of all searches, one batch after the other, until none has any worth its simulation.

    known : the cost of a hypothesis found before; a search that promises to stay far above it ends.
    """
    _derive(problem, [s for s in searches if s.J is None])
    for turn in range(_ROUNDS):
        active = [s for s in searches if s.proposes()]
        best = min((s.cost for s in searches if not s.failed), default=known)
        active = [s for s in active if s.promise < min(best, known) + _HOPELESS]
        if not active:
            break
        if turn in _FRESH:
            _derive(problem, active)
            active = [s for s in active if s.proposes()]
        X = problem.observe([s.trial() for s in active])
        for s, x in zip(active, X, strict=True):
            s.answer(None if x is None else problem.residual(x))


def _derive(problem: Searched, searches: Sequence[Search]) -> None:
    """Residuals and Jacobians of searches, simulated where they are."""
    points = [(s.member(), s.unknowns) for s in searches]
    for s, found in zip(searches, problem.derivatives(points), strict=True):
        if found is None:
            s.failed = True
        else:
            s.J = found[1]
            s.settle(found[0])
