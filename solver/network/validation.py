"""Validation of networks and parameter sets. Every error is one sentence: the quantity, its value, the allowed range,
the remedy."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from ..errors import InputError
from ..laws.catalogue import quantities_of, terms_of
from ..laws.effect import Described, value_of
from ..laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from ..quantities.text import did_you_mean

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
CHECKED_TOGETHER = ("L", "phi0", "phiNL")  # numbers of a segment that are checked by more than their own range
_LARGEST_RATIO = 100.0  # of |phiNL| to phi0 [s]; the paper's are 0.4 to 1.4 s
_SAME_PERIOD = 1e-9
_RESERVED = {"inlet", "fluid", "network", "time", "outlet", "venous"}


def check_network(network: Described) -> None:
    _check_names("network", [network.name], reserved=set())
    _check_names("segment", [s.name for s in network.segments])
    _check_names("site", [s.name for s in network.sites])
    if not network.segments:
        raise InputError(f"network {network.name}: it has no segments; give at least one.")
    _check_law("elastic_law", network.elastic_law, ELASTIC_LAWS)
    _check_law("viscous_law", network.viscous_law, VISCOUS_LAWS)
    for inlet in network.inlets:
        _check_law(f"{inlet.name}.causality", inlet.causality, ("flow", "pressure"))
    for prefix, owner in _all_owners(network):
        for key, quantity_ in quantities_of(owner).items():
            quantity_.check(f"{prefix}.{key}", value_of(owner, key))
    for prefix, owner in network.owners():
        _check_keys(prefix, owner)
    for segment in network.segments:
        _check_ratio(segment.name, np.asarray(segment.phi0), np.asarray(segment.phiNL))
    _check_references(network)
    _check_topology(network)
    _check_periods(network)
    _check_channels(network)


def _all_owners(network: Described) -> Iterator[tuple[str, Any]]:
    junctions = {f"{junction.name}.junction": f"junction {junction.name}" for junction in network.junctions}
    for prefix, owner in network.owners():
        yield junctions.get(prefix, prefix), owner
    yield from ((inlet.name, inlet) for inlet in network.inlets)
    for site in network.sites:
        yield f"site {site.name}", site


def _check_keys(where: str, owner: Any) -> None:
    for key in getattr(owner, "terms", {}):
        if key not in terms_of(owner.OWNER):
            raise InputError(f"{where}.{key}: not a term of a {owner.OWNER}; {_see(key, terms_of(owner.OWNER))}")


def _check_channels(network: Described) -> None:
    names, known = [channel.name for channel in network.channels], network.channel_names()
    for channel in network.channels:
        if channel.name not in known:
            raise InputError(
                f"channel {channel.name!r}: network {network.name} has no such output; {_see(channel.name, known)}"
            )
        if names.count(channel.name) > 1:
            raise InputError(f"channel {channel.name}: it occurs {names.count(channel.name)} times; keep one.")
        _check_keys(channel.name, channel)
        for key, value in channel.terms.items():
            channel.quantities()[key].check(f"{channel.name}.{key}", value)


def check_terms(network: Described, values: Mapping[str, Any]) -> None:
    """Raise ValueError unless every name is a possible term of an object of the network, and every value a number."""
    owners = {prefix: owner.OWNER for prefix, owner in network.owners()}
    owners |= dict.fromkeys(network.channel_names(), "channel")
    for name, value in values.items():
        prefix, _, key = name.rpartition(".")
        terms = terms_of(owners.get(prefix, ""))
        if key not in terms:
            known = [*network.parameter_quantities(), *(f"{prefix}.{term}" for term in terms)]
            raise InputError(f"{name}: neither a parameter nor a term of network {network.name}; {_see(name, known)}")
        if np.asarray(value).dtype.kind not in "fiu":
            raise InputError(f"{name} = {value!r}: must be a number{terms[key].in_unit}.")


def _check_ratio(segment: str, phi0: np.ndarray, phiNL: np.ndarray) -> None:
    """The nonlinear viscous laws contain phiNL/phi0."""
    bad = np.abs(phiNL) > _LARGEST_RATIO * phi0
    if bad.any():
        phi0, phiNL = (x[bad] for x in np.broadcast_arrays(phi0, phiNL))
        raise InputError(
            f"{segment}.phiNL = {phiNL[0]:g} Pa.s^2 is too large for {segment}.phi0 = {phi0[0]:g} Pa.s: "
            f"phiNL/phi0 must lie in [-{_LARGEST_RATIO:g}, {_LARGEST_RATIO:g}] s; "
            f"set {segment}.phiNL to 0 or raise {segment}.phi0."
        )


def _check_names(kind: str, names: list[str], reserved: set[str] = _RESERVED) -> None:
    times = Counter(names)
    for name in names:
        if not isinstance(name, str) or not _NAME.match(name):
            raise InputError(
                f"{kind} name {name!r}: must start with a letter and hold only letters, digits and _; rename it."
            )
        if name in reserved:
            raise InputError(f"{kind} name {name!r} is reserved ({', '.join(sorted(reserved))}); rename it.")
        if times[name] > 1:
            raise InputError(f"{kind} {name}: the name occurs {times[name]} times; names must be unique.")


def _check_law(key: str, name: str, laws: Iterable[str]) -> None:
    if name not in laws:
        raise InputError(f"{key} = {name!r}: must be one of {', '.join(laws)}.")


def _see(name: str, known: Iterable[str]) -> str:
    """The remedy for an unknown name."""
    return f"see the network file for the names{did_you_mean(name, known)}."


def _check_references(network: Described) -> None:
    names = dict.fromkeys(s.name for s in network.segments)
    mentions = [(f"junction {j.name}", s) for j in network.junctions for s in (*j.inflow, *j.outflow)]
    mentions += [(f"site {s.name}", s.segment) for s in network.sites]
    mentions += [(f"outlet {o.segment}", o.segment) for o in network.outlets]
    mentions += [(inlet.name, inlet.segment) for inlet in network.inlets]
    for where, segment in mentions:
        if segment not in names:
            raise InputError(f"{where}: there is no segment {segment!r}; {_see(segment, names)}")


def _check_topology(network: Described) -> None:
    """Check that every end is joined to exactly one object, and that every segment is reachable from the inlet."""
    starts: dict[str, list[str]] = {s.name: [] for s in network.segments}
    ends: dict[str, list[str]] = {s.name: [] for s in network.segments}
    for inlet in network.inlets:
        starts[inlet.segment].append("the inlet" if inlet.first else f"inlets.{inlet.segment}")
    for junction in network.junctions:
        if not junction.inflow or not junction.outflow:
            there = ", ".join(junction.inflow + junction.outflow) or "nothing"
            raise InputError(
                f"junction of {there}: it has no partner; "
                "name at least one segment that flows in and one that flows out."
            )
        for name in junction.inflow:
            ends[name].append(f"junction {junction.name}")
        for name in junction.outflow:
            starts[name].append(f"junction {junction.name}")
    for outlet in network.outlets:
        ends[outlet.segment].append("an outlet condition")
    if not network.outlets:
        raise InputError(f"network {network.name}: it has no outlet; give one to every segment that ends freely.")
    roots = [name for name, at in starts.items() if not at]
    if roots:
        raise InputError(
            f"segment {roots[0]}: its upstream end is not joined, which makes a second root beside "
            f"{network.inlet.segment}; let a junction flow into it, give it an inlet [inlets.{roots[0]}] or remove it."
        )
    for name, at in ends.items():
        if not at:
            raise InputError(
                f"segment {name}: its downstream end has neither junction nor outlet; give one (for example R_t = 0)."
            )
    for which, joined in (("upstream", starts), ("downstream", ends)):
        for name, at in joined.items():
            if len(at) > 1:
                raise InputError(
                    f"segment {name}: its {which} end is joined twice ({' and '.join(at)}); keep one of them."
                )
    _check_reachable(network)


def _check_periods(network: Described) -> None:
    for inlet in network.inlets[1:]:
        if abs(inlet.T - network.inlet.T) > _SAME_PERIOD * inlet.T:
            raise InputError(
                f"{inlet.name}.T = {inlet.T:g} s: all inlets of a network have one period and inlet.T is "
                f"{network.inlet.T:g} s; give both the same."
            )


def _check_reachable(network: Described) -> None:
    joined: dict[str, set[str]] = {s.name: set() for s in network.segments}
    for junction in network.junctions:
        joined[junction.inflow[0]] |= {*junction.inflow, *junction.outflow}
        for name in (*junction.inflow, *junction.outflow):
            joined[name].add(junction.inflow[0])
    reached, new = {network.inlet.segment}, {network.inlet.segment}
    while new:
        new = {other for name in new for other in joined[name]} - reached
        reached |= new
    for segment in network.segments:
        if segment.name not in reached:
            raise InputError(
                f"segment {segment.name}: it cannot be reached from the inlet of {network.inlet.segment}; "
                f"join it with a junction or remove it."
            )


def check_parameters(network: Described, values: Mapping[str, Any]) -> None:
    """Raise ValueError unless every name is a parameter of the network and every value (scalar or array) is allowed."""
    known, arrays = network.parameter_quantities(), dict[str, np.ndarray]()
    for name, value in values.items():
        if name not in known:
            inflow = "the inflow is under [inlet] in the network file; change it there."
            hint = inflow if name.startswith("inlet.") else _see(name, known)
            raise InputError(f"{name}: not a parameter of network {network.name}; {hint}")
        try:
            arrays[name] = np.asarray(value).ravel()
        except ValueError:  # rows of different lengths
            arrays[name] = np.asarray(None)
        if arrays[name].dtype.kind not in "fiu":
            raise InputError(f"{name} = {value!r}: must be a number{known[name].in_unit}, or an array (B,) of them.")
    for name, array in arrays.items():
        q = known[name]
        if q.whole or not np.all((array > q.low) & (array <= q.high) & np.isfinite(array)):
            for single in array:  # one of them is, or may be, out of its range
                q.check(name, float(single))
    for segment in network.segments:
        phi0 = np.asarray(values.get(f"{segment.name}.phi0", segment.phi0))
        phiNL = np.asarray(values.get(f"{segment.name}.phiNL", segment.phiNL))
        _check_ratio(segment.name, phi0, phiNL)
