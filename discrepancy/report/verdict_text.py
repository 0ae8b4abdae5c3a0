"""What page and terminal say of an outcome in words: what was asked, what these sensors see, what was left out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from solver.laws.effect import Effect
from solver.laws.sensors import Sensor
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, readable

from ..findings.map_marks import entry, of_sensor, plain
from ..findings.outcome import Detectable, NamedEffect, Outcome
from ..name.verdict import Naming

_NOT_DETECTABLE = "not detectable in its allowed range"
_OUTLET = "another kind of outlet, which is refitted only where no other effect explains the record"
_ANIMAL = "where every artery has walls of its own, it is this subject: see the table of walls"
_TIME = "the time limit was over before it was simulated"
_BREAKS = "the model cannot be simulated with it"


def of_sensors(outcome: Outcome) -> bool:
    """Whether all that was added belongs to the measurement."""
    return bool(outcome.effects) and all(of_sensor(effect.name) for effect in outcome.effects)


def more_time(outcome: Outcome) -> str:
    """What to do where the search was cut short."""
    limit = outcome.provenance.get("asked", {}).get("time_limit")
    had = "" if limit is None else f" (it was {limit['value']:g} {limit['unit']})"
    return f"Run the study again with a longer --time-limit{had}: {not_compared(outcome)}."


def of_fit(outcome: Outcome) -> str:
    """What the RMS of what remains is counted over, which a gap is not."""
    return " (of all data that were fitted; 1 is noise)" if "RMS" in (outcome.remains or outcome.reason or "") else ""


def late(outcome: Outcome) -> str:
    """What drives the model late, where that is the simplest reading of what was added; else ""."""
    return late_drive(outcome.effects, [c.name for c in outcome.channels]) if outcome.kind == "network" else ""


def why_walls(outcome: Outcome) -> str:
    """Why the walls are common or individual: what was asked for, or what the record says."""
    asked = outcome.provenance.get("asked", {})
    if "prior" in asked:
        return f"as calibrated in {asked['prior']['file']}"
    walls = outcome.walls.kind if outcome.walls else "common"
    if asked.get("walls") == walls:
        return f"asked for by --walls {walls}"
    if not outcome.complete:
        return "as far as the search came"
    if walls == "individual":
        return "the record is more probable so"
    return "the record gives no reason for more"


def names(labels: tuple[str, ...]) -> str:
    """Effects in words, each once, without the places."""
    return ", ".join(dict.fromkeys(plain(label.partition(" at ")[0]) for label in labels))


def separating_measurement(naming: Naming) -> str | None:
    """What the catalogue says separates the best of the class from the others; None for a class of one."""
    if len(naming.members) < 2:
        return None
    effects = list(dict.fromkeys(t.effect for n in naming.members for t in n.fit.terms))
    places = list(dict.fromkeys(t.place for n in naming.members for t in n.fit.terms))
    sensors = [e for e in effects if of_sensor(e)]
    if sensors and len(effects) > len(sensors):
        channels = [t.place for n in naming.members for t in n.fit.terms if t.is_sensor]
        named = " and ".join(dict.fromkeys(channels))
        return (
            f"Calibrate {named}: feed its sensor a known wave, or record the same beats with a second sensor there; "
            f"a fault of the measurement shows without the artery."
        )
    if len(effects) == 1:
        return (
            f"The effect is clear, its place is not ({', '.join(places)}): record pressure, flow and radius between "
            f"these places."
        )
    said = dict.fromkeys(entry(e).separator for e in effects)
    return f"Measure what tells them apart: {'; '.join(said)}."


# --- what these sensors see -------------------------------------------------------------------------------------


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


def late_drive(effects: Iterable[NamedEffect], channels: Sequence[str]) -> str:
    """ "inlet.Q is 22 ms late", if all pressures and radii among the channels are early by delays that agree within
    their intervals; flows without a delay are then late with it. Else "".

    effects : that were added to a model driven by inlet.Q.
    """
    delays = {e.where[0]: ends for e in effects if (ends := _delay(e)) is not None}
    others = {name for name in channels if not name.endswith(".Q")}
    if not delays or not others <= set(delays) or any(value >= 0.0 for value, _, _ in delays.values()):
        return ""
    if max(low for _, low, _ in delays.values()) > min(high for _, _, high in delays.values()):
        return ""
    late = [INFLOW, *(name for name in channels if name.endswith(".Q") and name not in delays)]
    unit, factor = readable("s", "ms")
    size = number(-factor * sum(value for value, _, _ in delays.values()) / len(delays))
    return f"{' and '.join(late)} {'are' if len(late) > 1 else 'is'} {size} {unit} late"


def _delay(effect: NamedEffect) -> tuple[float, float, float] | None:
    """Value and ends [s] of an effect that is nothing but a delay of its channel."""
    sensor = entry(effect.name)
    if not isinstance(sensor, Sensor) or len(effect.where) != 1:
        return None
    each = {name.rpartition(".")[2]: e for name, e in effect.parameters.items()}
    if not set(sensor.terms) <= set(each):
        return None
    value = sensor.delay({key: e.value for key, e in each.items()})
    low, high = (sensor.delay({key: e.ci95[i] for key, e in each.items()}) for i in (0, 1))
    return None if value is None or low is None or high is None else (value, low, high)
