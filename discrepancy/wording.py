"""What a verdict means and what to do next, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from .outcome import Outcome
from .places import of_sensor, plain

_HEADINGS: Mapping[str, str] = {
    "none": "No effect is missing",
    "effect": "One effect is missing",
    "ambiguous": "An effect is missing, and this record leaves several that it can be",
    "several": "Several effects are missing",
    "partial": "An effect is missing, and more than that",
    "unknown": "Something is missing that the catalogue does not have",
    "unusable": "This record cannot be used",
}

_MEANINGS: Mapping[str, str] = {
    "none": "The model meets the record to its noise. An effect may still be there, but smaller than the size given "
    "below, or one that these sensors cannot see.",
    "effect": "The model and the record disagree by more than noise. One effect of the catalogue at one place explains "
    "it. Every other candidate was ruled out: refitted in full, or by a first test that promised too little.",
    "ambiguous": "The model and the record disagree by more than noise. The candidates of the class below all explain "
    "it; the record does not tell them apart. The first is only the best of them, not a finding.",
    "several": "The model and the record disagree by more than noise, and one effect does not explain it. The effects "
    "below do so together, strongest first.",
    "partial": "The model and the record disagree by more than noise. The effect below explains a significant part of "
    "it, but more than noise remains. What remains counts as a random error of "
    "the model, which makes the interval wider and the name less certain than one without.",
    "unknown": "The model and the record disagree by more than noise, and no effect of the catalogue explains it. "
    "Nothing was added to the model.",
    "unusable": "Nothing was compared and nothing was added to the model, because the record or its use is at fault, "
    "not the physics.",
}

_TWO_FAULTS = "The sensors of one site seem to have two faults"
_MEANING_TWO_FAULTS = (
    "The model and the record disagree by more than noise. Two faults of the sensors of one site explain it together. "
    "Every other candidate was ruled out, but two such faults can imitate much else: they are no finding."
)
_CLASS = "The record does not rule out the other candidates of the class below."
_SENSOR = (
    "It belongs to the measurement, not to the arteries: the network file describes it as a property of the channel, "
    "and the physics of the FMU is as it was."
)
_ISOLABILITY = "arterial-fmu isolability lists which sensor would add most."


def heading(outcome: Outcome) -> str:
    """The verdict in a few words."""
    if outcome.verdict == "effect" and _of_sensors(outcome):
        return "A sensor explains the disagreement"
    if outcome.verdict == "partial" and _of_sensors(outcome):
        return "The measurement is at fault, and that is not all"
    if outcome.verdict == "ambiguous" and not _open(outcome):
        return _TWO_FAULTS
    return _HEADINGS[outcome.verdict]


def meaning(outcome: Outcome) -> str:
    """What the verdict means, in two or three sentences."""
    if outcome.verdict == "ambiguous":
        return _MEANINGS["ambiguous"] if _open(outcome) else _MEANING_TWO_FAULTS
    said = [_MEANINGS[outcome.verdict]]
    if _open(outcome):
        said.append(_CLASS)
    if outcome.verdict in ("effect", "partial") and _of_sensors(outcome):
        said.append(_SENSOR)
    return " ".join(said)


def _open(outcome: Outcome) -> bool:
    """Whether the record leaves more than one hypothesis."""
    return len(outcome.members) > 1


def _of_sensors(outcome: Outcome) -> bool:
    return bool(outcome.effects) and all(of_sensor(effect.name) for effect in outcome.effects)


def next_steps(outcome: Outcome) -> list[str]:
    """What to measure or to do next, one sentence each."""
    steps = [outcome.separating_measurement] if outcome.separating_measurement else []
    match outcome.verdict:
        case "none":
            if outcome.invisible:
                steps.append(f"These sensors cannot see {_names(outcome.invisible)}; {_ISOLABILITY}")
            steps.append("More beats lower the smallest detectable sizes as one over the square root of their number.")
        case "effect" if _of_sensors(outcome):
            steps.append("Calibrate that sensor, or exchange it, and record again: the disagreement should go with it.")
        case "effect" | "several":
            steps.append(
                "Confirm the added term on a record that was not used here, at another heart rate if you can: its "
                "parameter should come out the same."
            )
        case "partial":
            steps += [
                *_independent(outcome),
                f"{_given(outcome)} What remains may come from them, not from the arteries.",
            ]
            steps.append(
                "Judge the added term by what it leaves: the z map and the gaps of the channels below show where."
            )
        case "ambiguous" if not _open(outcome):
            steps.append("Calibrate the sensors of that site, or exchange them, and record again.")
        case "ambiguous":
            if not steps:
                steps.append(f"The study found no one measurement that separates the class; {_ISOLABILITY}")
        case "unknown":
            steps += [*_independent(outcome), _given(outcome)]
        case "unusable":
            steps.append("Put right what is named above and run the study again; no network or FMU was written.")
    if not outcome.complete:
        steps.append(more_time(outcome))
    return steps


def more_time(outcome: Outcome) -> str:
    """What to do where the search was cut short."""
    limit = outcome.provenance.get("asked", {}).get("time_limit")
    had = "" if limit is None else f", which was {limit['value']:g} {limit['unit']}"
    return f"Run the study again with more time (--time-limit{had}): not all candidates were compared."


def _given(outcome: Outcome) -> str:
    """What to check first."""
    given = (
        "that both sensors are at one place, and the thickness" if outcome.kind == "bench" else "geometry and outlets"
    )
    return f"Check what the model takes as given: {given}."


def _independent(outcome: Outcome) -> list[str]:
    """Which sensor to doubt first."""
    if not outcome.located:
        return []
    at = outcome.located[0]
    return [
        f"The disagreement is largest at {at.site}.{at.signal}: a second, independent sensor there would tell a fault "
        "of the measurement from missing physics."
    ]


def _names(labels: tuple[str, ...]) -> str:
    """Effects in words, each once, without the places."""
    return ", ".join(dict.fromkeys(plain(label.partition(" at ")[0]) for label in labels))
