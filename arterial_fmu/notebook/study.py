"""The outcome of a study in a notebook: its verdict as HTML, its hypotheses as columns, its figures one by one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from arterial_fmu.cli.tables.study import effect_rows, statements
from discrepancy.findings.outcome import Outcome
from discrepancy.report import figures
from fitting.pages.style import Picture

from .tables import table


def html(outcome: Outcome) -> str:
    """The sentence of the verdict, the added effects with their parameters, and the statements of the terminal."""
    rows = [(f"{effect} at {where}", *rest) for effect, where, *rest in effect_rows(outcome)]
    sentences = [*filter(None, statements(outcome)), *outcome.notes, *outcome.warnings]
    title = f"{outcome.verdict}: {outcome.sentence}"
    return table(title, ("effect", "parameter", "value", "95 % interval", "confidence"), rows, sentences)


def columns(outcome: Outcome) -> Mapping[str, Sequence[Any]]:
    """One row a hypothesis, in the words of :class:`~discrepancy.findings.outcome.Candidate`; parameters as text with
    unit."""
    found = outcome.candidates
    texts = {
        "effect": [c.name for c in found],
        "where": [", ".join(c.where) for c in found],
        "parameters": ["; ".join(f"{name} = {e}" for name, e in c.parameters.items()) for c in found],
    }
    numbers = ("behind", "chi2_per_dof", "held_out", "separation", "in_class", "walls")
    return texts | {key: [getattr(c, key) for c in found] for key in numbers}


def figure(outcome: Outcome, name: str | None = None) -> Picture:
    """One figure of the report, by default the first."""
    return figures.figure(outcome, name)
