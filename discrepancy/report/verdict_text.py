"""Sentences about an outcome, for page and terminal: options, visible effects, the source map, a learned law."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Array
from fitting.inference.places import Place
from fitting.records.recordings import size_text
from fitting.results.estimate import Estimate
from solver.laws.effect import CHANNEL, JUNCTION, OUTLET, WALL, Effect
from solver.laws.sensors import Sensor
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, MMHG, readable

from ..findings.map_marks import entry, label_text, of_sensor, places_text, plain
from ..findings.outcome import Detectable, LearnedLaw, NamedEffect, Outcome
from ..findings.shown_map import Acting, SourceMapShown
from ..name.verdict import Naming
from ..thresholds import NO_GAP

_NOT_DETECTABLE = "not detectable in its allowed range"
_OUTLET = "another kind of outlet, refitted only if no other effect explains the record"
_ANIMAL = "a property of this subject, because every artery has its own walls: see the table of walls"
_TIME = "not simulated within the time limit"
_BREAKS = "the simulation fails with it"
_MOST = 3  # rival places that a sentence names
# what acts at a place whose label only names it
_AS = {
    WALL: "a pressure in",
    JUNCTION: "a drop of pressure at",
    OUTLET: "an additional flow through",
    CHANNEL: "an additional signal of",
}
MODEL, DESCRIBED = "model_learned.toml", "model_described.toml"  # networks with a learned law, and with tables


def of_sensors(outcome: Outcome) -> bool:
    """True if all added effects belong to the measurement."""
    return bool(outcome.effects) and all(of_sensor(effect.name) for effect in outcome.effects)


def more_time(outcome: Outcome) -> str:
    """The advice after an incomplete search."""
    limit = outcome.provenance.get("asked", {}).get("time_limit")
    had = "" if limit is None else f" than {limit['value']:g} {limit['unit']}"
    return f"Run the study again with a longer --time-limit{had}: {not_compared(outcome)}."


def of_nothing(outcome: Outcome) -> str:
    """The confidence of the verdict ``none``. With a reason, held-out beats overrule a name: fitted beats alone then
    give the probability."""
    return "probability that nothing is missing" + (", from the fitted beats alone" if outcome.reason else "")


def of_fit(outcome: Outcome) -> str:
    """The data over which the RMS of the residual is taken; a gap is taken over other data."""
    return " (over all fitted data; 1 is noise)" if "RMS" in (outcome.remains or outcome.reason or "") else ""


def late(outcome: Outcome) -> str:
    """The channels that drive the model late, if that is the simplest reading of the added effects; else ""."""
    return late_drive(outcome.effects, [c.name for c in outcome.channels]) if outcome.kind == "network" else ""


def early(outcome: Outcome) -> bool:
    """True if the delay that was named is that of a pressure, which cannot be early."""
    return any(_delay(e) is not None and e.where != (INFLOW,) for e in outcome.effects)


def off_in_the_mean(outcome: Outcome) -> str:
    """The pressures and flows whose gap is more than noise, and mostly in the mean: "Pe.P (1.4 mmHg above the
    model’s)"."""
    found = []
    for c in outcome.channels:
        more = c.measured - (c.before if c.after is None else c.after)
        mean, (_, gap) = float(more.mean()), c.gap_after or c.gap_before
        if c.name[-1] in "PQ" and gap > NO_GAP and mean**2 > float(more.var()):
            side = "above" if mean > 0.0 else "below"
            found.append(f"{c.name} ({size_text(c.name, abs(mean))} {side} the model’s)")
    return ", ".join(found)


def why_walls(outcome: Outcome) -> str:
    """Why the walls are common or individual: an option, or the evidence of the record."""
    asked = outcome.provenance.get("asked", {})
    if "prior" in asked:
        return f"calibrated in {asked['prior']['file']}"
    walls = outcome.walls.kind if outcome.walls else "common"
    if asked.get("walls") == walls:
        return f"set by --walls {walls}"
    if not outcome.complete:
        return "the time limit ended the search before the record could decide"
    if walls == "individual":
        return "the record is more probable with individual walls"
    return "the record gives no evidence for individual walls"


