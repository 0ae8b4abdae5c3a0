"""The rows of the page: numbers of a study as text, in the units that people read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from fitting.estimate import Estimate
from solver import effects
from solver.legible import DASH, number, plus_minus, rounded
from solver.quantity import Quantity
from solver.units import of_signal, printed, readable

from .outcome import Candidate, ChannelBeats, NamedEffect, Outcome, OwnNumber
from .places import entry, place_text, plain
from .scales import Z

Array = np.ndarray

_LOUD = 3.0  # |z| that is worth a column of the z map
_FEWEST_HARMONICS = 12
_MOST_POINTS = 400  # of a curve on the page
_LONG_ODDS = 1000.0  # -2 ln: what is beyond is as good as ruled out
_OF_A_SPREAD = 0.1  # the finest that a deviation is told to
_OUTSIDE_PRIOR = 2.0  # prior standard deviations from which a nuisance is worth a second look


# --- what there is ------------------------------------------------------------------------------------------------


def loop_sites(outcome: Outcome) -> list[str]:
    """Sites where both pressure and radius were measured."""
    names = [channel.name for channel in outcome.channels]
    return [name[:-2] for name in names if name.endswith(".P") and f"{name[:-2]}.R" in names]


def period(outcome: Outcome) -> float:
    """The period [s] of the beat whose samples are at ``outcome.time``."""
    time = outcome.time
    return float(time[-1] - time[0]) * len(time) / (len(time) - 1)


def channel_z(outcome: Outcome) -> dict[str, float]:
    """Largest |z| of every channel that was compared."""
    columns = np.abs(outcome.z_map).T
    return {
        channel.name: float(np.nanmax(column, initial=0.0))
        for channel, column in zip(outcome.channels, columns, strict=False)
    }


def harmonics_shown(outcome: Outcome) -> int:
    """Rows of the z map up to the last that is loud, the mean included, and a few at least."""
    loud = np.flatnonzero((np.abs(np.nan_to_num(outcome.z_map)) > _LOUD).any(axis=1))
    wanted = max(_FEWEST_HARMONICS, int(loud[-1]) if loud.size else 0)
    return min(len(outcome.z_map), wanted + 1)


# --- numbers ------------------------------------------------------------------------------------------------------


def estimate_text(name: str, estimate: Estimate) -> tuple[str, str]:
    """(value with unit, 95 % interval) of a parameter in the unit that people read, to the digits the interval has."""
    return _estimate_text(estimate, _quantity(name))


def _quantity(name: str) -> Quantity | None:
    """What the catalogue says of a parameter of an effect."""
    key = name.rpartition(".")[2]
    return next((e.terms[key] for e in effects.ALL if key in e.terms), None)


def _estimate_text(estimate: Estimate, quantity: Quantity | None, least: float = 0.0) -> tuple[str, str]:
    """The same of a quantity; a ratio to another, with a unit of its own, is none. least : width [SI] that it has."""
    display = quantity.display if quantity and quantity.unit == estimate.unit else None
    unit, factor = readable(estimate.unit, display)
    value, low, high = (factor * x for x in (estimate.value, *estimate.ci95))
    width = max(high - low, factor * least)
    value_text, low_text, high_text = (rounded(x, 0.5 * width) for x in (value, low, high))
    told = math.isfinite(low) and math.isfinite(high) and (low_text != high_text or not least)
    interval = f"{low_text} … {high_text}" if told else DASH
    return f"{value_text} {unit}".strip(), interval


def percent(value: float | None) -> str:
    """A part in per cent, never rounded to certainty."""
    if value is None or not math.isfinite(value):
        return DASH
    return "> 99 %" if value >= 0.995 else f"{100 * value:.0f} %"


def p_text(value: float) -> str:
    """A p-value, with the least that is worth telling apart."""
    return "p < 10⁻¹⁶" if value < 1e-16 else f"p = {number(value, 2)}"


def gap_unit(outcome: Outcome) -> str:
    """What a gap is counted in, and why that on the held-out beats is another."""
    said = "A gap is the RMS of model less mean beat, over channels and harmonics, in units of the noise of that mean."
    beats = outcome.provenance.get("beats")
    if not beats:
        return said
    fitted, held_out = beats["fitted"], beats["held_out"]
    return (
        f"{said} The mean of {held_out} held-out beats is noisier than that of {fitted} fitted ones: the same misfit "
        f"is a gap {number(math.sqrt(fitted / held_out), 2)} times smaller there."
    )


def gap_text(pair: tuple[float, float] | None) -> tuple[str, str]:
    """Gap on (fitted, held-out) beats."""
    return (DASH, DASH) if pair is None else (_gap(pair[0]), _gap(pair[1]))


def _gap(value: float) -> str:
    return f"{value:.2f}" if 0.0 <= value < 100.0 else number(value)


def places_text(where: Iterable[str]) -> str:
    """Places in words."""
    return ", ".join(map(place_text, where)) or DASH


def class_texts(outcome: Outcome) -> list[str]:
    """Every hypothesis of the class in words, its effects together; none where nothing else cannot be ruled out."""
    if len(outcome.members) < 2:
        return []
    return [
        " with ".join(f"{plain(name)} at {places_text(where)}" for name, where in member) for member in outcome.members
    ]


# --- rows ---------------------------------------------------------------------------------------------------------


def effect_row(effect: NamedEffect) -> dict[str, Any]:
    """An effect of the verdict: name, place, equation, confidence, parameters, and what the catalogue says of it."""
    row = entry(effect.name)
    return {
        "signature": row.signature,
        "confusable": ", ".join(map(plain, row.confusable)),
        "separator": row.separator,
        "name": plain(effect.name),
        "where": places_text(effect.where),
        "equation": effect.equation,
        "confidence": percent(effect.confidence),
        "parameters": [
            {
                "name": name,
                "what": quantity.description if quantity else "",
                "value": value,
                "interval": interval,
                "si": f"{number(p.value, 5)} {printed(p.unit)}".strip(),
            }
            for name, p in effect.parameters.items()
            for quantity, (value, interval) in [(_quantity(name), estimate_text(name, p))]
        ],
    }


def candidate_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Every hypothesis that was refitted, best first, which is nothing apart from itself."""
    rows = [candidate_row(candidate) for candidate in outcome.candidates]
    return [{**row, "separation": DASH} if i == 0 else row for i, row in enumerate(rows)]


