"""What these sensors see, in words: smallest detectable sizes, what can be told apart, and what could not be judged."""

from __future__ import annotations

import math

from solver.effect import Effect
from solver.legible import number
from solver.sensors import Sensor
from solver.units import readable

from .outcome import Detectable, Outcome
from .places import entry, plain

_NOT_DETECTABLE = "not detectable in its allowed range"
_OUTLET = "another kind of outlet, which is refitted only where no other effect explains the record"
_ANIMAL = "where every artery has walls of its own, it is this subject: see the table of walls"
_TIME = "the time limit was over before it was simulated"
_BREAKS = "the model cannot be simulated with it"


def change_text(label: str, least: Detectable) -> str:
    """The least change with its sign and unit; the numbers of the catalogue where a search counts by others."""
    effect = entry(label.partition(" at ")[0])
    if not math.isfinite(least.change):
        return _NOT_DETECTABLE
    place, _, key = least.parameter.rpartition(".")
    if isinstance(effect, Sensor) and key not in effect.terms:
        searched = dict.fromkeys(effect.searched(place), 0.0) | {key: least.change}
        found = effect.as_terms(searched).items()
        return ", ".join(f"{k} = {number(x)} {effect.terms[k].unit}".removesuffix(" 1") for k, x in found)
    sign = "±" if least.either else "+" if least.change > 0.0 else "−"
    if least.relative:
        return f"{sign}{number(100.0 * abs(least.change))} %"
    quantity = effect.terms.get(key)
    unit, factor = readable(least.unit, quantity.display if quantity and quantity.unit == least.unit else None)
    return f"{sign}{number(factor * abs(least.change))} {unit}".rstrip()


def not_judged(outcome: Outcome) -> dict[str, str]:
    """Effects that nothing can be said of, in words, by the reason."""
    reasons: dict[str, list[str]] = {}
    for name in outcome.not_judged:
        reasons.setdefault(_why(outcome, entry(name)), []).append(plain(name))
    return {reason: ", ".join(names) for reason, names in reasons.items()}


def not_compared(outcome: Outcome) -> str:
    """What a search that was cut short left out, in words: how much of the catalogue, where that is known."""
    table = outcome.isolability
    tried = {name for candidate in outcome.candidates for name in candidate.name.split(" + ")}
    seen = table is not None and table.labels  # then only another kind of outlet waits for its turn
    left = [name for name in outcome.not_judged if name not in tried and (not seen or entry(name).rewires)]
    if table is None or not left or (tried and not seen):  # how much a first test saw is not known
        return "not all candidates were compared"
    number = len(table.labels) + len(table.not_judged)
    if len(left) == number:
        return f"none of the {number} effects of the catalogue was compared"
    return f"{len(left)} of the {number} effects of the catalogue {'was' if len(left) == 1 else 'were'} not compared"


def _why(outcome: Outcome, effect: Effect) -> str:
    """Why an effect was not judged."""
    if effect.rewires:
        return _OUTLET
    if not outcome.complete and outcome.isolability and not outcome.isolability.labels:
        return _TIME
    network, walls = outcome.network_before, outcome.walls
    if network is not None and walls is not None and walls.kind == "individual":
        places = effect.where(network)
        if places and all(effect.of_animal(network, place) for place in places):
            return _ANIMAL
    return _BREAKS