def separating_measurement(naming: Naming) -> str | None:
    """The measurement that separates the members of the class, by the catalogue; None for a class of one."""
    if len(naming.members) < 2:
        return None
    effects = list(dict.fromkeys(t.effect for n in naming.members for t in n.fit.terms))
    places = list(dict.fromkeys(t.place for n in naming.members for t in n.fit.terms))
    sensors = [e for e in effects if of_sensor(e)]
    if sensors and len(effects) > len(sensors):
        channels = [t.place for n in naming.members for t in n.fit.terms if t.is_sensor]
        named = " and ".join(dict.fromkeys(channels))
        return (
            f"Calibrate {named}: apply a known wave to its sensor, or record the same beats with a second sensor "
            f"there; this reveals a sensor fault without the artery."
        )
    if len(effects) == 1:
        return (
            f"The effect is certain, but its place is not ({', '.join(places)}): record pressure, flow and radius "
            f"between these places."
        )
    separators = dict.fromkeys(entry(e).separator for e in effects)
    return f"To distinguish the candidates, measure: {'; '.join(separators)}."


# --- effects that these sensors show ----------------------------------------------------------------------------


def change_text(label: str, least: Detectable) -> str:
    """The smallest detectable change with its sign and unit, in the parameters of the catalogue."""
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
    """Effects without a judgement, in words, by the reason."""
    reasons: dict[str, list[str]] = {}
    for name in outcome.not_judged:
        reasons.setdefault(_why(outcome, entry(name)), []).append(plain(name))
    return {reason: ", ".join(names) for reason, names in reasons.items()}


def not_compared(outcome: Outcome) -> str:
    """The part of the catalogue that an incomplete search did not compare, in words, as far as it is known."""
    table = outcome.isolability
    tried = {name for candidate in outcome.candidates for name in candidate.name.split(" + ")}
    observed = table is not None and table.labels  # then only another kind of outlet waits for its turn
    missing = [name for name in outcome.not_judged if name not in tried and (not observed or entry(name).rewires)]
    if table is None or not missing or (tried and not observed):  # how much a first test saw is not known
        return "not all candidates were compared"
    number = len(table.labels) + len(table.not_judged)
    if len(missing) == number:
        return f"none of the {number} effects of the catalogue was compared"
    return (
        f"{len(missing)} of the {number} effects of the catalogue {'was' if len(missing) == 1 else 'were'} not compared"
    )


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
    """ "inlet.Q is 22 ms late", if that is the only delay named, or if all pressure and radius channels are early, by
    delays that agree within their intervals; flows without a delay are then late, like inlet.Q. Else "".

    effects : the effects added to a model that inlet.Q drives.
    """
    delays = {e.where[0]: ends for e in effects if (ends := _delay(e)) is not None}
    if set(delays) == {INFLOW}:
        return _late([INFLOW], delays[INFLOW][0]) if delays[INFLOW][0] > 0.0 else ""
    others = {name for name in channels if not name.endswith(".Q")}
    if not delays or not others <= set(delays) or any(value >= 0.0 for value, _, _ in delays.values()):
        return ""
    if max(low for _, low, _ in delays.values()) > min(high for _, _, high in delays.values()):
        return ""
    late = [INFLOW, *(name for name in channels if name.endswith(".Q") and name not in delays)]
    return _late(late, -sum(value for value, _, _ in delays.values()) / len(delays))


def _late(channels: Sequence[str], delay: float) -> str:
    """Channels and their delay [s] in words."""
    unit, factor = readable("s", "ms")
    return f"{' and '.join(channels)} {'are' if len(channels) > 1 else 'is'} {number(factor * delay)} {unit} late"


def low_passed(effects: Sequence[NamedEffect]) -> str:
    """ "inlet.Q passes through a low-pass of 10 Hz", if a sensor without resonance is the only effect; else ""."""
    if len(effects) != 1 or (known := _of_channel(effects[0])) is None:
        return ""
    sensor, each = known
    corner = sensor.corner({key: e.value for key, e in each.items()})
    return "" if corner is None else f"{effects[0].where[0]} passes through a low-pass of {number(corner)} Hz"


