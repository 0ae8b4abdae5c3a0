"""The problem of a calibration: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s the search (:mod:`fitting.inference.gauss_newton`) minimises |z(x)|² + Σ (x_i/s_i)²,
where z holds the residuals of all recordings, one after the other. One batch a recording gives z and its derivatives,
by finite differences, for little more than the price of z.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.harmonics import has_room
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
class Part:
    """One recording: its m channels up to harmonic K, and their simulation under its inflow.

    unknowns : the q that act in it; which : (q,) their numbers among all. target : what the record says, with its
    weights; None until they are known. log_volume : ln det of their covariance over that of the noise.
    """

    beats: Beats
    unknowns: tuple[Unknown, ...]
    which: Array
    simulator: Simulator
    meter: Meter
    target: Target | None = None
    log_volume: float = 0.0

    @property
    def size(self) -> int:
        """Numbers in its residual."""
        return len(self.simulator.names) * (2 * self.simulator.K + 1)

    def finer(self) -> Part:
        """The same with half the elements, to see what they do."""
        return replace(self, simulator=self.simulator.finer())

    def with_target(self, x: Array, error: Array) -> Part:
        """The part weighted for all unknowns x : (p,) and a solver's error (K+1, m)."""
        s = self.simulator
        own = parameter_values(self.unknowns, s.network, x[self.which])
        at = {name: float(value) for name, value in own.items()}
        H = linear_response(s.network, s.names, s.T, s.K, at)
        felt = varying(self.beats, s.network, s.names, s.K, at)
        return replace(self, target=target(self.beats, s.names, H, error, felt))

    def simulate(self, x: Array) -> Array:
        """Coefficients (B, K+1, m) of the periodic beat for its unknowns x : (B, q)."""
        parameters = parameter_values(self.unknowns, self.simulator.network, x)
        network = self.simulator.network
        X = self.simulator.coefficients(network, parameters, Runs(self.meter))
        if np.isnan(X).any():
            raise InputError(f"network {network.name}: it has no periodic beat with these values.")
        return X

    def batch(self, x: Array) -> Array:
        """Coefficients (1+q, K+1, m) at all unknowns x : (p,) and one step away from it along each of its own."""
        own = x[self.which]
        return self.simulate(np.concatenate([own[None], own + np.diag(finite_steps(self.unknowns, own, STEP))]))

    def point(self, x: Array, batch: Array) -> tuple[Array, Array]:
        """Residual (n,) and derivatives (n, p) at x : (p,) from its batch."""
        assert self.target is not None
        z = self.target.residual(batch)
        J = np.zeros((z.shape[1], len(x)))
        J[:, self.which] = (z[1:] - z[0]).T / finite_steps(self.unknowns, x[self.which], STEP)
        return z[0], J

    def rms(self, X: Array) -> dict[str, float]:
        """RMS over the beat [SI] by which simulated coefficients X : (K+1, m) miss each channel."""
        assert self.target is not None
        power = np.abs(X - self.target.X) ** 2
        return dict(zip(self.target.names, np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0)).tolist(), strict=True))


@dataclass(frozen=True)
class Problem:
    """Unknowns p of a network, and the recordings that tell them. Of a point the memory holds each part's batch."""

    unknowns: tuple[Unknown, ...]
    parts: tuple[Part, ...]

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

    def with_targets(self, x: Array, errors: Sequence[Array]) -> Problem:
        """The problem weighted for parameters x : (p,) and each part's error of the solver (K+1, m)."""
        weighted = [part.with_target(x, error) for part, error in zip(self.parts, errors, strict=True)]
        return replace(self, parts=tuple(weighted))

    def batches(self, x: Array) -> list[Array]:
        """Each part's batch at x : (p,)."""
        return [part.batch(x) for part in self.parts]

    def point(self, x: Array, batches: Sequence[Array]) -> Point:
        """Residual and derivatives at x from its batches."""
        z, J = zip(*(part.point(x, batch) for part, batch in zip(self.parts, batches, strict=True)), strict=True)
        return Point(np.concatenate(z), np.concatenate(J), sum(part.log_volume for part in self.parts), batches)

    def rows(self) -> list[slice]:
        """Each part's entries of z."""
        ends = np.cumsum([0, *(part.size for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def evaluated(self, trials: Sequence[Trial]) -> list[Point | None]:
        """Trials of :func:`fitting.inference.gauss_newton.search`; None where a simulation breaks down."""
        found: list[Point | None] = []
        for trial in trials:
            found.append(None)
            with suppress(*BROKEN):
                found[-1] = self.point(trial.member.x, self.batches(trial.member.x))
        return found

    def determined(self, point: Point, scale: float = 1.0) -> Determined:
        """What the data determine at a point; scale : of their covariance."""
        return determined(point.J * self.typical, self.prior, self.typical, scale, DERIVATIVE_ERROR)


def part_of(
    beats: Beats, network: Network, unknowns: tuple[Unknown, ...], which: Array, names: Sequence[str], K: int,
    settings: Settings, meter: Meter,
) -> Part:  # fmt: skip
    """The part of a recording; its beats are found by harmonic balance if that has room."""
    beyond = HARMONICS_BEYOND if has_room(network, K + HARMONICS_BEYOND, settings) else 0
    simulator = Simulator(network, inflow(beats, settings.dt, network), beats.T, tuple(names), K, settings,
                          tolerance=TOLERANCE, beyond=beyond)  # fmt: skip
    return Part(beats, unknowns, which, simulator, meter)
