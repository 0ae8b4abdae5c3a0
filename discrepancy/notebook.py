"""The outcome of a study in a notebook: its verdict as HTML, its hypotheses as columns, its figures one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from solver.notebook.style import Picture
from solver.notebook.tables import table

from . import figures
from .outcome import Outcome
from .places import effect_text
from .tables import class_texts, estimate_text, gap_text, percent


def html(outcome: Outcome) -> str:
    """The verdict in its sentence, what was added with its parameters, and the gap before and after."""
    rows = [
        (effect_text(effect.name, effect.where), name, *estimate_text(name, each))
        for effect in outcome.effects
        for name, each in effect.parameters.items()
    ]
    title = f"{outcome.verdict}: {outcome.sentence}"
    return table(title, ("effect", "parameter", "value", "95 % interval"), rows, _said(outcome))


def columns(outcome: Outcome) -> Mapping[str, Sequence[Any]]:
    """One row a hypothesis, in the words of :class:`~discrepancy.outcome.Candidate`; parameters as text with unit."""
    found = outcome.candidates
    return {
        "effect": [c.name for c in found],
        "where": [", ".join(c.where) for c in found],
        "parameters": ["; ".join(f"{name} = {e}" for name, e in c.parameters.items()) for c in found],
        "behind": [float(c.behind) for c in found],
        "chi2_per_dof": [float(c.chi2_per_dof) for c in found],
        "held_out": [float(c.held_out) for c in found],
        "separation": [float(c.separation) for c in found],
        "in_class": [bool(c.in_class) for c in found],
        "walls": [c.walls for c in found],
    }


def plotted(outcome: Outcome, name: str | None = None) -> Picture:
    """One figure of the report, by default the first."""
    return figures.figure(outcome, name)


def _said(outcome: Outcome) -> list[str]:
    """What stands below the table, as far as it is known."""
    said = []
    if outcome.confidence is not None and outcome.verdict != "unknown":  # which has no name
        said.append(f"Confidence: {percent(outcome.confidence)}.")
    if outcome.gap_before is not None:
        before, after = (gap_text(pair) for pair in (outcome.gap_before, outcome.gap_after))
        text = f"Gap in units of the noise, fitted and held-out beats: {before[0]} and {before[1]} before"
        said.append(f"{text}, {after[0]} and {after[1]} after." if outcome.gap_after else f"{text}.")
    if members := class_texts(outcome):
        said.append(f"Cannot be told apart: {'; '.join(members)}.")
    said += filter(None, (outcome.reason, outcome.separating_measurement))
    return [*said, *outcome.notes, *outcome.warnings]
