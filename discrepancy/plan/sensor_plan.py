"""Before an experiment: the effects that a set of sensors could distinguish, and the sensor to add.

A virtual record of the network, at a given noise, stands for the experiment. All its outputs are simulated once, with
every effect, and each set of sensors is judged by its part of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fitting.inference.fit import Array, Fit, Member
from fitting.inference.hypothesis import PlacedEffect, candidates
from fitting.inference.jackknife import subset
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.parallel.threads import single_threaded
from fitting.records.alignment.beats import Beats
from fitting.records.virtual import measured
from solver import simulate_periodic
from solver.errors import InputError
from solver.laws.catalogue import filtered
from solver.network.description import Network
from solver.quantities.units import INFLOW
from solver.simulate import Progress

from ..find.study import FEWEST_BEATS
from ..findings.isolability import INSEPARABLE, isolability
from ..findings.outcome import Isolability

_SAMPLES = 100  # of a beat
_SEED = 5
_DB = (0.0, 120.0)  # allowed range


@dataclass(frozen=True)
class Gain:
    """The gain by one more sensor: effects that become visible, and number of pairs that become separable."""

    channel: str
    visible: tuple[str, ...]
    separable: int


@dataclass(frozen=True)
class SensorPlan:
    """table : of the chosen channels. gains : of further channels, largest first."""

    channels: tuple[str, ...]
    table: Isolability
    gains: tuple[Gain, ...]


@single_threaded
def plan_sensors(
    network: Network,
    channels: Sequence[str],
    dB: float = 40.0,
    beats: int = 15,
    progress: Progress = lambda fraction, label: None,
) -> SensorPlan:
    """Isolability by some outputs of a network and its inflow, at a noise of ``dB`` and over ``beats`` beats.

    progress : called with the fraction done and the stage. Raises ValueError for a channel that the network does not
    have, or a noise or number of beats out of range, and InputError if the network cannot be simulated.
    """
    known = tuple(n for n in network.output_units() if n.partition(".")[2] in ("P", "Q", "R") and n != "inlet.P")
    _check(network, channels, known, dB, beats)
    progress(0.0, "simulating the network")
    problem = network_problem(_virtual(network, known, dB, beats), network, known)
    terms = candidates(network, (*known, INFLOW))
    (base,) = problem.refit([()])
    if base is None:
        raise InputError(f"network {network.name}: it cannot be simulated; check it with arterial-fmu solve.")
    columns = _columns(problem, base, terms, progress)
    progress(0.9, "comparing sensors")
    tables = {name: _table(problem, base, columns, terms, (*channels, name)) for name in known if name not in channels}
    own = _table(problem, base, columns, terms, tuple(channels))
    gains = [
        Gain(name, tuple(e for e in own.invisible if e in table.visible),
             _separable(table, own.labels) - _separable(own, own.labels))
        for name, table in tables.items()
    ]  # fmt: skip
    order = sorted(gains, key=lambda g: (-g.separable - 3 * len(g.visible), g.channel))
    return SensorPlan(tuple(dict.fromkeys(channels)), own, tuple(order))


def _check(network: Network, channels: Sequence[str], known: Sequence[str], dB: float, beats: int) -> None:
    """Raise ValueError for an impossible experiment on this network."""
    for name in channels:
        if name not in known:
            raise InputError(
                f"channel {name}: network {network.name} has no such output; use some of {', '.join(known)}."
            )
    if network.inlet.Q_max <= 0.0:
        raise InputError(
            f"network {network.name}: its inlet flow inlet.Q_max is {network.inlet.Q_max:g} m^3/s, and without flow no "
            "sensor sees anything; give the network that the artery is in, with the inflow of the experiment."
        )
    if not channels:
        raise InputError(f"channels: none given; name some outputs of network {network.name}, such as {known[0]}.")
    if not (math.isfinite(dB) and _DB[0] <= dB <= _DB[1]):
        raise InputError(f"dB = {dB:g}: must be {_DB[0]:g} to {_DB[1]:g}; 40 is a noise of 1 % of the pulse.")
    if beats < FEWEST_BEATS:
        raise InputError(f"beats = {beats}: must be at least {FEWEST_BEATS}, as in a record; plan for more.")


def _columns(problem: NetworkProblem, base: Fit, terms: Sequence[PlacedEffect], progress: Progress) -> dict[str, Array]:
    """Whitened columns of all effects: derivatives; for a change of outlet kind, the finite change of the residual."""
    columns: dict[str, Array] = {}
    groups = [[t for t in terms if t.effect == e] for e in dict.fromkeys(t.effect for t in terms)]
    for i, group in enumerate(groups):
        progress(0.1 + 0.8 * i / len(groups), f"simulating {group[0].effect.replace('_', ' ')}")
        columns |= _rewired_columns(problem, base, group) if group[0].rewires else problem.columns(base, group)
    return columns


def _rewired_columns(problem: NetworkProblem, base: Fit, terms: Sequence[PlacedEffect]) -> dict[str, Array]:
    """(n, 1) change of the whitened residual when an outlet becomes the Windkessel at which a search would start."""
    at = dict(zip((u.name for u in base.unknowns), base.x, strict=True))
    members = []
    for term in terms:
        unknowns = problem.hypothesis((term,))
        members.append(Member((term,), unknowns, np.array([at.get(u.name, 0.0) for u in unknowns])))
    found = zip(terms, problem.observe(members), strict=True)
    return {term.label: (problem.residual(X) - base.z)[:, None] for term, X in found if X is not None}


def _virtual(network: Network, names: Sequence[str], dB: float, n_beats: int) -> Beats:
    """A virtual record: the network's own beat with white noise."""
    T = network.inlet.T
    beat = simulate_periodic(network, tolerance=1e-5)
    rng = np.random.default_rng(_SEED)
    values = {}
    for name in (INFLOW, *names):
        X = np.fft.rfft(beat[name][:-1], norm="forward")
        X *= filtered(network, name, 2.0 * np.pi / T * np.arange(len(X)))
        clean = np.fft.irfft(X, _SAMPLES, norm="forward")
        values[name] = measured(np.tile(clean, n_beats), rng, dB).reshape(n_beats, _SAMPLES)
    return Beats("virtual record", "", T, values, np.zeros(n_beats))


