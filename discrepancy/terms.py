"""Hypotheses: which effect acts where, with its unknowns and their typical sizes.

Every unknown is one number x, 0 where the effect is absent. |x| = 1 is an effect of typical size, and for a nuisance
one standard deviation of its prior:

    scale   value = nominal exp(step x)         shift   value = nominal + step x

The variables are those of the FMU; a measurement chain has its own (``CA.P.lag``), which only the observation knows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import effects
from solver.network import Network
from solver.outlets import Reflection, Resistance, Windkessel
from solver.quantity import Quantity

from .outcome import Estimate

Array = np.ndarray

# what an animal may differ in from the network file without being a discovery: ours, of the size of the paper's spread
NUISANCE_SD: Mapping[str, float] = {"E": 0.2, "phi0": 0.2, "R_t": 0.2, "R2": 0.3, "R": 0.3, "R0": 0.01}

# sizes of x = 1; of a number that is not here its nominal value. Those of the wall are relative: phi0 to E [s], phiNL
# to phi0 [s], ENL to E [-]
TYPICAL: Mapping[str, float] = {
    "phi0": 0.017,
    "phiNL": 0.5,
    "ENL": 1.0,
    "tau": 0.01,
    "P_ext": 1333.0,
    "E_scale": 0.3,
    "taper": 0.2,
    "friction_scale": 0.7,
    "alpha": 0.2,
    "unsteady_scale": 1.0,
    "R_t": 0.2,
    "leak": 0.05,
    "K": 10.0,
    "k": 1.0,
    "lag": 3e-3,
    "gain": 0.03,
    "slow": 5e-3,
    "resonance": 1e-4,
}
_OFFSET: Mapping[str, float] = {"P": 400.0, "Q": 1e-6, "R": 1e-4}
SHIFT, SCALE = "shift", "scale"


@dataclass(frozen=True)
class Unknown:
    """One number x. moves : (variable, step) pairs. low, high : the x that allowed ranges leave.

    ratio : the modulus that its value is reported relative to ("E" for φ0/E), or None.
    """

    name: str
    kind: str
    moves: tuple[tuple[str, float], ...]
    low: float
    high: float
    unit: str = "1"
    size: float = 1.0  # of the reported value: value = size x (shift) or nominal exp(size x) (scale)
    nominal: float = 0.0
    ratio: str | None = None

    def estimate(self, x: float, sd: float, quantile: float) -> Estimate:
        """The value with its interval in the unit that is reported."""
        ends = np.clip([x - quantile * sd, x, x + quantile * sd], self.low, self.high)
        scaled = self.size * ends
        values = self.nominal * np.exp(scaled) if self.kind == SCALE else self.nominal + scaled
        low, value, high = (float(v) for v in values)
        return Estimate(value, self.unit, (low, high))


@dataclass(frozen=True)
class Term:
    """An effect at a place; that of a channel effect is its channel. starts : points from which its search may begin,
    beside zero, where it has more than one valley."""

    effect: str
    place: str
    where: tuple[str, ...]
    unknowns: tuple[Unknown, ...]
    starts: tuple[tuple[float, ...], ...] = ()

    @property
    def label(self) -> str:
        return f"{self.effect} at {self.place}"

    @property
    def is_sensor(self) -> bool:
        return effects.BY_NAME[self.effect].owner == "channel"

    @property
    def rewires(self) -> bool:
        """Whether the network itself becomes another one: its outlet has another condition."""
        return self.effect == "terminal_compliance"


def joins(term: Term, others: Sequence[Term]) -> bool:
    """Whether a term can act beside others: an outlet that one of them rewires no longer has what this one moves."""
    gone = tuple(f"{other.place}.outlet." for other in others if other.rewires)
    return not any(variable.startswith(gone) for u in term.unknowns for variable, _ in u.moves)


def values(unknowns: Sequence[Unknown], x: Array, nominal: Mapping[str, float]) -> dict[str, Array]:
    """Values [SI] of all variables that move; x : (…, p) gives arrays (…,). Scales multiply, shifts add."""
    scale: dict[str, Array] = {}
    shift: dict[str, Array] = {}
    for i, unknown in enumerate(unknowns):
        into = scale if unknown.kind == SCALE else shift
        for variable, step in unknown.moves:
            into[variable] = into.get(variable, 0.0) + step * x[..., i]
    names = dict.fromkeys([*scale, *shift])
    return {n: nominal.get(n, 0.0) * np.exp(scale.get(n, 0.0)) + shift.get(n, 0.0) for n in names}


def _wall_step(network: Network, segment: str, key: str, size: float) -> float:
    """The step of a wall's number at a segment: that of a stress is relative to that wall."""
    s = network.segment(segment)
    match key:
        case "phi0" | "ENL":
            return size * s.E
        case "phiNL":
            return size * s.phi0
        case "leak":
            # part of the flow of a progressive wave that is lost over the segment: g L Z = part
            c = math.sqrt(s.E * s.h / (1.0 - network.eta**2) / s.R0 / 2.0 / network.fluid.rho)
            return size * math.pi * s.R0**2 / (network.fluid.rho * c * s.L)
    return size


