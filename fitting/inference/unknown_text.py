"""The text of an unknown, as a calibration is asked for it: "all.E", "CA+FA.outlet.R_t:none", "CA.phi0:0.1".

A number that cannot be negative is scaled, x being its logarithm; one that may change sign is shifted in its own unit
(R_t, P_venous), or as its ratio to another number (phiNL/phi0 in s, ENL/E) at the network's own values, as the paper
compares segments. Priors are the spread between animals that quantities state.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from solver.errors import InputError
from solver.laws import effects
from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, allowed
from solver.quantities.quantity import Quantity
from solver.quantities.text import did_you_mean, parse_quantity, pint_spelling

from .hypothesis import OWN
from .unknown import Unknown, is_zero, zero_quantities, zero_values

_NOT_ALL = ("fluid", "network", "solver", "inlet")  # "all" are segments, outlets and junctions


def parse_unknown(text: str, network: Network) -> Unknown:
    """The unknown of a text TARGET.PARAMETER[:PRIOR].

    TARGET : as in :func:`named_parameters`, "fluid" or "network"; or CHANNEL.zero, "C.P.zero".
    PARAMETER : "E", "phi0" …, "outlet.R_t" …. PRIOR : its standard deviation ("0.1", of a shift also "5 mmHg"), or
    "none".
    Raises ValueError for a name that the network has not, a prior that is not positive, or a value 0 to be scaled.
    """
    name, colon, prior = (part.strip() for part in text.partition(":"))
    known = network.parameter_quantities() | zero_quantities(network)
    order = {segment.name: i for i, segment in enumerate(network.segments)}
    along = sorted(known, key=lambda each: order.get(each.partition(".")[0], -1))
    names = named_parameters(name, f"unknown {name}", along, f"network {network.name}")
    nominal = network.parameters() | zero_values(network)
    quantity = known[names[0]]
    shift = quantity.low < 0.0
    steps, unit = _steps(names, quantity, nominal) if shift else ((1.0,) * len(names), "1")
    typical = quantity.spread
    if shift:  # 30 % of what such a number is, or of one unit of a ratio where that is smaller
        ratios = [abs(nominal[each] / step) for each, step in zip(names, steps, strict=True)]
        typical *= quantity.nominal if quantity.ratio_to is None else max(1.0, *ratios)
    kind, moves = SHIFT if shift else SCALE, tuple(zip(names, steps, strict=True))
    for each in names:
        if not shift and nominal[each] <= 0.0:
            raise InputError(
                f"unknown {each}: it is {nominal[each]:g} in the network, which no factor can change; start from a "
                "value above 0."
            )
    prior_sd = _prior(name, prior, unit, typical) if colon else typical
    low, high = allowed(kind, moves, nominal, quantity, math.inf)
    return Unknown(name, kind, moves, low, high, unit, prior_sd=prior_sd, typical_sd=prior_sd or typical)


def parse_unknowns(texts: Iterable[str | Unknown], network: Network) -> tuple[Unknown, ...]:
    """The unknowns of some texts, checked against a network. Raises ValueError as :func:`parse_unknown`."""
    unknowns = tuple(parse_unknown(text, network) if isinstance(text, str) else text for text in texts)
    if not unknowns:
        examples = ("all.E", *(name for name in network.parameter_quantities() if ".outlet.R" in name))[:2]
        given = " ".join(f'--free "{name}"' for name in examples)
        raise InputError(f"unknowns: none given; name parameters of the network '{network.name}', such as {given}.")
    moved: dict[tuple[str, ...], str] = {}
    for unknown in unknowns:
        same = tuple(sorted(unknown.variables))
        if same in moved:
            raise InputError(f"unknowns {moved[same]} and {unknown.name} move the same parameters; keep one of them.")
        moved[same] = unknown.name
    return unknowns


def varied(unknowns: Sequence[Unknown], varies: Sequence[str], labels: Sequence[str]) -> tuple[Unknown, ...]:
    """All unknowns of some recordings: in common, but for some, which have the recording in their name.

    varies : names with wildcards, "*.outlet.R2", of unknowns that have a value for each recording, or of all variables
    of one. labels : of the recordings. Raises ValueError for one that names no unknown, and where there is one
    recording.
    """
    found = list[Unknown]()
    if varies and len(labels) == 1:
        raise InputError(f"--varies {varies[0]}: there is one recording to fit; give others with --and.")
    for pattern in varies:
        if not any(named(unknown, pattern) for unknown in unknowns):
            names = ", ".join(unknown.name for unknown in unknowns)
            raise InputError(f"--varies {pattern}: it names none of the unknowns {names}; name one, or free it, too.")
    for unknown in unknowns:
        own = len(labels) > 1 and any(named(unknown, pattern) for pattern in varies)
        if own and is_zero(unknown.name):
            raise InputError(f"--varies {unknown.name}: all recordings have a sensor's zero in common; leave it out.")
        found += [replace(unknown, name=f"{unknown.name} of {label}") for label in labels] if own else [unknown]
    return tuple(found)


def named(unknown: Unknown, pattern: str) -> bool:
    """Whether a name with wildcards is that of an unknown, or of all variables that it moves."""
    of_one = (unknown.name.removesuffix(f" {OWN}"),)
    return any(all(fnmatchcase(name, pattern) for name in names) for names in (of_one, unknown.variables))


def named_parameters(name: str, option: str, known: Iterable[str], model: str) -> list[str]:
    """The parameters of a name: one, several joined by "+" ("CA+FA.outlet.R_t"), or "all.E", of every segment, outlet
    or junction that has it.

    option : what the name was given for. Raises ValueError if there are none, or one occurs twice.
    """
    known = list(known)
    target, _, key = name.partition(".")
    by_key: dict[str, list[str]] = {}
    for each in known:
        owner, _, own = each.partition(".")
        if owner not in _NOT_ALL:
            by_key.setdefault(own, []).append(each)
    if target == "all":
        if key not in by_key:
            close = did_you_mean(key, by_key).replace("(did you mean ", "(did you mean all.")
            raise InputError(f"{option}: nothing in {model} has {key or 'no name'}; check the name{close}.")
        return by_key[key]
    names = [f"{part.strip()}.{key}" if key else part.strip() for part in target.split("+")]
    for each in names:
        if each not in known:
            hint = f" (did you mean all.{each}?)" if each in by_key else did_you_mean(each, known)
            raise InputError(f"{option}: {each} is not a parameter of {model}; check the name{hint}.")
        if names.count(each) > 1:
            raise InputError(f"{option}: {each} occurs twice; name it once.")
    return names


def _prior(name: str, text: str, unit: str, typical: float) -> float | None:
    """The standard deviation, in ``unit`` or with a unit of its own."""
    if text == "none":
        return None
    try:
        sd = parse_quantity(text, unit, "prior")
    except InputError:
        sd = math.nan
    if not sd > 0.0:
        example = "0.1" if unit == "1" else f"{typical:g} {pint_spelling(unit)}"
        raise InputError(
            f'unknown {name}: prior {text!r} must be a positive standard deviation or none, as in "{name}:{example}".'
        )
    return sd


def _steps(names: Sequence[str], quantity: Quantity, nominal: Mapping[str, float]) -> tuple[tuple[float, ...], str]:
    """Change of each shifted parameter per unit of x, and the unit of x."""
    key, reference = names[0].rpartition(".")[2], quantity.ratio_to
    if reference is None:
        return (1.0,) * len(names), quantity.unit
    specs = [effect.search for effect in effects.ALL]
    unit = next(spec.relative[key][1] for spec in specs if key in spec.relative)
    found = {name: f"{name.rpartition('.')[0]}.{reference}" for name in names}
    for name, of in found.items():
        if nominal[of] == 0.0:
            why = f"{of} is 0, and {key} is sought as a ratio to it; give {of} a value above 0 in the network"
            raise InputError(f"unknown {name}: {why}.")
    return tuple(nominal[of] for of in found.values()), unit
