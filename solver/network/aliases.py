"""Aliases used in papers: areas, beta, C_v, mu, the exponent of the velocity profile, values at both ends. The reader
converts each to the numbers of :mod:`solver.network.description`.

    A0 = π R0²    beta = √π E h/((1 - η²) A0)    C_v = √π φ0 h/(2 (1 - η²) √A0 ρ)    (`sheep_constitutive`)
    mu = ρ ν      u(r) ∝ 1 - (r/R)^γ: friction = 2 (γ + 2), α = (γ + 2)/(γ + 1)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from typing import Any

import numpy as np

from ..errors import InputError
from ..laws import effects
from ..quantities.quantity import Quantity
from ..quantities.text import parse_quantity

Array = np.ndarray

SEGMENT = {
    "A0": Quantity("m^2", "area A0 at P_ref", 0.0, 1.0, display="cm^2", open_low=True),
    "beta": Quantity("Pa/m", "stiffness beta, P = beta (sqrt A - sqrt A0)", 0.0, 1e15, open_low=True),
    "C_v": Quantity("m^2/s", "viscosity C_v of the wall", 0.0, 1e6),
}
FLUID = {
    "mu": Quantity("Pa.s", "dynamic viscosity mu", 0.0, 1e3, display="mPa.s"),
    "profile": Quantity("1", "exponent of the velocity profile", 0.0, 1e4, open_low=True),
}
ENDS = {number: term for effect in effects.ALL for number, term in effect.at_ends.items()}


def fluid(table: Mapping[str, Any], rho: float) -> dict[str, Any]:
    """The section [fluid] with nu for mu, friction and alpha for profile. Raises ValueError for duplicates."""
    remaining = dict(table)
    for key, own in (("mu", ("nu",)), ("profile", ("friction", "alpha"))):
        _alone("fluid", table, key, own)
    given = {key: _checked("fluid", key, remaining.pop(key), q) for key, q in FLUID.items() if key in table}
    if "mu" in given:
        remaining["nu"] = given["mu"] / rho
    if "profile" in given:
        exponent = given["profile"]
        remaining |= {"friction": 2.0 * (exponent + 2.0), "alpha": (exponent + 2.0) / (exponent + 1.0)}
    return remaining


def segment(
    name: str, table: Mapping[str, Any], known: Mapping[str, Quantity], eta: float, rho: float
) -> dict[str, Any]:
    """A section of a segment with R0, E and phi0 for A0, beta and C_v, and middle values for values at both ends.

    known : its quantities. eta : Poisson's ratio. rho : density [kg/m³].
    Raises ValueError for a duplicate, or for a number that requires another one.
    """
    for key, own in (("A0", "R0"), ("beta", "E"), ("C_v", "phi0")):
        _alone(name, table, key, (own,))
    if not any(key in SEGMENT or isinstance(value, list) for key, value in table.items()):
        return dict(table)
    every = dict(known) | SEGMENT
    remaining = {key: value for key, value in table.items() if key not in SEGMENT and not isinstance(value, list)}
    at = {key: _both(name, key, value, every) for key, value in table.items() if key not in remaining}

    def needed(key: str, whose: str) -> Array:
        if key not in at and key not in remaining:
            raise InputError(f"{name}: {whose} needs {key} beside it; add {key}.")
        if key not in at:
            at[key] = np.full(2, _checked(name, key, remaining[key], every[key]))
        return at[key]

    if "A0" in at:
        at["R0"] = np.sqrt(at.pop("A0") / math.pi)
    plate = 1.0 - eta**2
    if "beta" in at:
        R0, h = needed("R0", "beta"), needed("h", "beta")
        at["E"] = at.pop("beta") * plate * math.sqrt(math.pi) * R0**2 / h
    if "C_v" in at:
        R0, h = needed("R0", "C_v"), needed("h", "C_v")
        C_v = at.pop("C_v")
        if C_v[0] != C_v[1]:
            raise InputError(f"{name}.C_v = {table['C_v']}: phi0 is constant along a segment; give one number.")
        at["phi0"] = np.full(2, 2.0 * plate * rho * R0.mean() * C_v[0] / h.mean())
    for key, (a, b) in at.items():
        remaining[key] = float(a) if a == b else 0.5 * float(a + b)
        if a != b:
            _alone(name, table, key, (ENDS[key],))
            remaining[ENDS[key]] = float((b - a) / remaining[key])
    return remaining


def outlet(table: Mapping[str, Any], given: Set[str]) -> dict[str, Any]:
    """A section of an outlet: R and C alone define a two-element Windkessel, R1 = 0 and R2 = R. given : its keys that
    tell the kind."""
    if given != {"R", "C"}:
        return dict(table)
    return {"R1": 0.0, **{"R2" if key == "R" else key: value for key, value in table.items()}}


def _both(name: str, key: str, value: Any, every: Mapping[str, Quantity]) -> Array:
    """The two values of a number at the ends of a segment."""
    if not isinstance(value, list):
        return np.full(2, _checked(name, key, value, every[key]))
    may = [*ENDS, *SEGMENT]
    if key not in may:
        raise InputError(
            f"{name}.{key} = {value}: must be a number{every[key].in_unit}; only {', '.join(may)} may be given "
            "at both ends."
        )
    if len(value) != 2:
        raise InputError(f"{name}.{key} = {value}: must be one number or two, at both ends; write [first, last].")
    return np.array([_checked(name, key, each, every[key]) for each in value])


def _checked(name: str, key: str, value: Any, quantity: Quantity) -> float:
    found = parse_quantity(value, quantity.unit, f"{name}.{key}")
    quantity.check(f"{name}.{key}", found)
    return found


def _alone(name: str, table: Mapping[str, Any], key: str, others: tuple[str, ...]) -> None:
    for other in others:
        if key in table and other in table:
            raise InputError(f"{name}: {key} and {other} say the same; keep one of them.")