def candidate_row(candidate: Candidate) -> dict[str, Any]:
    """A hypothesis that was refitted."""
    texts = [(name, *estimate_text(name, p)) for name, p in candidate.parameters.items()]
    return {
        "name": plain(candidate.name),
        "where": places_text(candidate.where),
        "parameters": [f"{name} = {value} ({interval})" for name, value, interval in texts],
        "behind": f"> {_LONG_ODDS:g}" if candidate.behind > _LONG_ODDS else number(candidate.behind),
        "walls": candidate.walls,
        "chi2": _gap(candidate.chi2_per_dof),
        "held_out": _gap(candidate.held_out),
        "separation": number(candidate.separation),
        "in_class": candidate.in_class,
    }


def channel_row(channel: ChannelBeats) -> dict[str, str]:
    """The gap of a channel before and after."""
    unit, factor = of_signal(channel.name)
    pulse = factor * float(np.ptp(channel.measured))
    gaps = _gaps(channel.gap_before, channel.gap_after)
    return {"name": channel.name, "pulse": f"{number(pulse)} {unit}", **gaps}


def _gaps(before: tuple[float, float] | None, after: tuple[float, float] | None) -> dict[str, str]:
    """The cells of a row for the gap before and after."""
    keys = ("before_fit", "before_held", "after_fit", "after_held")
    return dict(zip(keys, (*gap_text(before), *gap_text(after)), strict=True))


def z_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """The z map by channel: the text and colour of every cell."""
    located = {(f"{at.site}.{at.signal}", at.harmonic): at.phase for at in outcome.located}
    size = np.abs(outcome.z_map[: harmonics_shown(outcome)])
    return [
        {
            "name": channel.name,
            "cells": [_z_cell(channel.name, k, float(z), located) for k, z in enumerate(column)],
        }
        for channel, column in zip(outcome.channels, size.T, strict=False)
    ]


def _z_cell(name: str, harmonic: int, z: float, located: Mapping[tuple[str, int], float]) -> dict[str, Any]:
    what = "mean" if harmonic == 0 else f"harmonic {harmonic}"
    if not math.isfinite(z):
        return {"text": "", "kind": "none", "found": False, "title": f"{name}, {what}: not compared"}
    phase = located.get((name, harmonic))
    angle = f", phase {number(phase)}°" if phase is not None and harmonic else ""
    title = f"{name}, {what}: |z| = {number(z)}{angle}"
    return {"text": f"{z:.0f}", "kind": f"z{Z.index(z)}", "found": phase is not None, "title": title}