def _delay(effect: NamedEffect) -> tuple[float, float, float] | None:
    """Value and 95 % limits [s] of an effect that is a pure delay of its channel; else None."""
    if (known := _of_channel(effect)) is None:
        return None
    sensor, each = known
    value = sensor.delay({key: e.value for key, e in each.items()})
    low, high = (sensor.delay({key: e.ci95[i] for key, e in each.items()}) for i in (0, 1))
    return None if value is None or low is None or high is None else (value, low, high)


def _of_channel(effect: NamedEffect) -> tuple[Sensor, dict[str, Estimate]] | None:
    """An effect of one channel as the sensor that it describes, with its numbers; None for other effects."""
    sensor = entry(effect.name)
    if not isinstance(sensor, Sensor) or len(effect.where) != 1:
        return None
    each = {name.rpartition(".")[2]: e for name, e in effect.parameters.items()}
    return (sensor, each) if set(sensor.terms) <= set(each) else None


# --- the source map ---------------------------------------------------------------------------------------------------


def acts_as(shown: SourceMapShown, it: str = "It") -> str:
    """The missing physics: its place, size, time in the beat and share of the gap, and then the places that the record
    cannot distinguish from it. Several signals make a list with a line each. "" if nothing acts.

    it : the subject of the sentence. With several recordings the sentence names that of the map.
    """
    it = f"In {shown.recording} {it[0].lower()}{it[1:]}" if shown.recording else it
    signals = [_signal(a, shown.time) for a in shown.signals]
    numbers = [f"{_odd(a)}." for a in shown.acting if a.number is not None]
    rivals = [_alike(a, len(shown.acting) > 1, shown.recording) for a in shown.acting if a.rivals]
    if len(signals) > 1:
        return "\n".join([f"{it} acts as:", *(f"- {text}" for text in signals), *numbers, *rivals])
    return " ".join([*(f"{it} acts as {text}." for text in signals), *numbers, *rivals])


def joined(text: str, more: str) -> str:
    """Two texts as one: on a new line if either of them is a list, with one signal a line."""
    gap = "\n" if "\n" in text else " "
    return f"{text}{gap}{more}" if more else text


def map_sentences(shown: SourceMapShown, known: str = "") -> list[str]:
    """The source map in sentences, and the χ² that remains with it. known : a text whose sentences are not repeated."""
    misfit = f"χ² is {number(shown.chi2_per_datum)} per datum"
    if not shown.acting and shown.explains:
        return [f"No place shows a residual beyond noise: {misfit} with the subject’s own numbers alone."]
    if not shown.acting:
        return [f"The residual exceeds the noise, but no place explains it: {misfit}."]
    remains = f"{'only noise' if shown.explains else 'more than noise'} remains: {misfit}."
    if acts_as(shown) in known:
        return [f"With the terms named above, {remains}"]
    return [acts_as(shown, "The missing physics"), f"With these terms, {remains}"]


def phrase(place: Place) -> str:
    """The quantity that acts, with its place."""
    return f"{_AS[place.kind]} {place.label}" if place.kind in _AS else place.label


def _signal(a: Acting, time: Array) -> str:
    """One signal: place, size, time in the beat, share of the gap."""
    unit, factor = readable(a.unit)
    pulse = f" ({number(100.0 * a.rms / a.pulse, 2)} % of the pulse of {a.channel})" if a.pulse else ""
    part = f", {a.part} (the strongest of {a.sources} such terms)" if a.part else ""
    size = f"{phrase(a.place)}: {number(factor * a.rms, 2)} {unit} rms{pulse}{part}"
    share = "" if a.share is None else f"; {number(100.0 * a.share, 2)} % of the gap (χ²)"
    if a.steady:
        return f"{size}, nearly constant over the beat{share}"
    peak = f"{size}, largest at {number(float(time[np.argmax(np.abs(a.mean))]), 2)} s"
    phase = f", {number(100.0 * a.phase[1], 2)} % of its energy in {a.phase[0]}" if a.phase else ""
    return f"{peak}{phase}{share}"


