"""A fit as a network: its terms at their fitted sizes, the nuisances refitted, and estimates of what was added."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from solver.coordinate import SCALE
from solver.effect import ALL_PLACES
from solver.network import Channel, Network
from solver.sensors import Sensor

from ..estimate import Estimate
from .fit import Fit
from .terms import Term, effect_of, rewired
from .unknown import Unknown, interval, parameter_values, values

Array = np.ndarray

_SAME = 1e-9  # relative difference of ratios that are the same


def extended(network: Network, fit: Fit) -> Network:
    """The network of a hypothesis: its terms at their fitted sizes, the nuisances refitted, its sensors described."""
    network = rewired(network, fit.terms)
    moved = parameter_values(fit.unknowns, network, fit.x)
    network = network.with_parameters({name: float(value) for name, value in moved.items()})
    channels = {channel.name: dict(channel.terms) for channel in network.channels}
    for term in fit.terms:
        if term.is_sensor:
            channels.setdefault(term.place, {}).update(sensor_parameters(fit, term))
    return replace(network, channels=tuple(Channel(name, terms) for name, terms in channels.items()))


def allowed(network: Network, fit: Fit) -> bool:
    """Whether a network may have the values of a hypothesis: some go by the values of others."""
    try:
        extended(network, fit)
    except ValueError:
        return False
    return True


def sensor_parameters(fit: Fit, term: Term) -> dict[str, float]:
    """The catalogue's parameters of a channel's effect."""
    x = np.array([fit.x[[u.name for u in fit.unknowns].index(u.name)] for u in term.unknowns])
    moved = values(term.unknowns, x, {})
    return _sensor(term).as_terms({name.rpartition(".")[2]: float(value) for name, value in moved.items()})


def _sensor(term: Term) -> Sensor:
    effect = effect_of(term)
    assert isinstance(effect, Sensor)
    return effect


def estimates(network: Network, fit: Fit, term: Term, quantile: float) -> dict[str, Estimate]:
    """Values and 95 % intervals of a term's parameters: those of :func:`extended`, with what the nuisances add to them.

    One that acts everywhere is reported once where it is the same everywhere: that of walls as the ratio to their
    refitted moduli.
    """
    if term.is_sensor:
        return _of_sensor(fit, term, quantile)
    whole = rewired(network, fit.terms)
    nominal, known = whole.parameters(), whole.parameter_quantities()
    found: dict[str, Estimate] = {}
    for unknown in term.unknowns:
        of = {
            v: interval(fit.unknowns, v, nominal[v], known[v], fit.x, fit.covariance, quantile)
            for v in unknown.variables
        }
        found |= of if term.place != ALL_PLACES else _everywhere(network, fit, unknown, of, quantile)
    return found


def _everywhere(
    network: Network, fit: Fit, unknown: Unknown, found: dict[str, Estimate], quantile: float
) -> dict[str, Estimate]:
    """One number where it is the same everywhere, else ``found``, one by one."""
    if unknown.ratio is None:
        first, *others = found.values()
        return {unknown.name: first} if all(other == first for other in others) else found
    now = extended(network, fit).parameters()
    ratios = [now[v] / now[f"{v.rpartition('.')[0]}.{unknown.ratio}"] for v in found]
    same = np.ptp(ratios) <= _SAME * np.abs(ratios).max()
    return {unknown.name: _ratio(fit, unknown, quantile)} if same else found


def _of_sensor(fit: Fit, term: Term, quantile: float) -> dict[str, Estimate]:
    """Those of a measurement chain, by the corners of the intervals of what was searched."""
    names, sd, sensor = [u.name for u in fit.unknowns], np.sqrt(np.diag(fit.covariance)), _sensor(term)
    at = [names.index(u.name) for u in term.unknowns]
    keys = [u.name.rpartition(".")[2] for u in term.unknowns]
    told = [u.estimate(float(fit.x[i]), float(sd[i]), quantile) for u, i in zip(term.unknowns, at, strict=True)]
    units = {key: q.unit for key, q in sensor.terms.items()} | {k: e.unit for k, e in zip(keys, told, strict=True)}
    value = sensor.as_terms(dict(zip(keys, (e.value for e in told), strict=True)))
    corners = [sensor.as_terms(dict(zip(keys, ends, strict=True))) for ends in product(*(e.ci95 for e in told))]
    return {
        f"{term.place}.{key}": Estimate(x, units[key], (min(c[key] for c in corners), max(c[key] for c in corners)))
        for key, x in value.items()
    }


def _ratio(fit: Fit, unknown: Unknown, quantile: float) -> Estimate:
    """A ratio such as φ0/E to the modulus as it was refitted; its interval by the derivatives of all that move it."""
    names = [u.name for u in fit.unknowns]
    slope, i = np.zeros(len(names)), names.index(unknown.name)
    nuisance = {u.name: (j, u.size) for j, u in enumerate(fit.unknowns) if j != i and u.kind == SCALE}
    reference, step = nuisance.get(f"{ALL_PLACES}.{unknown.ratio}", (i, 0.0))
    if unknown.kind == SCALE:  # of the same modulus as the nuisance of that name
        own, own_step = nuisance.get(unknown.name, (i, 0.0))
        value = unknown.nominal * np.exp(unknown.size * fit.x[i] + own_step * fit.x[own] - step * fit.x[reference])
        slope[own] += own_step * value
        slope[reference] -= step * value
        slope[i] += unknown.size * value
    else:  # the modulus takes it along
        value = unknown.nominal + unknown.size * fit.x[i]
        slope[i] += unknown.size
    half = quantile * float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
    return Estimate(float(value), unknown.unit, (float(value) - half, float(value) + half))
