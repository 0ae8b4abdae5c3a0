"""What the model of a calibration lacks, as a random error of its channels: its size by evidence at the current point.

Every harmonic of a channel has an error of the standard deviation a s, independent of the others, where s is the
standard deviation of the channel's mean beat and a one number of the means, which zeros of sensors and heights shift,
and one of all harmonics, by restricted maximum likelihood (:mod:`fitting.inference.misfit`). Both are 0 where the
unknowns, refitted in the linear problem, leave noise alone. Far from the minimum they are large and the cost smooth; as
the search comes nearer they fall by themselves. Where the model is wrong they stay, and channels and harmonics count by
what is left of them in mmHg or mL/s, not by a noise far below that. All recordings and channels have the same two: with
its own each could be fitted at the cost of the others. Of one channel alone both are one: with an error of its own, the
one mean would be given up for the harmonics.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..records.noise import Target, pulses
from .calibration import Part, Problem
from .fit import Fit, Member
from .gauss_newton import LARGEST, Rules, Search, search
from .misfit import Block, estimated, settled

Array = np.ndarray

CHANCE = 4.0  # standard deviations of χ² from which more than noise is left
_ALTERNATIONS = 12  # of search and error, at most
_SAME = 0.1  # relative change of an error that changes no weight


@dataclass(frozen=True)
class Ended:
    """Where a search ended. errors : (2,) a of means and of harmonics. history : the cost at all points kept."""

    search: Search
    errors: Array
    history: tuple[float, ...]

    @property
    def cost(self) -> float:
        """-2 ln of likelihood and priors, up to a constant: comparable between searches with other errors."""
        return self.search.cost

    @property
    def batches(self) -> Sequence[Array]:
        """Of every recording where it ended."""
        assert self.search.here is not None
        found: Sequence[Array] = self.search.here.memory
        return found


def minimum(problem: Problem, x: Array, batches: Sequence[Array], rules: Rules) -> Ended:
    """The search from x : (p,), whose batches are known, in turn with the errors of the model."""
    errors, history = np.full(2, math.inf), list[float]()
    for _ in range(_ALTERNATIONS):
        told = model_errors(problem, x, batches)
        if np.all(np.abs(told - errors) <= _SAME * told):
            break
        errors, weighted = told, granted(problem, told)
        found = Search(Member((), problem.unknowns, x), rules, weighted.point(x, batches))
        search(weighted.evaluated, [found])
        assert found.here is not None
        x, batches, history = found.x, found.here.memory, [*history, *found.history]
    return Ended(found, errors, tuple(history))


def granted(problem: Problem, errors: Array) -> Problem:
    """The problem with errors (2,) of the model in the covariance of its data."""
    parts = []
    for part in problem.parts:
        assert part.target is not None
        t, size = part.target, pulses(part.beats, part.target.names)
        each = errors[np.minimum(np.arange(len(t.X)), 1)]
        wider = Target.of(t.names, t.X, t.covariance + (each**2)[:, None, None] * np.diag(size**2))
        parts.append(replace(part, target=wider, log_volume=wider.log_volume - t.log_volume))
    return replace(problem, parts=tuple(parts))


def model_errors(problem: Problem, x: Array, batches: Sequence[Array]) -> Array:
    """(2,) the errors that make what is left most probable, about x : (p,).

    The linear problem's own minimum counts as far as one step of the search reaches.
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
    lone = len(problem.parts) == 1 and len(problem.parts[0].simulator.names) == 1  # one mean tells no error of means
    each = zip(problem.parts, problem.rows(), strict=True)
    means, rest = estimated(fit, [block for part, rows in each for block in _blocks(part, rows.start, int(lone))], 2)
    return np.array([max(means, rest), rest])  # few means tell little of their error: it is not below the harmonics'


def _blocks(part: Part, start: int, of_means: int) -> Iterator[Block]:
    """The errors of every harmonic as they look in z, whose real parts of harmonics 1 … K come before the imaginary.

    of_means : the index of the error that means have.
    """
    assert part.target is not None
    white, m = part.target.whitener * pulses(part.beats, part.target.names), len(part.target.names)
    own = start + np.arange(m)
    yield Block(own, white[0].real, np.full(m, of_means))
    for k, W in enumerate(white[1:], 1):
        rows = np.concatenate([own + k * m, own + (k + len(white) - 1) * m])
        yield Block(rows, np.block([[W.real, -W.imag], [W.imag, W.real]]), np.ones(2 * m, int))


def octaves(part: Part) -> Array:
    """(n,) the octave of every number in a part's residual: harmonics 0 to 3 are one, then 4 to 7, 8 to 15 …"""
    K, m = part.simulator.K, len(part.simulator.names)
    each = np.maximum(np.log2(np.maximum(np.arange(K + 1), 1)).astype(int), 1)
    return np.concatenate([np.repeat(each, m), np.repeat(each[1:], m)])


def widening(problem: Problem, z: Array, paid: float) -> float:
    """By how much the covariance of the unknowns is too small: an error that is alike at all harmonics is less than
    that of the worst octave. z : (n,) whitened with the error; paid : numbers that the unknowns took of them."""
    left = z**2 * len(z) / max(len(z) - paid, 1.0)
    worst = [np.bincount(octaves(part), left[rows]) / np.maximum(np.bincount(octaves(part)), 1)
             for part, rows in zip(problem.parts, problem.rows(), strict=True)]  # fmt: skip
    return max(1.0, float(np.concatenate(worst).max()))
