"""The model without effect if much is missing: fitted with a model error that shrinks in steps.

With the noise alone, a model that is wrong by many times the noise has many minima, and a search ends in the one near
its start. A model error that is equal at all harmonics gives weight to the large ones: the search first minimises the
residual in the units of the channels, and at last in units of the noise.
"""

from __future__ import annotations

from ..fit import Fit, Member
from ..runs import Runs
from ..unknown import Unknown, absent
from .network import NetworkProblem

LEVELS = (0.05, 0.015, 0.003, 0.0)  # model error of every harmonic, as a fraction of the RMS of the channel's pulsation


def from_afar(problem: NetworkProblem, unknowns: tuple[Unknown, ...], runs: Runs) -> Fit | None:
    """The model without effect, fitted from the network's own values; None if these cannot be simulated."""
    member, found = Member((), unknowns, absent(unknowns)), None
    for level in LEVELS:
        (found,) = problem.granted(level, alike=True).searched_from([member], runs)
        if found is None:
            return None
        member = found.member
    return found
