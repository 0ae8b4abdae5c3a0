"""The model without effect where much is missing: searched for from afar, with an error granted to it that shrinks.

By the noise alone a model that is wrong by many times that has many minima, and a search ends in the one where it
began. Of an error that is alike at all harmonics it is the large ones that count, as for the eye: the search first
comes near in the units of the channels, and ends at the noise.
"""

from __future__ import annotations

import numpy as np

from ...records.channels.noise import pulses
from ..fit import Fit, Member
from ..runs import Runs
from ..unknown import Unknown, absent
from .network import NetworkProblem

Array = np.ndarray

LEVELS = (0.05, 0.015, 0.003, 0.0)  # of every channel's pulsation (RMS), granted to every harmonic


def from_afar(problem: NetworkProblem, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, from the network's own values; None where it cannot be simulated there."""
    member, found = Member((), unknowns, absent(unknowns)), None
    for level in LEVELS:
        (found,) = alike_granted(problem, level).searched_from([member], runs)
        if found is None:
            return None
        member = found.member
    return found


def alike_granted(problem: NetworkProblem, part: float) -> NetworkProblem:
    """The problem with an error of the model of this part of each channel's pulsation, the same at all harmonics."""
    variance = np.diag((part * pulses(problem.beats, problem.signals)) ** 2)
    return problem.widened(np.broadcast_to(variance, (problem.K + 1, *variance.shape))) if part else problem


def left_of_pulsation(problem: NetworkProblem, z: Array) -> Array:
    """(m,) the RMS that a residual z : (n,) leaves of each channel over that of its pulsation."""
    power = np.abs(problem.target.unwhiten(z[:, None])[..., 0]) ** 2
    return np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0)) / pulses(problem.beats, problem.signals)
