"""A fit as a network: its terms at their fitted sizes, the nuisances refitted, and estimates of the added effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver.errors import InputError
from solver.laws.effect import ALL_PLACES
from solver.laws.sensors import Sensor
from solver.network.description import Channel, Network

from ..results.estimate import Estimate
from .fit import Array, Fit
from .hypothesis import PlacedEffect, effect_of, rewired
from .unknown import Reach, Unknown, bounds, interval, linear, parameter_values, reference, values

_SAME = 1e-9  # relative difference of ratios that are the same


def extended(network: Network, fit: Fit) -> Network:
    """The network of a hypothesis: its terms at their fitted sizes, the nuisances refitted, its sensors described."""
    network = rewired(network, fit.terms)
    moved = parameter_values(fit.unknowns, network, fit.x)
    network = network.with_parameters({name: float(value) for name, value in moved.items()})
    channels = {channel.name: dict(channel.terms) for channel in network.channels}
    for term in fit.terms:
        if term.is_sensor:
            channels.setdefault(term.place, {}).update(_as_terms(term, fit.x[_places(fit, term)]))
    return replace(network, channels=tuple(Channel(name, terms) for name, terms in channels.items()))


def allowed(network: Network, fit: Fit) -> Fit | None:
    """The hypothesis; None if its values are outside the ranges of a network, some of which depend on other values."""
    try:
        extended(network, fit)
    except InputError:
        return None
    return fit


def frequency(fit: Fit) -> float:
    """The highest frequency [Hz] of the sensor faults of a hypothesis; 0 without one."""
    chains = [_searched(t, fit.x[_places(fit, t)]) for t in fit.terms if t.is_sensor]
    return max((sensor.frequency(numbers) for sensor, numbers in chains), default=0.0)


def _places(fit: Fit, term: PlacedEffect) -> list[int]:
    """The indices of the unknowns of a term in a fit."""
    names = [u.name for u in fit.unknowns]
    return [names.index(u.name) for u in term.unknowns]


def _as_terms(term: PlacedEffect, x: Array) -> dict[str, float]:
    """The catalogue's parameters of a channel's effect at x : (q,)."""
    sensor, numbers = _searched(term, x)
    return sensor.as_terms(numbers)


def _searched(term: PlacedEffect, x: Array) -> tuple[Sensor, dict[str, float]]:
    """A channel's effect, and the numbers of a search for it at x : (q,)."""
    effect = effect_of(term)
    assert isinstance(effect, Sensor)
    return effect, {name.rpartition(".")[2]: float(value) for name, value in values(term.unknowns, x, {}).items()}


def estimates(
    network: Network, fit: Fit, term: PlacedEffect, quantile: float, reaches: Mapping[str, Reach] | None = None
) -> dict[str, Estimate]:
    """Values and 95 % intervals of a term's parameters: those of :func:`extended`, including the changes by nuisances.

    quantile : half an interval in standard deviations; reaches : lower and upper reach of some intervals, by name
    (:mod:`fitting.inference.intervals`). An effect with the same value everywhere is reported once; an effect
    of walls as the ratio to their refitted moduli.
    """
    known = {u.name: (reaches or {}).get(u.name, (quantile, quantile)) for u in term.unknowns}
    if term.is_sensor:
        return _of_sensor(fit, term, known)
    whole = rewired(network, fit.terms)
    nominal, quantities = whole.parameters(), whole.parameter_quantities()
    found: dict[str, Estimate] = {}
    for unknown in term.unknowns:
        below, above = known[unknown.name]
        of = {
            v: interval(fit.unknowns, v, nominal[v], quantities[v], fit.x, fit.covariance,
                        (below, above) if step >= 0.0 else (above, below))
            for v, step in unknown.moves
        }  # fmt: skip
        found |= of if term.place != ALL_PLACES else _everywhere(fit, unknown, of, nominal, known[unknown.name])
    return found


def _everywhere(
    fit: Fit, unknown: Unknown, found: dict[str, Estimate], nominal: Mapping[str, float], reach: Reach
) -> dict[str, Estimate]:
    """One estimate if it is the same everywhere, else all of ``found``."""
    if unknown.ratio is None:
        first, *others = found.values()
        return {unknown.name: first} if all(other == first for other in others) else found
    now = dict(nominal) | {n: float(v) for n, v in values(fit.unknowns, fit.x, nominal).items()}
    ratios = [now[v] / now[reference(unknown, v)] for v in found]
    same = np.ptp(ratios) <= _SAME * np.abs(ratios).max()
    return {unknown.name: _ratio(fit, unknown, nominal, reach)} if same else found


def _of_sensor(fit: Fit, term: PlacedEffect, reaches: Mapping[str, Reach]) -> dict[str, Estimate]:
    """The estimates of a measurement chain: minimum and maximum of each over the joint region of the searched numbers.

    On the ellipsoid of their covariance C, linear in x, those of slope s lie at x ± C s/√(sᵀ C s).
    """
    at = _places(fit, term)
    x, C, (low, high) = fit.x[at], fit.covariance[np.ix_(at, at)], bounds(term.unknowns)
    sd, reach = np.sqrt(np.diag(C)), np.array([reaches[u.name] for u in term.unknowns])

    def ends(along: Array) -> list[dict[str, float]]:
        """At the two ends of a direction."""
        steps = (np.where(d < 0.0, reach[:, 0], reach[:, 1]) * d for d in (-along, along))
        return [_as_terms(term, np.clip(x + step, low, high)) for step in steps]

    sides, found = [ends(side) for side in np.diag(sd)], {}
    units = {k: q.unit for k, q in effect_of(term).terms.items()}
    units |= {u.name.rpartition(".")[2]: u.unit for u in term.unknowns}
    for key, value in _as_terms(term, x).items():
        slope = np.array([b[key] - a[key] for a, b in sides]) / np.maximum(sd, 1e-300)
        along = C @ slope / max(float(np.sqrt(slope @ C @ slope)), 1e-300)
        of = (value, *(end[key] for end in ends(along)))
        found[f"{term.place}.{key}"] = Estimate(value, units[key], (min(of), max(of)))
    return found


def _ratio(fit: Fit, unknown: Unknown, nominal: Mapping[str, float], reach: Reach) -> Estimate:
    """A ratio such as φ0/E to the refitted modulus, with its interval by the delta method."""
    variable, at = unknown.moves[0][0], linear(fit.unknowns, fit.x, nominal)
    (a, by_a), modulus = at[variable], reference(unknown, variable)
    b, by_b = at.get(modulus, (nominal[modulus], 0.0 * fit.x))
    value, slope = a / b, (by_a - a / b * by_b) / b
    below, above = (each * float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0))) for each in reach)
    return Estimate(value, unknown.unit, (value - below, value + above))