def absorbed_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """What the refit of the nuisances took up."""
    return [
        {
            "name": a.name,
            "shift": plus_minus(a.x, a.sd),
            "prior": f"0 ± {number(a.prior_sd)}",
            "unit": "" if a.unit == "1" else a.unit,
            "relative": number(a.x / a.prior_sd, 2) if a.prior_sd else DASH,
            "factor": f"× {number(math.exp(a.x))}" if a.name.startswith("ln ") else DASH,
            "far": bool(a.prior_sd) and abs(a.x) > _OUTSIDE_PRIOR * a.prior_sd,
        }
        for a in outcome.absorbed
    ]


def wall_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Every number of every artery and outlet: the file's, or a calibration's, and this animal's."""
    arteries = outcome.walls.arteries if outcome.walls else {}
    known = outcome.network_before.parameter_quantities() if outcome.network_before else {}
    rows = []
    for name, own in arteries.items():
        value, interval = _estimate_text(own.now, known.get(name), _finest(outcome, name, own))
        file = _estimate_text(Estimate(own.file, own.now.unit, (own.file, own.file)), known.get(name))[0]
        file += " (calibration)" if own.source == "calibration" else ""
        deviation = f"{round(own.deviation, 1) + 0.0:+.1f}".replace("-", "−").replace("+0.0", "0.0")
        texts = {"name": name, "file": file, "value": value, "interval": interval, "deviation": deviation}
        rows.append({**texts, "beyond": own.beyond})
    return rows


def _finest(outcome: Outcome, name: str, own: OwnNumber) -> float:
    """The least width [SI] that a number of a wall is told to where no differences between arteries were found: its
    interval is then that of no deviation."""
    stated, found = (outcome.walls.spread if outcome.walls else {}).get(name.rpartition(".")[2], (0.0, 1.0))
    return 0.0 if found else 2.0 * _OF_A_SPREAD * stated * (1.0 if _absolute(outcome, name) else abs(own.file))


def _absolute(outcome: Outcome, name: str) -> bool:
    """Whether a number deviates by a shift, not by a factor: it may be negative."""
    known = outcome.network_before.parameter_quantities() if outcome.network_before else {}
    return name in known and known[name].low < 0.0


def spread_text(outcome: Outcome) -> str:
    """How much the arteries of this animal differ, by quantity, beside what was stated, in a sentence."""
    if outcome.walls is None or not outcome.walls.spread:
        return ""
    spread = outcome.walls.spread
    if not any(found for _, found in spread.values()):
        return "No differences between arteries were found beyond what all have in common."
    shifted = {name.rpartition(".")[2] for name in outcome.walls.arteries if _absolute(outcome, name)}
    each = "; ".join(
        f"{key} {number(found, 2)} (stated {number(stated, 2)})" for key, (stated, found) in spread.items()
    )
    absolute = ", ".join(key for key in spread if key in shifted)
    parts = "as parts of the number" + (f", of {absolute} absolute" if absolute else "")
    return f"Standard deviations between arteries, {parts}: {each}."


def round_rows(outcome: Outcome) -> list[dict[str, str]]:
    """Every turn: what was added and what it did to the gap."""
    rows = []
    for i, turn in enumerate(outcome.rounds, 1):
        added = f"{plain(turn.added.name)} at {places_text(turn.added.where)}" if turn.added else "nothing"
        rows.append({"turn": str(i), "added": added, **_gaps(turn.before, turn.after)})
    return rows


def beats(outcome: Outcome) -> dict[str, Any]:
    """The mean beats for the interactive plot, in the units people read, closed and thinned out; ``first``: loudest."""
    time = outcome.time
    if len(time) < 2 or not outcome.channels:
        return {}
    step = -(-len(time) // _MOST_POINTS)

    def short(values: Array, factor: float) -> list[float | None]:
        closed = factor * np.append(values[::step], values[0])
        return [float(f"{x:.6g}") if math.isfinite(x) else None for x in closed.tolist()]

    channels = []
    for channel in outcome.channels:
        unit, factor = of_signal(channel.name)
        channels.append(
            {
                "name": channel.name,
                "unit": unit,
                "measured": short(channel.measured, factor),
                "band": short(channel.band, factor),
                "before": short(channel.before, factor),
                "after": None if channel.after is None else short(channel.after, factor),
            }
        )
    times = np.append(time[::step] - time[0], period(outcome))
    worst = channel_z(outcome)
    first = max(worst, key=worst.__getitem__) if worst else channels[0]["name"]
    return {"time": [float(f"{t:.6g}") for t in times.tolist()], "channels": channels, "first": first}
