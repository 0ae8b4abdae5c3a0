"""The problem of a calibration: the whitened residual with its derivatives, by batches of the solver.

With priors of standard deviation s the search (:mod:`fitting.inference.gauss_newton`) minimises |z(x)|² + Σ (x_i/s_i)²,
where z contains the residuals of all recordings, one after the other. One batch per recording gives z and its
derivatives, by finite differences, at little more than the cost of z.

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

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.harmonics import has_room
from solver.laws.catalogue import zero_of
from solver.network.description import Network
from solver.simulate import BROKEN

from ...records.alignment.beats import Beats
from ...records.channels.inflow import inflow
from ...records.channels.noise import Target, pulses, target
from ..fit import Fit, Member
from ..gauss_newton import LARGEST, Point, Rules, Search, Trial, one_by_one, search
from ..intervals.identify import Determined, determined
from ..model_discrepancy import Block, estimated, settled
from ..runs import Meter, Runs
from ..unknown import Unknown, finite_steps, parameter_values
from ..zeros import apart, unmoved, zero_name
from .simulator import HARMONICS_BEYOND, Simulator, linear_response, varying

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
_ALTERNATIONS = 12  # of search and error estimate, at most
_SAME = 0.1  # relative change of an error that is negligible


@dataclass(frozen=True)
class Part:
    """One recording: its m channels up to harmonic K, and their simulation under its inflow.

    unknowns : the q that affect it; which : (q,) their indices among all. target : its data with their weights; None
    until these are known. log_volume : ln det of their covariance over that of the noise.
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
        """Number of entries of its residual."""
        return len(self.simulator.names) * (2 * self.simulator.K + 1)

    def with_target(self, x: Array, error: Array) -> Part:
        """The part weighted for all unknowns x : (p,) and a solver error (K+1, m)."""
        s = self.simulator
        own, _ = apart(parameter_values(self.unknowns, s.network, x[self.which]), s.network)
        at = {name: float(value) for name, value in own.items()}
        H = linear_response(s.network, s.names, s.T, s.K, at)
        felt = varying(self.beats, s.network, s.names, s.K, at)
        return replace(self, target=target(self.beats, s.names, H, error, felt))

    def simulate(self, x: Array) -> Array:
        """Coefficients (B, K+1, m) of the periodic beat for its unknowns x : (B, q)."""
        network = self.simulator.network
        parameters, zeros = apart(parameter_values(self.unknowns, network, x), network)
        parameters = parameters or unmoved(network, len(x))
        X = self.simulator.coefficients(network, parameters, Runs(self.meter))
        for i, name in enumerate(self.simulator.names):
            X[:, 0, i] += zeros.get(zero_name(name), zero_of(network, name)) - zero_of(network, name)
        if np.isnan(X).any():
            raise InputError(f"network {network.name}: it has no periodic beat with these values.")
        return X

    def batch(self, x: Array) -> Array:
        """Coefficients (1+q, K+1, m) at all unknowns x : (p,) and one step away along each of its own."""
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
        """RMS residual over the beat [SI] of simulated coefficients X : (K+1, m), by channel."""
        assert self.target is not None
        power = np.abs(X - self.target.X) ** 2
        return dict(zip(self.target.names, np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0)).tolist(), strict=True))


