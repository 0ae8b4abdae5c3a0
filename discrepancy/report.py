"""The report of a study: one HTML page that needs nothing else, and its figures as PNG."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import exp
from pathlib import Path
from typing import TYPE_CHECKING

from fitting.pages.page import environment, words
from solver.errors import InputError
from solver.legible import number, plus_minus
from solver.units import printed

from . import places, recorded, tables, thresholds, wording
from .map_text import map_sentences
from .outcome import VERDICTS, Outcome

if TYPE_CHECKING:
    from fitting.pages.panels import Drawing

_AS_READ = {"gap_as_given": "gap of the file as it is"}


def report_files(outcome: Outcome) -> dict[str, str | bytes]:
    """The figures and, last, the page, by their names in the folder.

    Raises ValueError if the verdict is not one of :data:`discrepancy.outcome.VERDICTS`.
    """
    from .figures import figures  # matplotlib takes a second

    if outcome.verdict not in VERDICTS:
        raise InputError(f"verdict {outcome.verdict!r} is not known; it must be one of {', '.join(VERDICTS)}.")
    drawings = figures(outcome)
    pictures: dict[str, str | bytes] = {f"figures/{name}.png": drawn.png for name, drawn in drawings.items()}
    return pictures | {"report.html": page(outcome, drawings)}


def figure_files() -> tuple[str, ...]:
    """The names of all figures that a report may have."""
    from .figures import NAMES

    return tuple(f"figures/{name}.png" for name in NAMES)


def page(outcome: Outcome, drawings: Mapping[str, Drawing]) -> str:
    """The page with its figures inside: the template says what of an outcome stands where, these functions how."""
    templates = environment(Path(__file__).parent / "templates")
    templates.filters |= {
        "entry": places.entry,
        "gap": tables.gap_text,
        "label": places.label_text,
        "number": number,
        "odds": tables.odds_text,
        "p": tables.p_text,
        "percent": tables.percent,
        "places": places.places_text,
        "plain": places.plain,
        "printed": printed,
        "pulse": tables.pulse_text,
        "times": tables.times_noise,
    }
    templates.globals |= {"at": thresholds, "recorded": recorded, "tables": tables, "wording": wording, "Z": tables.Z}
    return templates.get_template("report.html.j2").render(
        outcome=outcome,
        drawings=drawings,
        acts=map_sentences(outcome.map) if outcome.map else [],
        beats=json.dumps(tables.beats(outcome), separators=(",", ":")).replace("<", "\\u003c"),
        plus_minus=plus_minus,
        exp=exp,
        provenance={
            _AS_READ.get(key, key.replace("_", " ")): words(value)
            for key, value in outcome.provenance.items()
            if value not in ([], {}) and value not in (outcome.record, outcome.model)
        },
    )