_RELATIVE = {"phi0": ("E", "s"), "phiNL": ("phi0", "s"), "ENL": ("E", "1")}  # how "all" is reported


def _bounded(name: str, kind: str, moves: Sequence[tuple[str, float]], network: Network, quantity: Quantity,
             unit: str, size: float, nominal: float) -> Unknown:  # fmt: skip
    """An unknown that keeps every variable in its range."""
    present = network.parameters()
    low, high = -math.inf, math.inf
    for variable, step in moves:
        start = present.get(variable, nominal)
        if step <= 0.0:
            continue
        if kind == SCALE:
            low = max(low, math.log(quantity.low / start) / step if quantity.low > 0.0 else -5.0 / step)
            high = min(high, math.log(quantity.high / start) / step)
        else:
            low, high = max(low, (quantity.low - start) / step), min(high, (quantity.high - start) / step)
    return Unknown(name, kind, tuple(moves), low, high, unit, size, nominal)


# where the data bend between no effect and a strong one, a search from zero may end in a side valley
_STARTS: Mapping[str, tuple[tuple[float, ...], ...]] = {
    "stress_relaxation": ((0.3,), (1.0,), (3.0,), (10.0,), (30.0,)),
    "wall_viscosity": ((0.1,), (0.3,), (1.0,)),
    "nonlinear_elasticity": ((1.0,), (4.0,)),
    "nonlinear_wall_viscosity": ((0.5,), (-0.5,), (-2.0,)),
}


def physical_term(network: Network, effect: effects.Effect, place: str) -> Term | None:
    """The term of an effect of wall, fluid, junction or outlet; None where the network leaves it nothing to act on."""
    if effect.name == "terminal_compliance":
        return _windkessel(network, place)
    moved = effect.variables(network, place).items()
    unknowns = tuple(u for u in (_unknown(network, effect, place, key, names) for key, names in moved) if u is not None)
    where = ("all",) if place == "all" else (place,)
    return Term(effect.name, place, where, unknowns, _STARTS.get(effect.name, ())) if unknowns else None


def _unknown(
    network: Network, effect: effects.Effect, place: str, key: str, variables: Sequence[str]
) -> Unknown | None:
    """One number of an effect at a place; None where it would move nothing."""
    quantity, present = effect.terms[key], network.parameters()
    if key in ("phiNL", "tau"):  # what bends or delays a viscous stress needs one
        variables = [v for v in variables if network.segment(v.rpartition(".")[0]).phi0 > 0.0]
        if not variables:
            return None
    start = [present.get(v, effect.neutral[key]) for v in variables]
    segments = [v.rpartition(".")[0] for v in variables]
    scales = key in ("E_scale", "friction_scale") or (key == "phi0" and all(value > 0.0 for value in start))
    if key == "phi0" and not scales and any(value > 0.0 for value in start) and place == "all":
        return None
    size = TYPICAL["E_scale"] if scales and key == "phi0" else TYPICAL.get(key, quantity.nominal)
    kind = SCALE if scales else SHIFT
    moves = [(v, size) for v in variables]
    if effect.owner == "segment" and not scales:
        moves = [(v, _wall_step(network, s, key, size)) for v, s in zip(variables, segments, strict=True)]
        size = moves[0][1]
    unit, nominal = quantity.unit, start[0]
    name = variables[0] if place != "all" else f"all.{key}"
    ratio = None
    if place == "all" and key in _RELATIVE:
        ratio, unit = _RELATIVE[key]
        if scales:
            nominal = float(np.mean([network.segment(s).phi0 / network.segment(s).E for s in segments]))
        else:
            size, nominal = TYPICAL[key], start[0] / getattr(network.segment(segments[0]), ratio)
    return replace(_bounded(name, kind, moves, network, quantity, unit, size, nominal), ratio=ratio)


