"""Tables and sentences of an outcome and of a sensor plan, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.table import Column, Table

from arterial_fmu.cli.terminal.console import right
from discrepancy.findings.isolability import INSEPARABLE, INVISIBLE
from discrepancy.findings.map_marks import places_text, plain
from discrepancy.findings.outcome import Outcome
from discrepancy.findings.recorded import TITLES, rows
from discrepancy.plan.sensor_plan import Gain, SensorPlan
from discrepancy.report.tables import class_texts, estimate_text, gap_unit, percent, spread_text
from discrepancy.report.tables import gap_text as gap_pair
from discrepancy.report.verdict_text import of_fit, of_nothing, why_walls
from fitting.records.recordings import changes, sizes
from solver.quantities.legible import DASH, number

_RMS = ("rms_before", "rms_after")
_MOST_GAINS = 3
_MOST_NAMED = 3


def effect_rows(outcome: Outcome) -> Iterator[tuple[str, ...]]:
    """Per added parameter: effect, place, name, value and interval in display units, confidence."""
    for effect in outcome.effects:
        for name, each in effect.parameters.items():
            value, interval = estimate_text(name, each)
            yield plain(effect.name), places_text(effect.where), name, value, interval, percent(effect.confidence)


def effects_table(outcome: Outcome) -> Table:
    """The added effects with their parameters; name, place and confidence of an effect only in its first line."""
    titles = {"ambiguous": "best of the class", "partial": "added effect: a part of the gap looks like it"}
    title = titles.get(outcome.verdict, "added effect" + ("s" if len(outcome.effects) > 1 else ""))
    if outcome.verdict == "ambiguous" and len(outcome.members) < 2:
        title = "two sensor faults"
    numbers = (Column(each, no_wrap=True) for each in ("parameter", "value", "95 % interval", "confidence"))
    table, previous = Table("effect", "where", *numbers, title=title, pad_edge=False), None  # fits 80 columns
    for effect, where, *parameter, confidence in effect_rows(outcome):
        first = (effect, where) != previous
        table.add_row(*((effect, where) if first else ("", "")), *parameter, confidence if first else "")
        previous = (effect, where)
    return table


def recordings_table(outcome: Outcome) -> Table:
    """The residual of each of several recordings."""
    columns = (Column(title, overflow="fold") for title in TITLES)  # names of numbers are longer than their column
    table = Table(*columns, title="each recording, before → after", pad_edge=False)
    for row in rows(outcome.recordings):
        table.add_row(*row)
    return table


def gap_text(outcome: Outcome) -> str:
    """The gap to the record, before and after, and the RMS of the channels over the held-out beats with their means, in
    their units. With several recordings, a table has these RMS instead."""
    if outcome.gap_before is None:
        return ""
    before, after = gap_pair(outcome.gap_before), gap_pair(outcome.gap_after)
    fitted, held_out = (b if outcome.gap_after is None else f"{b} -> {a}" for b, a in zip(before, after, strict=True))
    first, last = ({c.name: pair[1] for c in outcome.channels if (pair := getattr(c, key))} for key in _RMS)
    loud = {c.name: c.gap_before[1] for c in outcome.channels}
    rms = ""
    if first and sum(each.fitted for each in outcome.recordings) < 2:
        rms = f"; rms with the means: {changes(first, last, loud) if set(last) == set(first) else sizes(first, loud)}"
    return (
        f"gap (1 = noise): {fitted} on the fitted beats, {held_out} on the held-out beats{rms}\n  {gap_unit(outcome)}"
    )


def statements(outcome: Outcome) -> Iterator[str]:
    """The sentences below that table: confidence, gap, residual, class, walls, next measurement."""
    if outcome.verdict == "none" and outcome.confidence is not None:  # of a name, the table says it
        yield f"{of_nothing(outcome)}: {percent(outcome.confidence)}"
    yield gap_text(outcome)
    remains = outcome.remains or (outcome.reason if outcome.verdict == "unknown" and not outcome.met else None)
    if remains:
        yield f"residual: {remains}{of_fit(outcome)}"
    if members := class_texts(outcome):
        yield f"not distinguishable: {'; '.join(members)}"
    if outcome.walls is not None and outcome.kind == "network":
        own, why = bool(outcome.walls.arteries), why_walls(outcome)
        kind = "individual, one change for each artery" if own else "common, one change for all arteries"
        yield f"walls: {kind} ({why})" + (f". {spread_text(outcome)}".rstrip() if own else "")
    yield outcome.separating_measurement or ""
    if outcome.verdict == "unusable":
        yield outcome.reason or ""


# --- the sensor plan ----------------------------------------------------------------------------------------------


def plan_table(plan: SensorPlan) -> Table:
    """Every visible effect with its visibility and its nearest rival."""
    columns = ("effect of typical size", right("d′"), "nearest rival", right("separation"))
    table = Table(*columns, title=f"effects that inlet.Q, {', '.join(plan.channels)} can distinguish")
    for effect, visibility in plan.table.visible.items():
        rival, separation = plan.table.nearest(effect) or (DASH, math.inf)
        table.add_row(plain(effect), number(visibility), plain(rival), number(separation))
    return table


def plan_statements(plan: SensorPlan) -> Iterator[str]:
    """The effects that are not distinguishable, those that are invisible, and the sensor to add."""
    found = {effect: rivals for effect in plan.table.visible if (rivals := plan.table.confused(effect))}
    confusions = "; ".join(f"{plain(effect)} from {_few(rivals)}" for effect, rivals in found.items())
    apart = f"Not distinguishable (separation below {INSEPARABLE:g}): {confusions}."
    yield apart if found else "Every visible effect can be distinguished from every other."
    invisible, not_judged = (", ".join(map(plain, each)) for each in (plan.table.invisible, plan.table.not_judged))
    statement = f"Invisible (d′ below {INVISIBLE:g}): {invisible}."
    not_simulated = f" Not judged (the simulation fails with it): {not_judged}." if not_judged else ""
    yield (statement if invisible else "No effect of typical size is invisible.") + not_simulated
    useful = [f"{g.channel} ({_brings(g)})" for g in plan.gains if g.visible or g.separable > 0][:_MOST_GAINS]
    if useful:
        yield f"Add {useful[0]}" + (f"; otherwise {', or '.join(useful[1:])}." if useful[1:] else ".")
    else:
        yield "No further sensor of this network would reveal another effect or separate another pair."


def _few(effects: Sequence[str]) -> str:
    """Effects in words, or their number if there are many."""
    return ", ".join(map(plain, effects)) if len(effects) <= _MOST_NAMED else f"{len(effects)} others"


def _brings(gain: Gain) -> str:
    """The gain from a sensor, in words."""
    gains = [f"reveals {', '.join(map(plain, gain.visible))}"] if gain.visible else []
    if gain.separable > 0:
        gains.append(f"separates {gain.separable} more pair{'s' if gain.separable > 1 else ''}")
    return "; ".join(gains)