def _odd(a: Acting) -> str:
    """A parameter whose value differs from the others of its kind."""
    odd = a.number
    assert odd is not None
    unit, factor = readable(a.unit, odd.display)
    value, file, shift = (f"{number(factor * x)} {unit}".rstrip() for x in (odd.value, odd.file, abs(odd.beyond)))
    off = f"{number(odd.beyond, 2)} times" if odd.factor else f"{shift} {'above' if odd.beyond > 0.0 else 'below'}"
    if odd.only:
        return f"{a.place.name} is {value}; the file has {file}"
    return f"{a.place.name} is an outlier: {value}, {off} the value expected from the others (the file has {file})"


def _alike(a: Acting, several: bool, recording: str) -> str:
    """The places that the record cannot distinguish from the place of a signal. recording : its label, or ""."""
    it = phrase(a.place) if several else "it"
    others = [" with ".join(map(phrase, rival.places)) for rival in a.rivals if rival.places]
    if len(others) > _MOST:
        more = len(others) - _MOST
        others = [*others[:_MOST], f"{more} other place{'s' if more > 1 else ''}"]
    *first, last = others or [""]
    named = f"{', '.join(first)} or {last}" if first else last
    sentences = [f"{recording or 'This record'} cannot distinguish {it} from {named}."] if others else []
    if any(not rival.places for rival in a.rivals):
        others_do = (
            "the other places and the walls, refitted, take its part" if several else "refitted walls take its part"
        )
        sentences.append(f"Without {it}, {recording or 'the record'} is nearly as probable: {others_do}.")
    return " ".join(sentences)


# --- a learned law ----------------------------------------------------------------------------------------------------


def law_text(law: LearnedLaw) -> str:
    """A law, or tables over the beat, in sentences: its formula with the parameters, its test, the gaps without and
    with it, and its range of validity."""
    if not law.is_law:
        return (
            f"No law was found for it. {DESCRIBED} describes this recording by tables over the beat ({law.formula}) "
            f"and explains nothing. {_gaps(law, 'them')}."
        )
    numbers = ", ".join(f"{name} = {each}" for name, each in law.parameters.items())
    owner = f"{'outlet' if law.of_outlet else 'wall'} of {places_text(law.where)}"
    beside = f", beside {' and '.join(map(label_text, law.beside))}," if law.beside else ""
    beside = f" in place of {' and '.join(map(label_text, law.instead))}" if law.instead else beside
    return (
        f"A law fitted to the {owner}{beside} describes this recording: {law.formula}, {numbers}. {_tested(law)} "
        f"{_gaps(law, 'it')}. The recording covers {_learned_range(law)}."
    )


def _gaps(law: LearnedLaw, it: str) -> str:
    """The gaps without and with a law; held-out beats of the same recording are no test of it."""
    before, after = number(law.before[1]), number(law.after[1])
    return f"With {it} the gap to held-out beats of the same recording falls from {before} to {after} times the noise"


def _tested(law: LearnedLaw) -> str:
    """The recordings that have tested a law, and the physics for which it may stand."""
    if not law.elsewhere:
        return (
            f"This is a description and no explanation: no other recording has tested it, and it may stand for "
            f"{stands_for(law.kind)} that the model lacks."
        )
    gaps = (f"{label} from {number(x)} to {number(y)}" for label, (x, y) in law.elsewhere.items())
    return f"It was tested on recordings that it has not seen: there the gap falls as well ({', '.join(gaps)})."


def stands_for(kind: str) -> str:
    """The physics for which a term that leaves more than noise may stand in a model of this kind."""
    return "other physics" if kind == "bench" else "branches or other physics"


def with_law(outcome: Outcome, law: LearnedLaw | None) -> Outcome:
    """An outcome with the law, if there is one, and with the law's sentences."""
    if law is None:
        return outcome
    return replace(outcome, learned=law, sentence=joined(outcome.sentence, law_text(law)))


def _learned_range(law: LearnedLaw) -> str:
    """The range of states from which the law was learned."""
    lows, highs, rates = zip(*law.seen.values(), strict=True)
    low, high, rate = min(lows), max(highs), max(rates)
    if law.of_outlet:
        return f"pressures of {number(low / MMHG, 2)} to {number(high / MMHG, 2)} mmHg above P_venous"
    return f"strains from {number(low, 2)} to {number(high, 2)} and rates up to {number(rate, 2)}/s"