def _windkessel(network: Network, place: str) -> Term | None:
    """R1, C and R2 in place of a reflection, around the resistance that the reflection has for small waves."""
    outlet = next((o for o in network.outlets if o.segment == place), None)
    if not isinstance(outlet, Reflection) or outlet.R_t > 0.99:
        return None
    s = network.segment(place)
    c = math.sqrt(s.E * s.h / (1.0 - network.eta**2) / s.R0 / 2.0 / network.fluid.rho)
    Z = network.fluid.rho * c / (math.pi * s.R0**2)
    total = Z * (1.0 + outlet.R_t) / (1.0 - outlet.R_t)
    start = {"R1": 0.5 * min(Z, total), "C": 0.05 / total, "R2": total - 0.5 * min(Z, total)}
    units = effects.BY_NAME["terminal_compliance"].terms
    unknowns = tuple(
        Unknown(f"{place}.outlet.{key}", SCALE, ((f"{place}.outlet.{key}", step),), -6.0 / step, 6.0 / step,
                units[key].unit, step, value)
        for (key, value), step in zip(start.items(), (0.3, 0.7, 0.3), strict=True)
    )  # fmt: skip
    return Term("terminal_compliance", place, (place,), unknowns)


def rewired(network: Network, term: Term) -> Network:
    """The network with the term in it, at zero size; for a rewiring term at the size where its search begins."""
    if term.is_sensor:
        return network
    effect = effects.BY_NAME[term.effect]
    if term.rewires:
        return effect.add(network, term.place, {u.name.rpartition(".")[2]: u.nominal for u in term.unknowns})
    present = network.parameters()
    # the term's own variables: on this network, without the terms beside it, the effect might have nothing to act on
    variables = [v for u in term.unknowns for v, _ in u.moves]
    return network.with_terms({v: effect.neutral[v.rpartition(".")[2]] for v in variables if v not in present})


def sensor_terms(channel: str, bench: bool = False) -> tuple[Term, ...]:
    """The measurement chain of one channel. On a bench, where only P against R is known, a sensor can only be late."""
    kind = channel.rpartition(".")[2]
    unit = {"P": "Pa", "Q": "m^3/s", "R": "m"}[kind]
    lag = Unknown(f"{channel}.lag", SHIFT, ((f"{channel}.lag", TYPICAL["lag"]),),
                  0.0 if bench else -30.0, 30.0, "s", TYPICAL["lag"])  # fmt: skip
    gain = Unknown(f"{channel}.gain", SCALE, ((f"{channel}.gain", TYPICAL["gain"]),),
                   -30.0, 30.0, "1", TYPICAL["gain"], 1.0)  # fmt: skip
    offset = Unknown(f"{channel}.offset", SHIFT, ((f"{channel}.offset", _OFFSET[kind]),),
                     -1e3, 1e3, unit, _OFFSET[kind])  # fmt: skip
    slow = Unknown(f"{channel}.slow", SHIFT, ((f"{channel}.slow", TYPICAL["slow"]),), 0.0, 100.0, "s",
                   TYPICAL["slow"])  # fmt: skip
    ringing = Unknown(f"{channel}.resonance", SHIFT, ((f"{channel}.resonance", TYPICAL["resonance"]),), 0.0, 300.0,
                      "s^2", TYPICAL["resonance"])  # fmt: skip
    found = (("channel_lag", (lag,)), ("channel_gain", (gain,)), ("channel_offset", (offset,)),
             ("catheter_resonance", (slow, ringing)))  # fmt: skip
    return tuple(
        Term(name, channel, (channel,), unknowns, _RESONANCES if name == "catheter_resonance" else ())
        for name, unknowns in found
    )


def _resonance(f_n: float, zeta: float) -> tuple[float, float]:
    """x of a second-order sensor."""
    omega = 2.0 * math.pi * f_n
    return 2.0 * zeta / omega / TYPICAL["slow"], omega**-2.0 / TYPICAL["resonance"]


