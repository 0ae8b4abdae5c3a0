"""Unknowns of a network by damped Gauss–Newton: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s it minimises |z(x)|² + Σ (x_i/s_i)². One batch gives z and its derivatives, by
finite differences, for little more than the price of z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import Settings
from solver.network import Network
from solver.simulate import BROKEN

from ..records.beats import Beats
from ..records.inflow import inflow
from ..records.noise import NEIGHBOURS, Target, response, target
from .identify import Determined, determined
from .search import held_step
from .simulator import HARMONICS_BEYOND, Meter, Runs, Simulator, varying
from .unknown import Unknown, bounds, finite_steps, parameter_values, penalty

Array = np.ndarray

# Of x in prior units: truncation and the jumps where a stage takes one iteration more are then both some 1e-4 of the
# derivative (measured, sheep network)
STEP = 3e-4
TOLERANCE = 1e-7  # of periodic beats, whose small differences are the derivatives
DERIVATIVE_ERROR = 5e-4
_EQUAL = 1e-4  # rise of the cost that is taken for none: derivatives are not exact, and 1 is a standard deviation
_LARGEST = 3.0  # of a step, in prior units


@dataclass(frozen=True)
class Point:
    """x : (p,), z : (n,) whitened residual, J : (n, p) its derivatives; cost : data and prior.

    batch : (1+p, K+1, m) coefficients there and one step away along each unknown.
    """

    x: Array
    z: Array
    J: Array
    batch: Array
    cost: float


@dataclass(frozen=True)
class Problem:
    """Unknowns p of a network, a record's m channels up to harmonic K, and their simulation.

    target : what the record says, with its weights; None until they are known.
    """

    beats: Beats
    unknowns: tuple[Unknown, ...]
    simulator: Simulator
    meter: Meter
    target: Target | None = None

    @property
    def typical(self) -> Array:
        """(p,) prior standard deviations, or what they would be: the unit of x in the search."""
        return np.array([u.typical_sd for u in self.unknowns])

    @property
    def prior(self) -> Array:
        """(p,) 1 where an unknown has a prior, 0 where not: its precision in those units."""
        return np.array([0.0 if u.prior_sd is None else 1.0 for u in self.unknowns])

    @property
    def bounds(self) -> tuple[Array, Array]:
        """(p,) lowest and highest x."""
        return bounds(self.unknowns)

    def finer(self) -> Problem:
        """The same with half the elements, to see what they do."""
        return replace(self, simulator=self.simulator.finer())

    def with_target(self, x: Array, error: Array) -> Problem:
        """The problem weighted for parameters x : (p,) and a solver's error (K+1, m)."""
        s = self.simulator
        at = {name: float(value) for name, value in parameter_values(self.unknowns, s.network, x).items()}
        H = response(s.network, s.names, s.T, s.K + NEIGHBOURS, at)
        felt = varying(self.beats, s.network, s.names, s.K, at)
        return replace(self, target=target(self.beats, s.names, H, error, felt))

    def simulate(self, x: Array) -> Array:
        """Coefficients (B, K+1, m) of the periodic beat for x : (B, p)."""
        network = self.simulator.network
        parameters = parameter_values(self.unknowns, network, x)
        return self.simulator.coefficients(network, parameters, Runs(self.meter), alike=True)

    def batch(self, x: Array) -> Array:
        """Coefficients (1+p, K+1, m) at x and one step away from it along each unknown."""
        return self.simulate(np.concatenate([x[None], x + np.diag(finite_steps(self.unknowns, x, STEP))]))

    def point(self, x: Array, batch: Array) -> Point:
        """Residual and derivatives at x from its batch."""
        assert self.target is not None
        z = self.target.residual(batch)
        cost = float(z[0] @ z[0]) + penalty(self.prior, x / self.typical, np.inf)
        return Point(x, z[0], (z[1:] - z[0]).T / finite_steps(self.unknowns, x, STEP), batch, cost)

    def evaluate(self, x: Array) -> Point:
        """Simulate at x and around it. Raises NonPhysicalState, NotPeriodic as the solver."""
        return self.point(x, self.batch(x))

    def determined(self, point: Point, scale: float = 1.0) -> Determined:
        """What the data determine at a point; scale : of their covariance."""
        return determined(point.J * self.typical, self.prior, self.typical, scale, DERIVATIVE_ERROR)


def problem_of(
    beats: Beats, network: Network, unknowns: tuple[Unknown, ...], names: Sequence[str], K: int, settings: Settings,
    meter: Meter,
) -> Problem:  # fmt: skip
    """The problem of a record; its beats are found by harmonic balance."""
    simulator = Simulator(network, inflow(beats, settings.dt), beats.T, tuple(names), K, settings,
                          tolerance=TOLERANCE, beyond=HARMONICS_BEYOND)  # fmt: skip
    return Problem(beats, unknowns, simulator, meter)


# --- the search -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Descent:
    """Where a search ended. history : the cost after each iteration. converged : whether it settled."""

    point: Point
    history: tuple[float, ...]
    converged: bool


def minimise(problem: Problem, point: Point, max_iterations: int, enough: tuple[float, float]) -> Descent:
    """Damped Gauss–Newton from a point, until no unknown moves by more than a part of its standard deviation, or of its
    prior's: ``enough``."""
    history = [point.cost]
    for _ in range(max_iterations):
        known = problem.determined(point)
        step = _step(problem, point, known, 0.0)
        small = np.maximum(enough[0] * np.sqrt(np.diag(known.covariance)), enough[1] * problem.typical)
        if np.all(np.abs(step) <= small):
            return Descent(point, tuple(history), True)
        better = _line(problem, point, known, step)
        if better is None:
            return Descent(point, tuple(history), False)
        gained, point = point.cost - better.cost, better
        history.append(point.cost)
        if gained < enough[0] ** 2:  # as much as the same part of a standard deviation would gain
            return Descent(point, tuple(history), True)
    return Descent(point, tuple(history), False)


def _line(problem: Problem, point: Point, known: Determined, step: Array) -> Point | None:
    """The next point: the full step, else halved (the simulation breaks down) or damped (the cost rises) ones."""
    low, high = problem.bounds
    damping, shorter = 0.0, 1.0
    for _ in range(8):
        try:
            trial = problem.evaluate(np.clip(point.x + shorter * step, low, high))
        except BROKEN:
            shorter /= 2.0
            continue
        if trial.cost < point.cost + _EQUAL:
            return trial
        damping = max(10.0 * damping, 1e-3 * float(known.singular_values[0]) ** 2)
        step = _step(problem, point, known, damping)
    return None


def _step(problem: Problem, point: Point, known: Determined, damping: float) -> Array:
    """Gauss–Newton step of x : (p,), damped by ``damping`` in prior units, with bounds that would be crossed held."""
    typical, prior = problem.typical, problem.prior
    low, high = problem.bounds
    J = point.J * typical
    gradient = J.T @ point.z + prior * point.x / typical
    # along directions that the Jacobian's error alone makes up, a step would be a leap in the dark
    blind = np.where(known.singular_values > 0.0, 0.0, known.doubt**2)
    normal = J.T @ J + np.diag(prior + damping) + known.directions.T @ (blind[:, None] * known.directions)
    step = held_step(normal, gradient, point.x / typical, low / typical, high / typical, 1e-13)
    longest = np.abs(step).max()
    return typical * step * min(1.0, _LARGEST / longest) if longest > 0.0 else step
