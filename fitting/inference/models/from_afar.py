"""A search for the model without effect from far away, with a model error that decreases.

With the noise alone as weight, a model that is wrong by many times the noise has many local minima, and a search ends
in the nearest one. With a model error common to all harmonics, large harmonics dominate: the search first reduces the
residual in the units of the channels, and ends with the noise as weight.
"""

from __future__ import annotations

import numpy as np

from ...records.channels.noise import pulses
from ..fit import Fit, Member
from ..runs import Runs
from ..unknown import Unknown, absent
from .network import NetworkProblem

Array = np.ndarray

LEVELS = (0.05, 0.015, 0.003, 0.0)  # model error of every harmonic, relative to the channel's pulsation (RMS)


def from_afar(problem: NetworkProblem, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, from the network's own values; None if it cannot be simulated there."""
    member, found = Member((), unknowns, absent(unknowns)), None
    for level in LEVELS:
        (found,) = alike_granted(problem, level).searched_from([member], runs)
        if found is None:
            return None
        member = found.member
    return found


def alike_granted(problem: NetworkProblem, part: float) -> NetworkProblem:
    """The problem with a model error of this fraction of each channel's pulsation, the same at all harmonics."""
    variance = np.diag((part * pulses(problem.beats, problem.signals)) ** 2)
    return problem.widened(np.broadcast_to(variance, (problem.K + 1, *variance.shape))) if part else problem


def left_of_pulsation(problem: NetworkProblem, z: Array) -> Array:
    """(m,) RMS of a residual z : (n,) per channel, relative to that of its pulsation."""
    power = np.abs(problem.target.unwhiten(z[:, None])[..., 0]) ** 2
    return np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0)) / pulses(problem.beats, problem.signals)
