"""What a verdict means and what to do next, in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from .outcome import Outcome
from .places import of_sensor, plain
from .visible import not_compared

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
    "it.",
    "ambiguous": "The model and the record disagree by more than noise. The candidates of the class below all explain "
    "it; the record does not tell them apart. The first is only the best of them, not a finding.",
    "several": "The model and the record disagree by more than noise, and one effect does not explain it. The effects "
    "below do so together, strongest first.",
    "partial": "The model and the record disagree by more than noise. The effect below explains a significant part of "
    "it, but more than noise remains. What remains counts as a random error of "
    "the model, which makes the interval wider and the name less certain than one without.",
    "unknown": "The model and the record disagree by more than noise. Nothing was added to the model.",
    "unusable": "Nothing was compared and nothing was added to the model, because the record or its use is at fault, "
    "not the physics.",
}

# of a search that came to its end, and of one that did not
_WHOLE: Mapping[str, str] = {
    "effect": "Every other candidate was ruled out: refitted in full, or by a first test that promised too little.",
    "unknown": "No effect of the catalogue explains it.",
}
_CUT_SHORT: Mapping[str, str] = {
    "effect": "Another effect may explain it as well.",
    "unknown": "The catalogue may have what is missing.",
}

_MET = "The model meets the record, but only with improbable numbers"
_MEANING_MET = (
    "With the numbers that the study refits, the model meets the record to its noise, but some are farther from the "
    "file's than those of almost any animal. The file may be of another subject, or something acts that looks like "
    "such numbers. Nothing was added to the model."
)
_NOT_FOUND = "Something is missing, and the search for it did not end"
_TWO_FAULTS = "The sensors of one site seem to have two faults"
_MEANING_TWO_FAULTS = (
    "The model and the record disagree by more than noise. Two faults of the sensors of one site explain it together, "
    "but two such faults can imitate much else: they are no finding."
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
    if outcome.met:
        return _MET
    if outcome.verdict == "unknown" and not outcome.complete:
        return _NOT_FOUND
    return _HEADINGS[outcome.verdict]


def meaning(outcome: Outcome) -> str:
    """What the verdict means, in two or three sentences."""
    two_faults = outcome.verdict == "ambiguous" and not _open(outcome)
    said = [_MEANING_TWO_FAULTS if two_faults else _MEANING_MET if outcome.met else _MEANINGS[outcome.verdict]]
    if not outcome.complete:
        said.append(f"The search ended at its time limit: {not_compared(outcome)}.")
    if not outcome.met:
        said.append((_WHOLE if outcome.complete else _CUT_SHORT).get(outcome.verdict, ""))
    if _open(outcome) and outcome.verdict != "ambiguous":
        said.append(_CLASS)
    if outcome.verdict in ("effect", "partial") and _of_sensors(outcome):
        said.append(_SENSOR)
    return " ".join(filter(None, said))


def _open(outcome: Outcome) -> bool:
    """Whether the record leaves more than one hypothesis."""
    return len(outcome.members) > 1


def _of_sensors(outcome: Outcome) -> bool:
    return bool(outcome.effects) and all(of_sensor(effect.name) for effect in outcome.effects)


def next_steps(outcome: Outcome) -> list[str]:
    """What to measure or to do next, one sentence each."""
    steps = [] if outcome.complete else [more_time(outcome)]
    steps += [outcome.separating_measurement] if outcome.separating_measurement else []
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
            if not outcome.separating_measurement:
                steps.append(f"The study found no one measurement that separates the class; {_ISOLABILITY}")
        case "unknown":
            steps += [*_independent(outcome), _given(outcome)]
        case "unusable":
            steps.append("Put right what is named above and run the study again; no network or FMU was written.")
    return steps


def more_time(outcome: Outcome) -> str:
    """What to do where the search was cut short."""
    limit = outcome.provenance.get("asked", {}).get("time_limit")
    had = "" if limit is None else f" (it was {limit['value']:g} {limit['unit']})"
    return f"Run the study again with a longer --time-limit{had}: {not_compared(outcome)}."


def of_fit(outcome: Outcome) -> str:
    """What the RMS of what remains is counted over, which a gap is not."""
    return " (of all data that were fitted; 1 is noise)" if "RMS" in (outcome.remains or outcome.reason or "") else ""


def candidates_heading(outcome: Outcome) -> str:
    """What the hypotheses that were refitted are to the verdict."""
    return "Effects that were tried and are not needed" if outcome.verdict == "none" else "Candidates"


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
