"""Points of hypotheses simulated together: in batches of one kind, and each simulation once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver import NonPhysicalState, NotPeriodic

from .fit import Member
from .observation import driven, inlet_sensor
from .simulator import Runs, Simulator
from .terms import Term, rewired
from .unknown import parameter_values

Array = np.ndarray

_LARGEST = 64  # members at once


def simulated(simulator: Simulator, members: Sequence[Member], runs: Runs) -> list[Array | None]:
    """X : (K+1, m) of the outputs, without what their sensors make of them; None where the simulation broke down."""
    groups: dict[str, list[int]] = {}
    for i, member in enumerate(members):
        groups.setdefault(kind_of(member.terms), []).append(i)
    X: list[Array | None] = [None] * len(members)
    for there in groups.values():
        for at in range(0, len(there), _LARGEST):
            part = there[at : at + _LARGEST]
            for i, result in zip(part, _batch(simulator, [members[i] for i in part], runs), strict=True):
                X[i] = result
    return X


def kind_of(terms: Sequence[Term]) -> str:
    """Hypotheses that share a mesh, outlets and states run in one batch."""
    own = [t.label if t.rewires else t.effect for t in terms if t.rewires or t.cuts or t.remembers]
    return " ".join(sorted(set(own)))


def _batch(simulator: Simulator, members: Sequence[Member], runs: Runs) -> list[Array | None]:
    # a term that may lie anywhere along its segment has the label of that in its usual place, and more unknowns
    terms = {(t.label, *(u.name for u in t.unknowns)): t for member in members for t in member.terms}
    network = rewired(simulator.network, terms.values())
    nominal = network.parameters()
    moved = [parameter_values(m.unknowns, network, m.x) | inlet_sensor(m) for m in members]
    names = dict.fromkeys(name for each in moved for name in each)
    # a sensor of an output needs no simulation of its own
    table = np.array([[float(each.get(n, nominal.get(n, 0.0))) for n in names] for each in moved])
    unique, first, inverse = np.unique(table, axis=0, return_index=True, return_inverse=True)
    parameters = {n: unique[:, i] for i, n in enumerate(names) if n in nominal}
    try:
        X = simulator.coefficients(network, parameters, runs, driven(simulator.drive, [members[i] for i in first]))
        return [X[i] for i in inverse.ravel()]
    except (NonPhysicalState, NotPeriodic, ValueError):
        if len(members) == 1:
            return [None]
    half = len(members) // 2
    return _batch(simulator, members[:half], runs) + _batch(simulator, members[half:], runs)
