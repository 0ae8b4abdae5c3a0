"""The residual of a network calibration and its derivatives, by batches of the solver."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver import Settings, simulate_periodic
from solver.network import Network

from ..records.beats import Beats
from ..records.noise import NEIGHBOURS, Target, inflow, response, target
from .unknown import Unknown, parameter_values

Array = np.ndarray
Progress = Callable[[float, str], None]

# Of x in prior units: truncation and the jumps where a stage takes one iteration more are then both some 1e-4 of the
# derivative (measured, sheep network)
STEP = 3e-4
DERIVATIVE_ERROR = 5e-4
_COARSE = 2.5  # steps of the coarse stage, in those of the fine one
_SHORTEST = 100  # steps in a beat that the coarse stage needs


@dataclass
class Meter:
    """Counts simulations and reports how far a stage is; a stage takes some four of them."""

    progress: Progress | None
    simulations: int = 0
    span: tuple[float, float] = (0.0, 1.0)
    label: str = ""
    done: int = 0

    def stage(self, low: float, high: float, label: str) -> None:
        self.span, self.label, self.done = (low, high), label, 0

    def simulated(self, members: int) -> None:
        self.simulations += members
        self.done += 1
        if self.progress:
            low, high = self.span
            self.progress(low + (high - low) * (1.0 - 0.6**self.done), f"{self.label}, simulation {self.done}")


@dataclass(frozen=True)
class Point:
    """x : (p,), z : (n,) whitened residual, J : (n, p) its derivatives, X : (K+1, m); cost : data and prior."""

    x: Array
    z: Array
    J: Array
    X: Array
    cost: float


@dataclass(frozen=True)
class Problem:
    """Unknowns p of a network, a record's m channels up to harmonic K, and how finely to simulate.

    tolerance : of the periodic beat. target : what the record says, with its weights; None until they are known.
    """

    beats: Beats
    network: Network
    unknowns: tuple[Unknown, ...]
    names: tuple[str, ...]
    K: int
    settings: Settings
    meter: Meter
    tolerance: float = 1e-6
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
        return np.array([u.low for u in self.unknowns]), np.array([u.high for u in self.unknowns])

    def coarser(self) -> Problem:
        """The same with longer steps, to come near."""
        dt = max(self.settings.dt, min(_COARSE * self.settings.dt, self.beats.T / _SHORTEST))
        return replace(self, settings=replace(self.settings, dt=dt), tolerance=1e-4)

    def finer(self) -> Problem:
        """The same with half the step, to see what the step does."""
        return replace(self, settings=replace(self.settings, dt=self.settings.dt / 2.0))

    def with_target(self, x: Array, error: Array) -> Problem:
        """The problem weighted for parameters x : (p,) and a solver's error (K+1, m)."""
        at = {name: float(value) for name, value in parameter_values(self.unknowns, self.network, x).items()}
        H = response(self.network, self.names, self.beats.T, self.K + NEIGHBOURS, at)
        return replace(self, target=target(self.beats, self.names, H, error))

    def simulate(self, x: Array) -> Array:
        """Coefficients (B, K+1, m) of the periodic beat for x : (B, p)."""
        beat = simulate_periodic(
            self.network,
            inflow(self.beats, self.settings.dt),
            self.beats.T,
            parameters=parameter_values(self.unknowns, self.network, x),
            settings=self.settings,
            tolerance=self.tolerance,
        )
        self.meter.simulated(len(x))
        waves = np.stack([beat[name][:, :-1] for name in self.names], axis=-1)
        return np.fft.rfft(waves, axis=1, norm="forward")[:, : self.K + 1]

    def steps(self, x: Array) -> Array:
        """(p,) steps of the finite differences, away from an upper bound."""
        steps = STEP * self.typical
        return np.where(x + steps > self.bounds[1], -steps, steps)

    def batch(self, x: Array) -> Array:
        """Coefficients (1+p, K+1, m) at x and one step away from it along each unknown."""
        return self.simulate(np.concatenate([x[None], x + np.diag(self.steps(x))]))

    def point(self, x: Array, batch: Array) -> Point:
        """Residual and derivatives at x from its batch."""
        assert self.target is not None
        z = self.target.residual(batch)
        cost = float(z[0] @ z[0] + np.sum(self.prior * (x / self.typical) ** 2))
        return Point(x, z[0], (z[1:] - z[0]).T / self.steps(x), batch[0], cost)

    def evaluate(self, x: Array) -> Point:
        """Simulate at x and around it. Raises NonPhysicalState, NotPeriodic as the solver."""
        return self.point(x, self.batch(x))
