"""A fit as a network: its terms at their fitted sizes, the nuisances refitted, and estimates of what was added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.coordinate import SCALE
from solver.network import Channel, Network

from .fit import Fit
from .observation import resonance_of
from .terms import Term, rewired
from .unknown import Estimate, Unknown, interval, parameter_values, values

Array = np.ndarray

_SAME = 1e-9  # relative difference of ratios that are the same


def extended(network: Network, fit: Fit) -> Network:
    """The network of a hypothesis: its terms at their fitted sizes, the nuisances refitted, its sensors described."""
    for term in fit.terms:
        network = rewired(network, term)
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
    """The catalogue's parameters of a channel's effect: lag, gain, offset, or f_n and ζ."""
    x = np.array([fit.x[[u.name for u in fit.unknowns].index(u.name)] for u in term.unknowns])
    moved = {n.rpartition(".")[2]: float(v) for n, v in values(term.unknowns, x, {}).items()}
    if term.effect == "catheter_resonance":
        f_n, zeta = resonance_of(moved["slow"], moved["resonance"])
        return {"f_n": f_n, "zeta": zeta}
    return moved


def estimates(network: Network, fit: Fit, term: Term, quantile: float) -> dict[str, Estimate]:
    """Values and 95 % intervals of a term's parameters: those of :func:`extended`, with what the nuisances add to them.

    One that acts everywhere is reported once where it is the same everywhere: that of walls as the ratio to their
    refitted moduli.
    """
    if term.is_sensor:
        return _of_sensor(fit, term, quantile)
    whole = network
    for each in fit.terms:
        whole = rewired(whole, each)
    nominal, known = whole.parameters(), whole.parameter_quantities()
    found = {
        v: interval(fit.unknowns, v, nominal[v], known[v], fit.x, fit.covariance, quantile)
        for u in term.unknowns
        for v in u.variables
    }
    if term.place != "all":
        return found
    (unknown,) = term.unknowns
    if unknown.ratio is not None:
        now = extended(network, fit).parameters()
        ratios = [now[v] / now[f"{v.rpartition('.')[0]}.{unknown.ratio}"] for v in found]
        same = np.ptp(ratios) <= _SAME * np.abs(ratios).max()
        return {unknown.name: _ratio(fit, unknown, quantile)} if same else found
    first, *others = found.values()
    return {unknown.name: first} if all(other == first for other in others) else found


def _of_sensor(fit: Fit, term: Term, quantile: float) -> dict[str, Estimate]:
    """Those of a measurement chain; of a resonance they follow from its two coefficients, by the corners of their
    intervals."""
    names, sd = [u.name for u in fit.unknowns], np.sqrt(np.diag(fit.covariance))
    at = {u.name: names.index(u.name) for u in term.unknowns}
    plain = {u.name: u.estimate(float(fit.x[at[u.name]]), float(sd[at[u.name]]), quantile) for u in term.unknowns}
    if term.effect != "catheter_resonance":
        return plain
    slow, ringing = plain[f"{term.place}.slow"], plain[f"{term.place}.resonance"]
    corners = np.array([resonance_of(a, b) for a in slow.ci95 for b in ringing.ci95])
    value = resonance_of(slow.value, ringing.value)
    return {
        f"{term.place}.{key}": Estimate(float(value[i]), unit, (float(corners[:, i].min()), float(corners[:, i].max())))
        for i, (key, unit) in enumerate((("f_n", "Hz"), ("zeta", "1")))
    }


def _ratio(fit: Fit, unknown: Unknown, quantile: float) -> Estimate:
    """A ratio such as φ0/E to the modulus as it was refitted; its interval by the derivatives of all that move it."""
    names = [u.name for u in fit.unknowns]
    slope, i = np.zeros(len(names)), names.index(unknown.name)
    nuisance = {u.name: (j, u.size) for j, u in enumerate(fit.unknowns) if j != i and u.kind == SCALE}
    reference, step = nuisance.get(f"all.{unknown.ratio}", (i, 0.0))
    if unknown.kind == SCALE:  # of the same modulus as the nuisance of that name
        own, own_step = nuisance.get(unknown.name, (i, 0.0))
        value = unknown.nominal * np.exp(unknown.size * fit.x[i] + own_step * fit.x[own] - step * fit.x[reference])
        slope[own] += own_step * value
        slope[reference] -= step * value
        slope[i] += unknown.size * value
    else:
        unit = unknown.size * np.exp(-step * fit.x[reference])
        value = unknown.nominal + unit * fit.x[i]
        slope[reference] -= step * unit * fit.x[i]
        slope[i] += unit
    half = quantile * float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
    return Estimate(float(value), unknown.unit, (float(value) - half, float(value) + half))
