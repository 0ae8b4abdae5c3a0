"""The model without effect if much is missing: fitted with a model error that shrinks in steps.

With the noise alone, a model that is wrong by many times the noise has many minima, and a search ends in the one near
its start. A model error that is equal at all harmonics gives weight to the large ones: the search first minimises the
residual in the units of the channels, and at last in units of the noise.
"""

from __future__ import annotations

import numpy as np

from ...records.channels.noise import pulses
from ..fit import Fit, Member
from ..runs import Runs
from ..unknown import Unknown, absent
from .network import NetworkProblem

Array = np.ndarray

LEVELS = (0.05, 0.015, 0.003, 0.0)  # model error of every harmonic, as a fraction of the RMS of the channel's pulsation


def from_afar(problem: NetworkProblem, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, fitted from the network's own values; None if these cannot be simulated."""
    member, found = Member((), unknowns, absent(unknowns)), None
    for level in LEVELS:
        (found,) = alike_granted(problem, level).searched_from([member], runs)
        if found is None:
            return None
        member = found.member
    return found


def alike_granted(problem: NetworkProblem, part: float) -> NetworkProblem:
    """The problem with a model error of this fraction of each channel's pulsation, equal at all harmonics."""
    variance = np.diag((part * pulses(problem.beats, problem.signals)) ** 2)
    return problem.widened(np.broadcast_to(variance, (problem.K + 1, *variance.shape))) if part else problem


def left_of_pulsation(problem: NetworkProblem, z: Array) -> Array:
    """(m,) RMS residual of each channel over the RMS of its pulsation. z : (n,) whitened."""
    power = np.abs(problem.target.unwhiten(z[:, None])[..., 0]) ** 2
    return np.sqrt(power[0] + 2.0 * power[1:].sum(axis=0)) / pulses(problem.beats, problem.signals)
