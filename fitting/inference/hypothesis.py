"""Hypotheses: effects at places, with their unknowns and typical sizes, and nuisances, also from a calibration.

Every unknown is one number x, 0 if the effect is absent. |x| = 1 is an effect of typical size, and for a nuisance
one standard deviation of its prior. Effects and quantities define these facts
(:class:`solver.laws.effect.Effect`, :class:`solver.quantities.quantity.Quantity`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.laws import effects
from solver.laws.catalogue import quantities_of
from solver.laws.effect import ALL_PLACES, Effect, value_of
from solver.network.description import Network
from solver.quantities.coordinate import SCALE, SHIFT, Coordinate, allowed
from solver.quantities.quantity import Quantity

from .unknown import OUTLIER, Array, Unknown, with_prior

PRIOR_WIDTH = 10.0  # of an effect's size, in typical sizes; it only regularises the search
HOW_WIDTH = 2.0  # of how it acts, in typical steps
WHERE_WIDTH = 4.0  # of a position or length along a segment, in typical steps: nearly flat
EVERY = "every segment"
OWN = "of its own"
FARTHEST = 2.0  # range of a nuisance's logarithm: seven times the modulus is not the same animal's
_FARTHEST_ALONE = 5.0  # the same on a bench, where a search may pass through values that cost a network minutes
_SPREAD = 0.2  # between arteries, of an effect in all of them whose quantity states no spread
_LONGER = 3.0  # times the usual length: a start for long parts, beside that for short ones
_MARGIN = 1e-3  # distance of a shifted nuisance from its bounds
CALIBRATION = "calibration"  # the group of unknowns of a calibration
_LEAST = 1e-4  # of the largest standard deviation: smaller ones are neglected


@dataclass(frozen=True)
class PlacedEffect:
    """An effect at a place; the place of a channel effect is its channel. starts : start points of its search beside
    zero, for an effect with several minima."""

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
        return effect_of(self).owner == "channel"

    @property
    def rewires(self) -> bool:
        """True if it replaces the outlet condition, and so changes the network."""
        return effect_of(self).rewires

    @property
    def moves_along(self) -> bool:
        """True if its position along its segment may vary."""
        return any(u.name.rpartition(".")[2] in effect_of(self).along for u in self.unknowns)


def effect_of(term: PlacedEffect) -> Effect:
    """The effect of a term. Raises ValueError if it is no longer in the catalogue."""
    found = next((effect for effect in effects.ALL if effect.name == term.effect), None)
    if found is None:
        raise InputError(f"{term.effect}: no effect of the catalogue.")
    return found


def joins(term: PlacedEffect, others: Sequence[PlacedEffect]) -> bool:
    """True if a term can act beside others: it must not change an outlet that another term replaces."""
    gone = tuple(f"{other.place}.outlet." for other in others if other.rewires)
    return not any(variable.startswith(gone) for u in term.unknowns for variable in u.variables)


# --- candidates -------------------------------------------------------------------------------------------------------


def placed_effect(network: Network, effect: Effect, place: str, bench: bool = False) -> PlacedEffect | None:
    """An effect at a place; None if it has no owner to act on there. bench : only P and R of one wall."""
    unknowns = tuple(searched(effect, c) for c in effect.coordinates(network, place, bench))
    return PlacedEffect(effect.name, place, (place,), unknowns, effect.search.starts) if unknowns else None


def searched(effect: Effect, coordinate: Coordinate) -> Unknown:
    """An unknown with its prior: flat for a size, a few typical steps wide for the shape and position of an effect."""
    key = coordinate.name.rpartition(".")[2]
    if key in effect.along:
        return with_prior(coordinate, WHERE_WIDTH)
    of_size = key not in effect.how
    return with_prior(coordinate, PRIOR_WIDTH if of_size else HOW_WIDTH, of_size)


def candidates(
    network: Network, channels: Sequence[str], site: str | None = None, free: Collection[str] = ()
) -> tuple[PlacedEffect, ...]:
    """Every effect at every place; on the bench of one ``site`` only its wall and its two channels.

    free : variables of a prior so wide that an effect which moves only them is no finding.
    """
    found: list[PlacedEffect | None] = []
    for effect in effects.ALL:
        if effect.owner != "channel" and (site is None or effect.search.local):
            where = effect.where(network)
            single = len(effect.places) > 1 and len(where) == 2  # "all" is one place only, which then has its own name
            places = [place for place in where if site in (None, place) and not (single and place == ALL_PLACES)]
            found += [placed_effect(network, effect, place) for place in places]
    found += [term for channel in channels for term in sensor_effects(network, channel, site is not None)]
    terms = (term for term in found if term is not None)
    return tuple(term for term in terms if not {v for u in term.unknowns for v in u.variables} <= set(free))


def sensor_effects(network: Network, channel: str, bench: bool = False) -> tuple[PlacedEffect, ...]:
    """The measurement chain of one channel."""
    found = [placed_effect(network, effect, channel, bench) for effect in effects.ALL if effect.owner == "channel"]
    return tuple(term for term in found if term is not None)


def followers(network: Network, site: str | None, present: Sequence[PlacedEffect]) -> tuple[PlacedEffect, ...]:
    """Terms that ``network`` enables: they had no owner to act on before."""
    known = {term.label for term in present}
    return tuple(t for t in candidates(network, (), site) if t.label not in known and effect_of(t).needs is not None)


def refined(network: Network, term: PlacedEffect, x: Sequence[float]) -> PlacedEffect | None:
    """An effect of all walls with a separate size for every segment, from the common sizes x; else None."""
    effect = effect_of(term)
    if term.place != ALL_PLACES or effect.owner != "segment":
        return None
    found = [placed_effect(network, effect, s) for s in effect.where(network) if s != ALL_PLACES]
    each = [t.unknowns for t in found if t is not None]
    unknowns = tuple(u for own in each for u in own)
    return PlacedEffect(term.effect, EVERY, (ALL_PLACES,), unknowns, (tuple(x) * len(each),)) if len(each) > 1 else None


def about_common(network: Network, term: PlacedEffect, x: Sequence[float]) -> PlacedEffect | None:
    """An effect of all walls whose size varies between segments by a fraction of the common size x."""
    effect = effect_of(term)
    if term.place != ALL_PLACES or effect.owner != "segment" or not all(x) or len(term.unknowns[0].moves) < 2:
        return None
    own = []
    for unknown, size in zip(term.unknowns, x, strict=True):
        for variable, step in unknown.moves:
            spread = effect.terms[variable.rpartition(".")[2]].individual or _SPREAD
            moves, low = ((variable, spread * size * step),), -1.0 / spread  # same sign as the common size
            each = Unknown(f"{variable} {OWN}", SHIFT, moves, low, -low, unknown.unit, ratio=unknown.ratio)
            own.append(replace(each, group=variable.rpartition(".")[2]))
    unknowns = (*term.unknowns, *own)
    return PlacedEffect(term.effect, EVERY, (ALL_PLACES,), unknowns, (tuple(x) + (0.0,) * len(own),))


def placed(network: Network, term: PlacedEffect, x: Sequence[float]) -> PlacedEffect | None:
    """A localised effect with a free position, from the sizes x of the usual part; or, if its position is free, with a
    free length.

    None for other effects.
    """
    effect = effect_of(term)
    there = {u.name for u in term.unknowns}
    missing = [c for c in effect.coordinates_along(network, term.place) if c.name not in there]
    if not missing:
        return None
    lengths = [tuple(times * c.nominal for c in missing) for times in (1.0, _LONGER)]
    values = lengths if term.moves_along else effect.search.starts_along
    along = missing[: len(values[0])]
    starts = [(*x, *((v - c.nominal) / c.size for v, c in zip(each, along, strict=True))) for each in values]
    return replace(term, unknowns=(*term.unknowns, *(searched(effect, c) for c in along)), starts=tuple(starts))


def rewired(network: Network, terms: Iterable[PlacedEffect]) -> Network:
    """The network with the terms at zero size; a rewiring term at the start of its search."""
    for term in terms:
        effect = effect_of(term)
        if effect.rewires:
            start = {u.name.rpartition(".")[2]: u.nominal for u in term.unknowns}
            network = effect.add(network, term.place, start)
        elif effect.owner != "channel":
            present = network.parameters()
            # the term's own variables: on this network, without the terms beside it, there might be nothing to act on
            variables = [v for u in term.unknowns for v in u.variables if v not in present]
            network = network.with_terms({v: effect.neutral[v.rpartition(".")[2]] for v in variables})
    return network


# --- nuisances --------------------------------------------------------------------------------------------------------


def nuisances(network: Network, site: str | None = None) -> tuple[Unknown, ...]:
    """Nuisances: parameters refitted with priors, one factor or shift for all owners; on a bench, those of its wall.

    A parameter defined relative to a scaled one keeps its ratio, as in the paper's comparison of walls.
    """
    found: dict[str, list[tuple[str, Quantity, float]]] = {}
    for prefix, owner in network.owners():
        if site in (None, prefix):
            for key, q in quantities_of(owner).items():
                if ("network" if site is None else "wall") in q.refit:
                    path = f"{prefix}.{key}".partition(".")[2]
                    found.setdefault(path, []).extend(_with_followers(prefix, owner, key))
    prefix = ALL_PLACES if site is None else site
    widest = FARTHEST if site is None else _FARTHEST_ALONE
    return tuple(
        _moved(f"{prefix}.{path}", moved, moved[0][1].spread, widest) for path, moved in found.items() if moved
    )


def deviations(network: Network) -> tuple[Unknown, ...]:
    """Individual deviations of arteries and outlets about the common values: one unknown per parameter.

    x = 1 is the spread that the quantity states; deviations of one quantity form a group. The thickness h has none,
    because the wall law contains it only as a factor of E and of φ0 (and φNL), which deviate.
    """
    found = []
    for prefix, owner in network.owners():
        for key, q in quantities_of(owner).items():
            moved = _with_followers(prefix, owner, key) if q.individual > 0.0 else ()
            if moved:
                found.append(replace(_moved(f"{prefix}.{key} {OWN}", moved, q.individual), group=key))
    return tuple(found)


def _with_followers(prefix: str, owner: Any, key: str) -> list[tuple[str, Quantity, float]]:
    """Variable, quantity and value of a parameter, and of the parameters that keep their ratio to it."""
    quantities = quantities_of(owner)
    values, q = {other: value_of(owner, other) for other in quantities}, quantities[key]
    same = [other for other, each in quantities.items() if other == key or each.ratio_to == key]
    return [(f"{prefix}.{other}", q, values[other]) for other in same if values[other] != 0.0 or q.low < 0.0]


def _moved(name: str, moved: Sequence[tuple[str, Quantity, float]], step: float, widest: float = FARTHEST) -> Unknown:
    """A factor, or a shift if the parameter may be negative, with prior standard deviation ``step``."""
    q, moves = moved[0][1], tuple((variable, step) for variable, _, _ in moved)
    if q.low >= 0.0:
        return Unknown(name, SCALE, moves, -widest / step, widest / step, "1", step, 1.0)
    low = max((q.low + _MARGIN - value) / step for _, _, value in moved)
    high = min((q.high - _MARGIN - value) / step for _, _, value in moved)
    return Unknown(name, SHIFT, moves, low, high, q.unit, step)


# --- a calibration as a prior -----------------------------------------------------------------------------------------
# Deviations along the principal directions of its uncertainty. With the unknowns x of the calibration, their covariance
# Σ = V Λ Vᵀ and what they move, unknown i of the prior moves variable v by √λ_i Σ_j V_ji step_jv and has the standard
# deviation 1, which the record does not change. Factors and shifts have separate Σ: their mutual covariance is
# neglected, which widens the prior.


@dataclass(frozen=True)
class Calibrated:
    """The uncertainty of a calibration. single : variables with an unknown of their own. free : those known so little
    that an effect which moves only them is no finding."""

    unknowns: tuple[Unknown, ...]
    single: frozenset[str]
    free: frozenset[str] = frozenset()


def along(coordinates: Sequence[Coordinate], covariance: Array, network: Network) -> Calibrated:
    """The unknowns of a prior. covariance : (p, p) of the coordinates, counted from the network's own values."""
    found: list[Unknown] = []
    for kind in (SCALE, SHIFT):
        at = [i for i, c in enumerate(coordinates) if c.kind == kind]
        if at:
            found += _directions([coordinates[i] for i in at], covariance[np.ix_(at, at)], network)
    return Calibrated(tuple(found), frozenset(c.moves[0][0] for c in coordinates if len(c.moves) == 1))


