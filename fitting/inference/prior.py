"""A calibration as a prior: deviations along the principal directions of its uncertainty.

With the unknowns x of the calibration, their covariance Σ = V Λ Vᵀ and what they move, unknown i of the prior moves
variable v by √λ_i Σ_j V_ji step_jv and has the standard deviation 1, which the record does not change. Factors and
shifts have separate Σ: their mutual covariance is neglected, which widens the prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, Coordinate, allowed
from solver.quantities.quantity import Quantity

from .hypothesis import FARTHEST, OWN, deviations, nuisances
from .unknown import OUTLIER, Array, Unknown

CALIBRATION = "calibration"  # the group of unknowns of a calibration
_LEAST = 1e-4  # of the largest standard deviation: smaller ones are neglected


@dataclass(frozen=True)
class Calibrated:
    """The uncertainty of a calibration. single : variables with an unknown of their own. free : those known so little
    that an effect which moves only them is no finding."""

    unknowns: tuple[Unknown, ...]
    single: frozenset[str]
    free: frozenset[str] = frozenset()


def along(coordinates: Sequence[Coordinate], covariance: Array, network: Network) -> Calibrated:
    """The unknowns of a prior. covariance : (p, p) of the coordinates, counted from the network's own values."""
    found: list[Unknown] = []
    for kind in (SCALE, SHIFT):
        at = [i for i, c in enumerate(coordinates) if c.kind == kind]
        if at:
            found += _directions([coordinates[i] for i in at], covariance[np.ix_(at, at)], network)
    return Calibrated(tuple(found), frozenset(c.moves[0][0] for c in coordinates if len(c.moves) == 1))


def _directions(coordinates: Sequence[Coordinate], covariance: Array, network: Network) -> list[Unknown]:
    kind, values, known = coordinates[0].kind, network.parameters(), network.parameter_quantities()
    names = list(dict.fromkeys(variable for c in coordinates for variable, _ in c.moves))
    steps = np.array([[dict(c.moves).get(name, 0.0) for c in coordinates] for name in names])
    variance, V = np.linalg.eigh(covariance)
    sd = np.sqrt(np.maximum(variance, 0.0))
    found: list[Unknown] = []
    for i in np.flatnonzero(sd > _LEAST * sd.max())[::-1]:
        moved = steps @ V[:, i] * sd[i]
        moves = tuple((name, float(step)) for name, step in zip(names, moved, strict=True) if step != 0.0)
        low, high = _range(kind, moves, values, known)
        if kind == SCALE:  # to e^±FARTHEST as other factors, or OUTLIER standard deviations if that is farther
            most = max(OUTLIER, FARTHEST / max(abs(step) for _, step in moves))
            low, high = max(low, -most), min(high, most)
        name = f"{CALIBRATION} {kind} {len(found) + 1} {OWN}"
        found.append(Unknown(name, kind, moves, low, high, group=CALIBRATION, stated=True))
    return found


def _range(
    kind: str, moves: Sequence[tuple[str, float]], values: Mapping[str, float], known: Mapping[str, Quantity]
) -> tuple[float, float]:
    """The lowest and the highest x that keep every variable in its range."""
    ends = [allowed(kind, ((name, abs(step)),), values, known[name]) for name, step in moves]
    ends = [(a, b) if step > 0.0 else (-b, -a) for (a, b), (_, step) in zip(ends, moves, strict=True)]
    return max(low for low, _ in ends), min(high for _, high in ends)


def possible(network: Network, prior: Calibrated | None) -> tuple[Unknown, ...]:
    """Individual deviations of arteries and outlets: from a calibration, and for parameters that it did not fit
    separately, from the stated spreads."""
    stated = deviations(network)
    return stated if prior is None else (
        *prior.unknowns, *(u for u in stated if not prior.single & set(u.variables))
    )  # fmt: skip


def of_animal(network: Network, own: Sequence[Unknown]) -> list[Unknown]:
    """The unknowns of an animal: common changes, and ``own`` deviations of the parameters in the network. A common
    factor whose variables were all calibrated is omitted.

    A direction that includes a replaced outlet keeps its other variables; together the directions have their remaining
    covariance.
    """
    there = network.parameters()
    moves = {u.name: tuple(move for move in u.moves if move[0] in there) for u in own}
    present = [replace(u, moves=moves[u.name]) for u in own if moves[u.name]]
    known = calibrated(present)
    return [*(u for u in nuisances(network) if not set(u.variables) <= known), *present]


def calibrated(unknowns: Sequence[Unknown]) -> set[str]:
    """The variables of the calibration."""
    return {variable for u in unknowns if u.group == CALIBRATION for variable in u.variables}