def _table(
    problem: NetworkProblem,
    base: Fit,
    columns: Mapping[str, Array],
    terms: Sequence[PlacedEffect],
    chosen: Sequence[str],
) -> Isolability:
    """Isolability by some of the problem's channels and by the inflow, all with possible sensor faults."""
    keep = np.array([problem.signals.index(name) for name in dict.fromkeys(chosen)])
    part = subset(problem.target, keep)
    observable = [t for t in terms if not t.is_sensor or t.place in (*chosen, INFLOW)]
    fit = replace(base, z=part(base.z[:, None])[:, 0], J=part(base.J))
    return isolability(fit, {t.label: part(columns[t.label]) for t in observable if t.label in columns}, observable)


def _separable(table: Isolability, effects: Sequence[str]) -> int:
    """Number of separable pairs of visible effects: half of the entries of the asymmetric separation matrix."""
    at = [table.labels.index(e) for e in effects if e in table.visible]
    block = table.separation[np.ix_(at, at)]
    return int((block >= INSEPARABLE).sum() // 2)


def plan_json(plan: SensorPlan) -> dict[str, Any]:
    """The plan as plain data: visible effects with their rivals, invisible effects, and the gain by more sensors."""
    effects = []
    for effect, visibility in plan.table.visible.items():
        rival, separation = plan.table.nearest(effect) or (None, None)
        effects.append({"name": effect, "visibility": visibility, "nearest": rival, "separation": separation,
                        "cannot_be_told_from": list(plan.table.confused(effect))})  # fmt: skip
    gains = [{"channel": g.channel, "shows": list(g.visible), "separates": g.separable} for g in plan.gains]
    return {"channels": list(plan.channels), "effects": effects, "invisible": list(plan.table.invisible),
            "not_judged": list(plan.table.not_judged), "add": gains}  # fmt: skip
