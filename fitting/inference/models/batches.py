"""Simulate points of hypotheses together: in batches of one kind, and each distinct simulation once."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from solver.laws.effect import OUTFLOW
from solver.network.description import Network
from solver.simulate import BROKEN

from ..fit import Array, Member
from ..hypothesis import PlacedEffect, effect_of, rewired
from ..runs import TIME_IS_OVER, OutOfTime, Runs
from ..unknown import parameter_values
from .bench_observation import driven, inlet_sensor, sense
from .simulator import Simulator

_LARGEST = 64  # members of a batch
_FEWEST = 16  # members of a batch in a separate process: a batch has an overhead of ten members (measured)

_WORTH = 3  # members for which a batch simulates the member near which they lie, if it is not its own

# with the index of the member near which each lies, and its deadline, [s] of time.monotonic
Batch = tuple[Simulator, list[Member], list[int], float]
Answer = tuple[list[Array | None] | None, int]  # X of a batch, and the number of simulated members


def simulated(
    simulator: Simulator, members: Sequence[Member], runs: Runs, near: Sequence[int] | None = None
) -> list[Array | None]:
    """X : (K+1, m) after the sensors, of every member.

    None if the simulation broke down. near : for each member the index of a similar one, by default its own, if only
    their difference must be accurate (:func:`~solver.beat_harmonics`).
    """
    near, groups = range(len(members)) if near is None else near, dict[str, list[int]]()
    for i, member in enumerate(members):
        groups.setdefault(kind_of(member.terms), []).append(i)
    parts = [part for there in groups.values() for part in _cut(there, runs.workers.jobs)]
    until = time.monotonic() + runs.left if runs.workers.jobs > 1 else np.inf  # a clock that processes share
    batches = [_batch_of(simulator, members, part, near, until) for part in parts]

    def counted(found: Answer) -> list[Array | None]:
        X, members = found
        runs.meter.add(members)
        if X is None:
            raise OutOfTime(TIME_IS_OVER)
        return X

    found = runs.workers.share(batches, _elsewhere, counted, lambda batch: _batch(*batch[:3], runs))
    spectra: list[Array | None] = [None] * len(members)
    for part, own in zip(parts, found, strict=True):
        for i, X in zip(part, own, strict=False):  # a batch may have more members: see _batch_of
            spectra[i] = None if X is None else sense(members[i], simulator.names, X, simulator.T)
    return spectra


def _cut(there: list[int], jobs: int) -> list[list[int]]:
    """Batches of one kind: of the largest size, or of equal sizes if several processes share them."""
    if jobs == 1:
        return [there[at : at + _LARGEST] for at in range(0, len(there), _LARGEST)]
    each = -(-len(there) // (jobs * _LARGEST))
    parts = max(1, min(jobs * each, len(there) // _FEWEST))
    return [there[len(there) * i // parts : len(there) * (i + 1) // parts] for i in range(parts)]


def _batch_of(
    simulator: Simulator, members: Sequence[Member], part: list[int], near: Sequence[int], until: float
) -> Batch:
    """The batch of some members, followed by those near which they lie, if these are others."""
    others = sorted({near[i] for i in part} - set(part)) if len(part) >= _WORTH else []
    at = {i: k for k, i in enumerate((*part, *others))}
    return simulator, [members[i] for i in at], [at.get(near[i], k) for i, k in at.items()], until


def _elsewhere(batch: Batch) -> Answer:
    """Simulate a batch in another process, and count the simulations. None after the deadline: an exception would end
    the process, which may be needed for a later one."""
    simulator, members, near, until = batch
    runs = Runs(deadline=until)
    try:
        return _batch(simulator, members, near, runs), runs.meter.simulations
    except OutOfTime:
        return None, runs.meter.simulations


def kind_of(terms: Sequence[PlacedEffect]) -> str:
    """The kind of a hypothesis. Hypotheses of one kind have the same mesh, outlets, states and leaks, and run in one
    batch. If flow is lost along a segment, the beats of a batch do not start at those of other members."""
    own = set[str]()
    for t, effect in ((t, effect_of(t)) for t in terms):
        if effect.rewires or effect.cuts or effect.remembers or t.moves_along:
            own.add(t.label if effect.rewires else t.effect)
        if effect.source == OUTFLOW:
            own.add("leaks")
    return " ".join(sorted(own))


def _batch(simulator: Simulator, members: Sequence[Member], near: Sequence[int], runs: Runs) -> list[Array | None]:
    # a term with free position has the label of the fixed one, but more unknowns
    terms = {(t.label, *(u.name for u in t.unknowns)): t for member in members for t in member.terms}
    network = rewired(simulator.network, terms.values())
    nominal = network.parameters()
    moved = [values | inlet_sensor(m) for m, values in zip(members, _values(members, network), strict=True)]
    names = dict.fromkeys(name for each in moved for name in each)
    # a sensor of an output needs no simulation of its own
    table = np.array([[float(each.get(n, nominal.get(n, 0.0))) for n in names] for each in moved])
    unique, first, inverse = np.unique(table, axis=0, return_index=True, return_inverse=True)
    parameters = {n: unique[:, i] for i, n in enumerate(names) if n in nominal}
    others = inverse.ravel()[np.asarray(near)[first]]
    others[others] = others  # of those near which others lie, each starts by itself
    try:
        X = simulator.coefficients(
            network, parameters, runs, driven(simulator.drive, [members[i] for i in first]), others
        )
        return [None if np.isnan(X[i]).any() else X[i] for i in inverse.ravel()]
    except BROKEN:
        if len(members) == 1:
            return [None]
    half = len(members) // 2
    return [X for part in (members[:half], members[half:]) for X in _batch(simulator, part, range(len(part)), runs)]


def _values(members: Sequence[Member], network: Network) -> Iterator[dict[str, float]]:
    """The parameters that each member changes, [SI]; found together for consecutive members of one hypothesis."""
    for unknowns, some in groupby(members, key=lambda m: m.unknowns):
        x = np.stack([m.x for m in some])
        found = parameter_values(unknowns, network, x)
        for i in range(len(x)):
            yield {name: float(value[i]) for name, value in found.items()}
