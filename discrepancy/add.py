"""Add the missing effect: the network with the new term and the refitted nuisances, and the measurement chain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.effects import BY_NAME
from solver.network import Channel, Network

from .fits import Fit
from .observation import resonance_of
from .outcome import Estimate, NamedEffect
from .terms import SCALE, Term, Unknown, rewired, values

Array = np.ndarray

_SAME = 1e-9  # relative difference of ratios that are the same


def extended(network: Network, fit: Fit) -> Network:
    """The network of a hypothesis: its terms at their fitted sizes, the nuisances refitted, its sensors described."""
    for term in fit.terms:
        network = rewired(network, term)
    nominal, known = network.parameters(), network.parameter_quantities()
    moved = values(fit.unknowns, fit.x, nominal)
    physical = {n: float(np.clip(v, known[n].low, known[n].high)) for n, v in moved.items() if n in nominal}
    network = network.with_parameters(physical)
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
    moved = {n.rpartition(".")[2]: float(v) for n, v in values(term.unknowns, x, {f"{term.place}.gain": 1.0}).items()}
    if term.effect == "catheter_resonance":
        f_n, zeta = resonance_of(moved["slow"], moved["resonance"])
        return {"f_n": f_n, "zeta": zeta}
    return moved


def named(network: Network, fit: Fit, term: Term, confidence: float, quantile: float) -> NamedEffect:
    """The term as verdict.json has it."""
    found = estimates(network, fit, term, quantile)
    return NamedEffect(term.effect, term.where, found, confidence, BY_NAME[term.effect].equation)


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
    found = {v: _variable(whole, fit, v, quantile) for u in term.unknowns for v, _ in u.moves}
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


def _variable(network: Network, fit: Fit, variable: str, quantile: float) -> Estimate:
    """A parameter of the extended network; its interval by the derivatives of all unknowns that move it, of its
    logarithm where they only scale it."""
    nominal, q = network.parameters()[variable], network.parameter_quantities()[variable]
    steps = np.array([dict(u.moves).get(variable, 0.0) for u in fit.unknowns])
    scales = np.array([u.kind == SCALE for u in fit.unknowns])
    scaled = nominal * np.exp(steps[scales] @ fit.x[scales])
    value = scaled + steps[~scales] @ fit.x[~scales]
    slope = np.where(scales, steps * scaled, steps)
    half = quantile * float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0)))
    if steps[~scales].any() or nominal == 0.0:
        ends = (value - half, value, value + half)
    else:
        ends = (value * np.exp(-half / abs(value)), value, value * np.exp(half / abs(value)))
    low, value, high = (float(v) for v in np.clip(ends, q.low, q.high))
    return Estimate(value, q.unit, (low, high))


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
