"""The problem of a calibration: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s the search (:mod:`fitting.inference.gauss_newton`) minimises |z(x)|² + Σ (x_i/s_i)²,
where z contains the residuals of all recordings (:mod:`~fitting.inference.joint.joint_record`). One batch per recording
gives z and its derivatives, by finite differences, at little more than the cost of z.

Model discrepancy is a random error of the channels; its size is estimated from the evidence at the current point.

Every harmonic of a channel has an independent error of standard deviation a s, where s is the standard deviation of the
channel's mean beat. There are two factors a, one of the means, which sensor zeros and heights shift, and one of all
harmonics, estimated by restricted maximum likelihood (:mod:`fitting.inference.model_discrepancy`). Both are 0 if the
unknowns, refitted in the linear problem, leave only noise. Far from the minimum they are large and the cost is smooth;
they shrink as the search approaches it. For a wrong model they remain, and channels and harmonics count by their
residual in mmHg or mL/s, not by a noise far below it. All recordings and channels share the two factors: with own ones,
one could be fitted at the cost of the others. For a single channel the two factors are one: otherwise its only mean
would be sacrificed to the harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NoReturn

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.harmonics import has_room
from solver.network.description import Network

from ...records.alignment.beats import Beats
from ...records.channels.inflow import inflow
from ...records.channels.noise import pulses
from ..fit import Fit, Member
from ..gauss_newton import LARGEST, Point, Rules, Search, Trial, search
from ..intervals.identify import Determined, determined
from ..model_discrepancy import Block, estimated, settled
from ..models.network import NetworkProblem
from ..models.simulator import HARMONICS_BEYOND, Simulator
from ..runs import Runs
from ..unknown import Unknown, parameter_values
from ..zeros import apart
from .joint_record import Several

Array = np.ndarray

# Of x in prior units. The truncation error and jumps by one more iteration of a stage are then both about 1e-4 of the
# derivative (measured, sheep network)
STEP = 3e-4
DERIVATIVE_ERROR = 5e-4
TOLERANCE = 1e-7  # of periodic beats, whose small differences give the derivatives
# Of the pulsation (rms): largest error of the means of several recordings, 1 or 2 mmHg of a pressure. A zero that is
# off by more is common to the recordings and can be freed. Without a limit the few means are given up for the
# harmonics, and with them all that only other flows show
MEANS = 0.1
CHANCE = 4.0  # standard deviations of χ² above which more than noise remains
# Predicted gain of a search that ended without a better step, which moves no value by more than a third of its standard
# deviation. Beside a large residual, whose curvature the linear problem leaves out, the prediction is not reached
_NEGLIGIBLE = 0.1
_ALTERNATIONS = 12  # of search and error estimate, at most
_SAME = 0.1  # relative change of an error that is negligible


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
        return tuple(part for part in self.whole.parts if isinstance(part, NetworkProblem))

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

    @property
    def moves_elements(self) -> bool:
        """True if an unknown changes lengths of segments."""
        return any(name.endswith(".L") for u in self.unknowns for name in u.variables)

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
            values, _ = apart(parameter_values(own.unknowns, part.network, own.x), part.network)
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


# --- errors of the model ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """The end of a search. fit : there, whitened without model errors. errors : (2,) a of means and of harmonics.
    history : the cost, -2 ln of likelihood and priors up to a constant, at all accepted points: comparable between
    searches with different errors. converged : at a minimum."""

    fit: Fit
    errors: Array
    history: tuple[float, ...]
    converged: bool


def minimum(problem: Problem, fit: Fit, rules: Rules) -> Ended:
    """Search from a point, alternating with estimates of the model errors."""
    errors, history, converged = np.full(2, math.inf), list[float](), False
    for _ in range(_ALTERNATIONS):
        told = model_errors(problem, fit)
        if np.all(np.abs(told - errors) <= _SAME * told):
            break
        errors, wide = told, granted(problem, told)
        (begun,) = wide.whole.restated([fit], problem.whole)
        found = Search(begun.member, rules, Point(begun.z, begun.J))
        search(partial(wide.whole.points, runs=problem.runs), [found])
        (fit,) = problem.whole.restated([found.fit(*problem.whole.entries)], wide.whole)
        pairs = zip(wide.parts, problem.parts, strict=True)
        volume = sum(part.target.log_volume - exact.target.log_volume for part, exact in pairs)
        history = [*history, *(cost + volume for cost in found.history)]
        converged = found.converged or found.cost - found.promised() < _NEGLIGIBLE
    return Ended(fit, errors, tuple(history), converged)


def granted(problem: Problem, errors: Array) -> Problem:
    """The problem with model errors (2,) in the covariance of its data."""
    parts = [part.granted(errors[np.minimum(np.arange(part.K + 1), 1)], alike=True) for part in problem.parts]
    return replace(problem, whole=replace(problem.whole, parts=tuple(parts)))


def model_errors(problem: Problem, fit: Fit) -> Array:
    """(2,) the model errors that make the residual of a fit most probable.

    The residual is that of the linear problem's minimum, within the reach of one step of the search.
    """
    n, free = len(fit.z), np.array([u.low < u.high for u in problem.unknowns], bool)
    near = tuple(
        replace(u, low=u.low - here, high=u.high - here, prior_sd=LARGEST * u.typical_sd)
        for u, here in zip(problem.unknowns, fit.x, strict=True)
        if u.low < u.high
    )
    linear = replace(fit, unknowns=near, x=np.zeros(len(near)), J=fit.J[:, free])
    if settled(linear).chi2 < n + CHANCE * math.sqrt(2.0 * n):
        return np.zeros(2)
    lone = len(problem.parts) == 1 and len(problem.parts[0].signals) == 1  # one mean gives no error of means
    each = zip(problem.parts, problem.whole.rows, strict=True)
    means, rest = estimated(linear, [block for part, rows in each for block in _blocks(part, rows.start, int(lone))], 2)
    if len(problem.parts) > 1:
        means = min(means, MEANS)
    return np.array([max(means, rest), rest])  # few means determine it poorly: at least that of the harmonics


def _blocks(part: NetworkProblem, start: int, of_means: int) -> Iterator[Block]:
    """The errors of every harmonic in z, where real parts of harmonics 1 … K precede the imaginary ones.

    of_means : the index of the error of the means.
    """
    white, m = part.target.whitener * pulses(part.beats, part.signals), len(part.signals)
    own = start + np.arange(m)
    yield Block(own, white[0].real, np.full(m, of_means))
    for k, W in enumerate(white[1:], 1):
        rows = np.concatenate([own + k * m, own + (k + len(white) - 1) * m])
        yield Block(rows, np.block([[W.real, -W.imag], [W.imag, W.real]]), np.ones(2 * m, int))


def widening(problem: Problem, z: Array, paid: float) -> float:
    """Factor by which the covariance of the unknowns is too small. An error that is equal at all harmonics
    underestimates that of the worst octave: harmonics 0 to 3, then 4 to 7, 8 to 15 … z : (n,) whitened with the error;
    paid : degrees of freedom of the unknowns."""
    left, worst = z**2 * len(z) / max(len(z) - paid, 1.0), 1.0
    for part, rows in zip(problem.parts, problem.whole.rows, strict=True):
        octave = np.maximum(np.log2(np.maximum(part.entries[0], 1)).astype(int), 1)
        worst = max(worst, float((np.bincount(octave, left[rows]) / np.maximum(np.bincount(octave), 1)).max()))
    return worst
