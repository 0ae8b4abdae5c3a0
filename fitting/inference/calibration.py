"""The problem of a calibration: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s the search (:mod:`fitting.inference.gauss_newton`) minimises |z(x)|² + Σ (x_i/s_i)².
One batch gives z and its derivatives, by finite differences, for little more than the price of z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from solver import Settings
from solver.network import Network
from solver.simulate import BROKEN

from ..records.beats import Beats
from ..records.inflow import inflow
from ..records.noise import Target, target
from .gauss_newton import Point, Trial
from .identify import Determined, determined
from .simulator import HARMONICS_BEYOND, Meter, Runs, Simulator, linear_response, varying
from .unknown import Unknown, bounds, finite_steps, parameter_values

Array = np.ndarray

# Of x in prior units: truncation and the jumps where a stage takes one iteration more are then both some 1e-4 of the
# derivative (measured, sheep network)
STEP = 3e-4
DERIVATIVE_ERROR = 5e-4
TOLERANCE = 1e-7  # of periodic beats, whose small differences are the derivatives


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
        H = linear_response(s.network, s.names, s.T, s.K, at)
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
        return Point(z[0], (z[1:] - z[0]).T / finite_steps(self.unknowns, x, STEP), memory=batch)

    def evaluated(self, trials: Sequence[Trial]) -> list[Point | None]:
        """Trials of :func:`fitting.inference.gauss_newton.search`; None where a simulation breaks down."""
        found: list[Point | None] = []
        for trial in trials:
            found.append(None)
            with suppress(*BROKEN):
                found[-1] = self.point(trial.member.x, self.batch(trial.member.x))
        return found

    def determined(self, point: Point, scale: float = 1.0) -> Determined:
        """What the data determine at a point; scale : of their covariance."""
        return determined(point.J * self.typical, self.prior, self.typical, scale, DERIVATIVE_ERROR)


def problem_of(
    beats: Beats, network: Network, unknowns: tuple[Unknown, ...], names: Sequence[str], K: int, settings: Settings,
    meter: Meter,
) -> Problem:  # fmt: skip
    """The problem of a record; its beats are found by harmonic balance."""
    simulator = Simulator(network, inflow(beats, settings.dt, network), beats.T, tuple(names), K, settings,
                          tolerance=TOLERANCE, beyond=HARMONICS_BEYOND)  # fmt: skip
    return Problem(beats, unknowns, simulator, meter)
