"""The error of a network model: a random error of the channels, whose size is estimated as the fit proceeds.

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
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ...records.channels.noise import pulses
from ..fit import Array, Fit
from ..gauss_newton import LARGEST, Point, Rules, Search, search
from ..model_discrepancy import LARGEST as LARGEST_ERROR
from ..model_discrepancy import Block, estimated, settled
from ..models.network import NetworkProblem
from ..runs import Runs
from .joint_record import Several

Networks = NetworkProblem | Several
Problem = TypeVar("Problem", bound=NetworkProblem | Several)

# Of the pulsation (rms): largest error of the means, 1 or 2 mmHg of a pressure. A zero that is off by more can be
# freed. Without a limit the few means are given up for the many harmonics, and with them the mean resistance, and all
# that only other flows show. Where the harmonics would give them up by more than the limit, the error is as much
# smaller than the limit as that is larger, and the means count the more, at most as much as each harmonic: judgement
MEANS = 0.1
CHANCE = 4.0  # standard deviations of χ² above which more than noise remains
# Predicted gain of a search that ended without a better step, which moves no value by more than a third of its standard
# deviation. Beside a large residual, whose curvature the linear problem leaves out, the prediction is not reached
_NEGLIGIBLE = 0.1
_ALTERNATIONS = 12  # of search and error estimate, at most
_SAME = 0.1  # relative change of an error that is negligible


@dataclass(frozen=True)
class Ended:
    """The end of a search. fit : there, whitened without model errors. errors : (2,) a of means and of harmonics.
    history : the cost, -2 ln of likelihood and priors up to a constant, at all accepted points: comparable between
    searches with different errors. converged : at a minimum."""

    fit: Fit
    errors: Array
    history: tuple[float, ...]
    converged: bool


def minimum(whole: Several, fit: Fit, rules: Rules, runs: Runs) -> Ended:
    """Search from a point, alternating with estimates of the model errors. whole : networks, without model errors."""
    errors, history, converged = np.full(2, math.inf), list[float](), False
    for _ in range(_ALTERNATIONS):
        sizes = model_errors(whole, fit)
        if np.all(np.abs(sizes - errors) <= _SAME * sizes):
            break
        errors, wide = sizes, granted(whole, sizes)
        (begun,) = wide.restated([fit], whole)
        found = Search(begun.member, rules, Point(begun.z, begun.J))
        search(partial(wide.points, runs=runs), [found])
        (fit,) = whole.restated([found.fit(*whole.entries)], wide)
        volume = log_volume(wide) - log_volume(whole)
        history = [*history, *(cost + volume for cost in found.history)]
        converged = found.converged or found.cost - found.promised() < _NEGLIGIBLE
    return Ended(fit, errors, tuple(history), converged)


def joint(problem: Networks) -> Several:
    """One or several recordings of a network as several."""
    return problem if isinstance(problem, Several) else Several((problem,), ("",))


def networks(problem: Networks) -> tuple[NetworkProblem, ...]:
    """The recordings of a network."""
    return tuple(part for part in joint(problem).parts if isinstance(part, NetworkProblem))


def granted(problem: Problem, errors: Array) -> Problem:
    """The recordings with model errors (2,) in the covariance of their data."""
    wide: Any
    if isinstance(problem, Several):
        wide = replace(problem, parts=tuple(granted(part, errors) for part in networks(problem)))
    else:
        wide = problem.granted(errors[np.minimum(np.arange(problem.K + 1), 1)], alike=True)
    return wide


def covariances(problem: Networks) -> Any:
    """The covariance of the model errors, as the argument of ``widened``: of each recording if there are several."""
    each = tuple(np.asarray(part.model_error) for part in networks(problem))
    return each if isinstance(problem, Several) else each[0]


def log_volume(problem: Networks) -> float:
    """ln det of the covariance of all data."""
    return sum(part.target.log_volume for part in networks(problem))


def model_errors(whole: Several, fit: Fit) -> Array:
    """(2,) the model errors that make the residual of a fit most probable.

    The residual is that of the linear problem's minimum, within the reach of one step of the search.
    """
    n, free = len(fit.z), np.array([u.low < u.high for u in fit.unknowns], bool)
    near = tuple(
        replace(u, low=u.low - here, high=u.high - here, prior_sd=LARGEST * u.typical_sd)
        for u, here in zip(fit.unknowns, fit.x, strict=True)
        if u.low < u.high
    )
    linear = replace(fit, unknowns=near, x=np.zeros(len(near)), J=fit.J[:, free])
    if settled(linear).chi2 < n + CHANCE * math.sqrt(2.0 * n):
        return np.zeros(2)
    parts = networks(whole)
    lone = len(parts) == 1 and len(parts[0].signals) == 1  # one mean gives no error of means
    each = zip(parts, whole.rows, strict=True)
    blocks = [block for part, rows in each for block in _blocks(part, rows.start, int(lone))]
    means, rest = estimated(linear, blocks, 2)
    if means > MEANS:
        means, rest = estimated(linear, blocks, 2, np.array([MEANS**2 / means, LARGEST_ERROR]))
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
