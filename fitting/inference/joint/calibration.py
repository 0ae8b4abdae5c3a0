"""The problem of a calibration: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s the search (:mod:`fitting.inference.gauss_newton`) minimises |z(x)|² + Σ (x_i/s_i)²,
where z contains the residuals of all recordings (:mod:`~fitting.inference.joint.joint_record`). One batch per recording
gives z and its derivatives, by finite differences, at little more than the cost of z.

The residual has a model error besides, of the size that makes it most probable
(:mod:`~fitting.inference.joint.model_error`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.harmonics import has_room
from solver.network.description import Network

from ...records.alignment.beats import Beats
from ...records.channels.inflow import inflow
from ..fit import Array, Fit, Member
from ..gauss_newton import Trial
from ..intervals import Determined, determined
from ..model_discrepancy import worst_octave
from ..models.network import NetworkProblem
from ..models.simulator import HARMONICS_BEYOND, Simulator
from ..runs import Runs
from ..unknown import Unknown, parameter_values, split_zeros
from .joint_record import Several
from .model_error import networks

# Of x in prior units. The truncation error and jumps by one more iteration of a stage are then both about 1e-4 of the
# derivative (measured, sheep network)
STEP = 3e-4
DERIVATIVE_ERROR = 5e-4
TOLERANCE = 1e-7  # of periodic beats, whose small differences give the derivatives


@dataclass(frozen=True)
class Problem:
    """Unknowns p of a network, and the recordings that determine them.

    records : beats and simulation of each. whole : the recordings with their weights, which follow from a point of the
    unknowns (:meth:`weighted`); without parts until then.
    """

    unknowns: tuple[Unknown, ...]
    records: tuple[tuple[Beats, Simulator], ...]
    whole: Several
    runs: Runs

    @property
    def typical(self) -> Array:
        """(p,) prior standard deviations, or typical ones: the unit of x in the search."""
        return np.array([u.typical_sd for u in self.unknowns])

    @property
    def prior(self) -> Array:
        """(p,) prior precision in those units: 1 for unknowns with a prior, otherwise 0."""
        return np.array([0.0 if u.prior_sd is None else 1.0 for u in self.unknowns])

    @property
    def parts(self) -> tuple[NetworkProblem, ...]:
        """The weighted recordings."""
        return networks(self.whole)

    def own(self, i: int) -> tuple[tuple[Unknown, ...], Array]:
        """The unknowns of recording i, and their indices among all."""
        return self.whole.own(self.unknowns, i)

    def weighted(self, x: Array, errors: Sequence[Array]) -> Problem:
        """The problem weighted for x : (p,) and each recording's solver error (K+1, m)."""
        member = Member((), self.unknowns, x)
        parts = tuple(
            NetworkProblem.of(beats, simulator, self.whole.member(member, i), error, step=STEP)
            for i, ((beats, simulator), error) in enumerate(zip(self.records, errors, strict=True))
        )
        return replace(self, whole=replace(self.whole, parts=parts))

    def cut(self, x: Array) -> Problem:
        """The problem with elements for the lengths at x : (p,), not yet weighted."""
        records = list[tuple[Beats, Simulator]]()
        for i, (beats, simulator) in enumerate(self.records):
            unknowns, mine = self.own(i)
            values = parameter_values(unknowns, simulator.network, x[mine])
            records.append((beats, simulator.cut({name: float(value) for name, value in values.items()})))
        return replace(self, records=tuple(records), whole=replace(self.whole, parts=()))

    def at(self, x: Array) -> Fit:
        """The point x : (p,) as a fit. Raises the error of the recording whose simulation fails."""
        member = Member((), self.unknowns, x)
        (point,) = self.whole.points([Trial(member, np.arange(len(x)), None, 0.0 * x)], self.runs)
        if point is None:
            self._fail(member)
        return Fit((), self.unknowns, x, point.z, point.J, *self.whole.entries)

    def _fail(self, member: Member) -> NoReturn:
        """Simulate each recording by itself, which raises the error of the one that fails."""
        for i, part in enumerate(self.parts):
            own = self.whole.member(member, i)
            values, _ = split_zeros(parameter_values(own.unknowns, part.network, own.x), part.network)
            part.simulator.coefficients(part.network, values, self.runs)
        raise InputError(f"network {self.parts[0].network.name}: it has no periodic beat with these values.")

    def determined(self, J: Array, scale: float = 1.0) -> Determined:
        """The directions that the data determine, by the Jacobian (n, p); scale : of their covariance."""
        return determined(J * self.typical, self.prior, self.typical, scale, DERIVATIVE_ERROR)


def recorded(
    beats: Beats, network: Network, names: Sequence[str], K: int, settings: Settings
) -> tuple[Beats, Simulator]:
    """A recording with its simulation, by harmonic balance if that fits into memory."""
    beyond = HARMONICS_BEYOND if has_room(network, K + HARMONICS_BEYOND, settings) else 0
    simulator = Simulator(network, inflow(beats, settings.dt, network), beats.T, tuple(names), K, settings,
                          tolerance=TOLERANCE, beyond=beyond)  # fmt: skip
    return beats, simulator.cut({})


def widening(problem: Problem, z: Array, paid: float) -> float:
    """Factor by which the covariance of the unknowns is too small, by the worst octave of a channel. z : (n,) whitened
    with the error; paid : degrees of freedom of the unknowns."""
    scaled, worst = z**2 * len(z) / max(len(z) - paid, 1.0), 1.0
    for part, rows in zip(problem.parts, problem.whole.rows, strict=True):
        worst = max(worst, worst_octave(scaled[rows], part.entries[0]))
    return worst