def _directions(coordinates: Sequence[Coordinate], covariance: Array, network: Network) -> list[Unknown]:
    kind, values, known = coordinates[0].kind, network.parameters(), network.parameter_quantities()
    names = list(dict.fromkeys(variable for c in coordinates for variable, _ in c.moves))
    steps = np.array([[dict(c.moves).get(name, 0.0) for c in coordinates] for name in names])
    variance, V = np.linalg.eigh(covariance)
    sd = np.sqrt(np.maximum(variance, 0.0))
    found: list[Unknown] = []
    for i in np.flatnonzero(sd > _LEAST * sd.max())[::-1]:
        moved = steps @ V[:, i] * sd[i]
        moves = tuple((name, float(step)) for name, step in zip(names, moved, strict=True) if step != 0.0)
        low, high = _range(kind, moves, values, known)
        if kind == SCALE:  # to e^±FARTHEST as other factors, or OUTLIER standard deviations if that is farther
            most = max(OUTLIER, FARTHEST / max(abs(step) for _, step in moves))
            low, high = max(low, -most), min(high, most)
        name = f"{CALIBRATION} {kind} {len(found) + 1} {OWN}"
        found.append(Unknown(name, kind, moves, low, high, group=CALIBRATION, stated=True))
    return found


def _range(
    kind: str, moves: Sequence[tuple[str, float]], values: Mapping[str, float], known: Mapping[str, Quantity]
) -> tuple[float, float]:
    """The lowest and the highest x that keep every variable in its range."""
    ends = [allowed(kind, ((name, abs(step)),), values, known[name]) for name, step in moves]
    ends = [(a, b) if step > 0.0 else (-b, -a) for (a, b), (_, step) in zip(ends, moves, strict=True)]
    return max(low for low, _ in ends), min(high for _, high in ends)


def possible(network: Network, prior: Calibrated | None) -> tuple[Unknown, ...]:
    """Individual deviations of arteries and outlets: from a calibration, and for parameters that it did not fit
    separately, from the stated spreads."""
    stated = deviations(network)
    return stated if prior is None else (
        *prior.unknowns, *(u for u in stated if not prior.single & set(u.variables))
    )  # fmt: skip


def of_animal(network: Network, own: Sequence[Unknown]) -> list[Unknown]:
    """The unknowns of an animal: common changes, and ``own`` deviations of the parameters in the network. A common
    factor whose variables were all calibrated is omitted.

    A direction that includes a replaced outlet keeps its other variables; together the directions have their remaining
    covariance.
    """
    there = network.parameters()
    moves = {u.name: tuple(move for move in u.moves if move[0] in there) for u in own}
    present = [replace(u, moves=moves[u.name]) for u in own if moves[u.name]]
    known = calibrated(present)
    return [*(u for u in nuisances(network) if not set(u.variables) <= known), *present]


def calibrated(unknowns: Sequence[Unknown]) -> set[str]:
    """The variables of the calibration."""
    return {variable for u in unknowns if u.group == CALIBRATION for variable in u.variables}