@dataclass(frozen=True)
class Problem:
    """Unknowns p of a network, and the recordings that determine them. A point's memory has each part's batch."""

    unknowns: tuple[Unknown, ...]
    parts: tuple[Part, ...]

    @property
    def typical(self) -> Array:
        """(p,) prior standard deviations, or typical ones: the unit of x in the search."""
        return np.array([u.typical_sd for u in self.unknowns])

    @property
    def prior(self) -> Array:
        """(p,) prior precision in those units: 1 for unknowns with a prior, otherwise 0."""
        return np.array([0.0 if u.prior_sd is None else 1.0 for u in self.unknowns])

    def with_targets(self, x: Array, errors: Sequence[Array]) -> Problem:
        """The problem weighted for parameters x : (p,) and each part's solver error (K+1, m)."""
        weighted = [part.with_target(x, error) for part, error in zip(self.parts, errors, strict=True)]
        return replace(self, parts=tuple(weighted))

    def batches(self, x: Array) -> list[Array]:
        """Each part's batch at x : (p,)."""
        return [part.batch(x) for part in self.parts]

    def point(self, x: Array, batches: Sequence[Array]) -> Point:
        """Residual and derivatives at x from its batches."""
        z, J = zip(*(part.point(x, batch) for part, batch in zip(self.parts, batches, strict=True)), strict=True)
        return Point(np.concatenate(z), np.concatenate(J), sum(part.log_volume for part in self.parts), batches)

    def simulated(self, trial: Trial) -> Point:
        """The point of a trial."""
        return self.point(trial.member.x, self.batches(trial.member.x))

    def rows(self) -> list[slice]:
        """Each part's entries of z."""
        ends = np.cumsum([0, *(part.size for part in self.parts)])
        return [slice(int(a), int(b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]

    def determined(self, point: Point, scale: float = 1.0) -> Determined:
        """The directions that the data determine at a point; scale : of their covariance."""
        return determined(point.J * self.typical, self.prior, self.typical, scale, DERIVATIVE_ERROR)


def part_of(
    beats: Beats, network: Network, unknowns: tuple[Unknown, ...], which: Array, names: Sequence[str], K: int,
    settings: Settings, meter: Meter,
) -> Part:  # fmt: skip
    """The part of a recording; its beats are found by harmonic balance if that fits into memory."""
    beyond = HARMONICS_BEYOND if has_room(network, K + HARMONICS_BEYOND, settings) else 0
    simulator = Simulator(network, inflow(beats, settings.dt, network), beats.T, tuple(names), K, settings,
                          tolerance=TOLERANCE, beyond=beyond)  # fmt: skip
    return Part(beats, unknowns, which, simulator, meter)


# --- errors of the model ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ended:
    """The end of a search. errors : (2,) a of means and of harmonics. history : the cost, -2 ln of likelihood and
    priors up to a constant, at all accepted points: comparable between searches with different errors."""

    search: Search
    errors: Array
    history: tuple[float, ...]

    @property
    def batches(self) -> Sequence[Array]:
        """The batch of every recording at the end."""
        assert self.search.here is not None
        found: Sequence[Array] = self.search.here.memory
        return found


def minimum(problem: Problem, x: Array, batches: Sequence[Array], rules: Rules) -> Ended:
    """Search from x : (p,), whose batches are known, alternating with estimates of the model errors."""
    errors, history = np.full(2, math.inf), list[float]()
    for _ in range(_ALTERNATIONS):
        told = model_errors(problem, x, batches)
        if np.all(np.abs(told - errors) <= _SAME * told):
            break
        errors, weighted = told, granted(problem, told)
        found = Search(Member((), problem.unknowns, x), rules, weighted.point(x, batches))
        search(one_by_one(weighted.simulated, *BROKEN), [found])
        assert found.here is not None
        x, batches, history = found.x, found.here.memory, [*history, *found.history]
    return Ended(found, errors, tuple(history))


def granted(problem: Problem, errors: Array) -> Problem:
    """The problem with model errors (2,) in the covariance of its data."""
    parts = []
    for part in problem.parts:
        assert part.target is not None
        t, size = part.target, pulses(part.beats, part.target.names)
        each = errors[np.minimum(np.arange(len(t.X)), 1)]
        wider = Target.of(t.names, t.X, t.covariance + (each**2)[:, None, None] * np.diag(size**2))
        parts.append(replace(part, target=wider, log_volume=wider.log_volume - t.log_volume))
    return replace(problem, parts=tuple(parts))


def model_errors(problem: Problem, x: Array, batches: Sequence[Array]) -> Array:
    """(2,) the model errors that make the residual about x : (p,) most probable.

    The residual is that of the linear problem's minimum, within the reach of one step of the search.
    """
    point = problem.point(x, batches)
    n, free = len(point.z), np.array([u.low < u.high for u in problem.unknowns], bool)
    near = tuple(
        replace(u, low=u.low - here, high=u.high - here, prior_sd=LARGEST * u.typical_sd)
        for u, here in zip(problem.unknowns, x, strict=True)
        if u.low < u.high
    )
    fit = Fit((), near, np.zeros(len(near)), point.z, point.J[:, free], np.zeros(n, int), np.zeros(n, int))
    if settled(fit).chi2 < n + CHANCE * math.sqrt(2.0 * n):
        return np.zeros(2)
    lone = len(problem.parts) == 1 and len(problem.parts[0].simulator.names) == 1  # one mean gives no error of means
    each = zip(problem.parts, problem.rows(), strict=True)
    means, rest = estimated(fit, [block for part, rows in each for block in _blocks(part, rows.start, int(lone))], 2)
    if len(problem.parts) > 1:
        means = min(means, MEANS)
    return np.array([max(means, rest), rest])  # few means determine it poorly: at least that of the harmonics


def _blocks(part: Part, start: int, of_means: int) -> Iterator[Block]:
    """The errors of every harmonic in z, where real parts of harmonics 1 … K precede the imaginary ones.

    of_means : the index of the error of the means.
    """
    assert part.target is not None
    white, m = part.target.whitener * pulses(part.beats, part.target.names), len(part.target.names)
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
    for part, rows in zip(problem.parts, problem.rows(), strict=True):
        each = np.maximum(np.log2(np.maximum(np.arange(part.simulator.K + 1), 1)).astype(int), 1)
        octave = np.repeat(np.concatenate([each, each[1:]]), len(part.simulator.names))
        worst = max(worst, float((np.bincount(octave, left[rows]) / np.maximum(np.bincount(octave), 1)).max()))
    return worst
