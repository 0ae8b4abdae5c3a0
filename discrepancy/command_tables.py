"""What the commands print: tables and sentences of an outcome and of a sensor plan."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Column, Table

from solver.console import right
from solver.legible import number

from . import thresholds
from .outcome import Outcome
from .places import places_text, plain
from .sensor_plan import Gain, SensorPlan
from .tables import class_texts, estimate_text, gap_unit, percent, spread_text
from .tables import gap_text as gap_pair
from .wording import of_fit, why_walls

_MOST_GAINS = 3
_MOST_NAMED = 3


def effects_table(outcome: Outcome) -> Table:
    """The effects that were added, with their parameters in the units that people read."""
    titles = {"ambiguous": "best of the class", "partial": "a part of what was missing"}
    title = titles.get(outcome.verdict, "what was missing")
    if outcome.verdict == "ambiguous" and len(outcome.members) < 2:
        title = "two faults of sensors"
    numbers = (Column(each, no_wrap=True) for each in ("parameter", "value", "95 % interval", "confidence"))
    table = Table("effect", "where", *numbers, title=title, pad_edge=False)  # fits 80 columns
    for effect in outcome.effects:
        first, last = (plain(effect.name), places_text(effect.where)), percent(effect.confidence)
        for name, each in effect.parameters.items():
            table.add_row(*first, name, *estimate_text(name, each), last)
            first, last = ("", ""), ""
    return table


def gap_text(outcome: Outcome) -> str:
    """The gap to the record, before and after."""
    if outcome.gap_before is None:
        return ""
    before, after = gap_pair(outcome.gap_before), gap_pair(outcome.gap_after)
    fitted, held = (b if outcome.gap_after is None else f"{b} -> {a}" for b, a in zip(before, after, strict=True))
    return f"gap (1 = noise): {fitted} on the fitted beats, {held} on the held-out ones\n  {gap_unit(outcome)}"


def class_text(outcome: Outcome) -> str:
    """The hypotheses of the class, where there are several."""
    members = "; ".join(class_texts(outcome))
    return f"cannot be told apart: {members}" if members else ""


def walls_text(outcome: Outcome) -> str:
    """Which kind of walls the verdict stands on, where any were compared."""
    if outcome.walls is None or outcome.kind != "network":
        return ""
    if not outcome.walls.arteries:
        return f"walls: common, all arteries differ from the file together ({why_walls(outcome)})"
    return f"walls: individual, every artery by itself ({why_walls(outcome)}). {spread_text(outcome)}".rstrip()


def sure_text(outcome: Outcome) -> str:
    """How sure it is that nothing is missing; of a name, the table of effects says it."""
    if outcome.verdict != "none" or outcome.confidence is None:
        return ""
    return f"probability that nothing is missing: {percent(outcome.confidence)}"


def remains_text(outcome: Outcome) -> str:
    """What remains of the gap, and where."""
    remains = outcome.remains or (outcome.reason if outcome.verdict == "unknown" and not outcome.met else None)
    return f"what remains: {remains}{of_fit(outcome)}" if remains else ""


# --- the sensor plan ----------------------------------------------------------------------------------------------


def plan_table(plan: SensorPlan) -> Table:
    """Every effect that the channels see: how well, and what it could be taken for."""
    columns = ("effect of typical size", right("d′"), "nearest rival", right("separation"))
    table = Table(*columns, title=f"what inlet.Q, {', '.join(plan.channels)} can tell apart")
    for effect, visibility in zip(plan.table.labels, plan.table.visibility, strict=True):
        if effect in plan.table.invisible:
            continue
        rival, separation = plan.table.nearest(effect) or ("–", float("inf"))
        table.add_row(plain(effect), number(float(visibility)), plain(rival), number(separation))
    return table


def confused_text(plan: SensorPlan) -> str:
    """What could be taken for something else."""
    visible = [effect for effect in plan.table.labels if effect not in plan.table.invisible]
    found = {effect: rivals for effect in visible if (rivals := plan.table.confused(effect))}
    if not found:
        return "Every visible effect can be told from every other."
    told = "; ".join(f"{plain(effect)} from {_few(rivals)}" for effect, rivals in found.items())
    return f"Cannot be told apart (separation below {thresholds.INSEPARABLE:g}): {told}."


def _few(effects: Sequence[str]) -> str:
    """Effects in words; many by their number."""
    return ", ".join(map(plain, effects)) if len(effects) <= _MOST_NAMED else f"{len(effects)} others"


def invisible_text(plan: SensorPlan) -> str:
    """What these sensors do not see."""
    said = "Nothing of typical size is invisible."
    if plan.table.invisible:
        said = f"Invisible (d′ below {thresholds.INVISIBLE:g}): {', '.join(map(plain, plan.table.invisible))}."
    if plan.table.not_judged:
        said += f" Not judged (the model breaks down with it): {', '.join(map(plain, plan.table.not_judged))}."
    return said


def gain_text(plan: SensorPlan) -> str:
    """Which sensor to add."""
    useful = [g for g in plan.gains if g.visible or g.separable > 0][:_MOST_GAINS]
    if not useful:
        return "No further sensor of this network would show an effect or separate a pair that these do not."
    first, *others = (f"{g.channel} ({_brings(g)})" for g in useful)
    return f"Add {first}" + (f"; or else {', or '.join(others)}." if others else ".")


def _brings(gain: Gain) -> str:
    """What a sensor brings, in words."""
    said = [f"shows {', '.join(map(plain, gain.visible))}"] if gain.visible else []
    if gain.separable > 0:
        said.append(f"separates {gain.separable} more pair{'s' if gain.separable > 1 else ''}")
    return "; ".join(said)