_FREQUENCIES, _DAMPINGS = (8.0, 10.0, 12.0, 15.0, 18.0, 22.0, 27.0, 33.0, 40.0), (0.1, 0.35, 1.2)
_RESONANCES = tuple(_resonance(f_n, zeta) for f_n in _FREQUENCIES for zeta in _DAMPINGS)


def candidates(network: Network, channels: Sequence[str], site: str | None = None) -> tuple[Term, ...]:
    """Every effect at every place; on the bench of one ``site`` only its wall and its two channels."""
    found: list[Term | None] = []
    for effect in effects.ALL:
        if effect.owner == "channel":
            continue
        if site is not None and effect.name not in BENCH:
            continue
        places = [place for place in effect.where(network) if site in (None, place)]
        found += [physical_term(network, effect, place) for place in places if not _alone(network, effect, place)]
    for channel in channels:
        found += sensor_terms(channel, site is not None)
    return tuple(term for term in found if term is not None)


def followers(network: Network, site: str | None, present: Sequence[Term]) -> tuple[Term, ...]:
    """What can act only now that ``network`` has viscous walls: terms whose place had nothing to act on before."""
    known = {term.label for term in present}
    found = candidates(network, (), site)
    return tuple(
        t for t in found if t.label not in known and t.effect in ("nonlinear_wall_viscosity", "stress_relaxation")
    )


def refined(network: Network, term: Term, x: float) -> Term | None:
    """An effect of walls everywhere with a size of its own for every segment, from the common size x; else None."""
    effect = effects.BY_NAME[term.effect]
    if term.place != "all" or effect.owner != "segment":
        return None
    each = [physical_term(network, effect, s) for s in effect.where(network) if s != "all"]
    unknowns = tuple(u for t in each if t is not None for u in t.unknowns)
    return Term(term.effect, EVERY, ("all",), unknowns, ((x,) * len(unknowns),)) if len(unknowns) > 1 else None


def _alone(network: Network, effect: effects.Effect, place: str) -> bool:
    """Whether "all" is one place only, which then has its own name."""
    return place == "all" and effect.owner in ("segment", "outlet", "junction") and len(effect.where(network)) == 2


EVERY = "every segment"

BENCH = ("wall_viscosity", "nonlinear_wall_viscosity", "nonlinear_elasticity", "stress_relaxation",
         "external_pressure", "wall_stiffness")  # fmt: skip
"""Effects that a bench of one site can show: those of the local wall law."""


def nuisances(network: Network, site: str | None = None) -> tuple[Unknown, ...]:
    """What is refitted under priors: E, φ0 and the outlets' reflection or resistance, each one factor for all.

    On the bench of one site its E, φ0 and R0."""
    segments = [s for s in network.segments if site in (None, s.name)]
    prefix = "all" if site is None else site
    # the nonlinear moduli keep their ratio to E and phi0: that is how the paper compares walls
    stiff = [f"{s.name}.{key}" for s in segments for key in ("E", "ENL") if getattr(s, key) != 0.0]
    found = [_scale(f"{prefix}.E", stiff, NUISANCE_SD["E"])]
    viscous = [f"{s.name}.{key}" for s in segments for key in ("phi0", "phiNL") if getattr(s, key) != 0.0]
    if viscous:
        found.append(_scale(f"{prefix}.phi0", viscous, NUISANCE_SD["phi0"]))
    if site is not None:
        return (*found, _scale(f"{site}.R0", [f"{site}.R0"], NUISANCE_SD["R0"]))
    reflecting = [o for o in network.outlets if isinstance(o, Reflection)]
    if reflecting:
        step = NUISANCE_SD["R_t"]
        low = max((-0.998 - o.R_t) / step for o in reflecting)
        high = min((0.999 - o.R_t) / step for o in reflecting)
        moves = tuple((f"{o.segment}.outlet.R_t", step) for o in reflecting)
        found.append(Unknown("all.outlet.R_t", SHIFT, moves, low, high, "1", step))
    for key, kind in (("R2", Windkessel), ("R", Resistance)):
        names = [f"{o.segment}.outlet.{key}" for o in network.outlets if isinstance(o, kind)]
        if names:
            found.append(_scale(f"all.outlet.{key}", names, NUISANCE_SD[key]))
    return tuple(found)


def _scale(name: str, variables: Sequence[str], sd: float) -> Unknown:
    return Unknown(name, SCALE, tuple((v, sd) for v in variables), -5.0 / sd, 5.0 / sd, "1", sd, 1.0)
