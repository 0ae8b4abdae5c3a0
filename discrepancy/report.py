"""The report of a study: one HTML page that needs nothing else, and its figures as PNG."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fitting.pages.page import environment, words
from solver.errors import InputError
from solver.legible import number
from solver.writing import write_folder

from . import tables, thresholds, visible
from .map_text import map_sentences
from .outcome import VERDICTS, Outcome
from .places import label_text
from .scales import APART, Z
from .wording import candidates_heading, heading, meaning, next_steps, of_fit, why_walls

if TYPE_CHECKING:
    from fitting.pages.panels import Drawing

_AS_READ = {"gap_as_given": "gap of the file as it is"}


def write_report(outcome: Outcome, folder: Path) -> None:
    """Write ``report.html`` and ``figures/*.png`` into a folder, which is made if it is missing: all or none.

    Figures of an earlier report that have no data now are removed.
    Raises ValueError as :func:`report_files`, or if the folder or a file cannot be written.
    """
    files = report_files(outcome)
    write_folder(folder, files, gone=set(figure_files()) - set(files))


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
    """The page with its figures inside."""
    templates = environment(Path(__file__).parent / "templates")
    templates.filters |= {
        "number": number,
        "p": tables.p_text,
        "label": label_text,
    }
    return templates.get_template("report.html.j2").render(
        outcome=outcome,
        heading=heading(outcome),
        meaning=meaning(outcome),
        next_steps=next_steps(outcome),
        of_fit=of_fit(outcome),
        candidates_heading=candidates_heading(outcome),
        why_walls=why_walls(outcome),
        drawings=drawings,
        scales={"z": Z, "apart": APART},
        closed=tables.percent(outcome.closed[1] if outcome.closed else None),
        confidence=tables.percent(outcome.confidence),
        inseparable=f"{thresholds.INSEPARABLE:g}",
        invisible=f"{thresholds.INVISIBLE:g}",
        united=any(row["unit"] for row in tables.absorbed_rows(outcome)),
        acts=map_sentences(outcome.map) if outcome.map else [],
        alike=f"{thresholds.RULED_OUT:.2g}",
        **_rows(outcome),
    )


def _rows(outcome: Outcome) -> dict[str, Any]:
    isolability = outcome.isolability
    return {
        "effects": [tables.effect_row(effect) for effect in outcome.effects],
        "members": tables.class_texts(outcome),
        "candidates": tables.candidate_rows(outcome),
        "channels": [tables.channel_row(channel) for channel in outcome.channels],
        "gap_unit": tables.gap_unit(outcome),
        "gap": (*tables.gap_text(outcome.gap_before), *tables.gap_text(outcome.gap_after)),
        "z_rows": tables.z_rows(outcome) if outcome.z_map.size else [],
        "absorbed": tables.absorbed_rows(outcome),
        "walls": tables.wall_rows(outcome),
        "spread": tables.spread_text(outcome),
        "rounds": tables.round_rows(outcome),
        "smallest": visible.smallest_rows(outcome),
        "rivals": visible.rival_rows(isolability) if isolability else [],
        "not_judged": visible.not_judged(outcome),
        "beats": json.dumps(tables.beats(outcome), separators=(",", ":")).replace("<", "\\u003c"),
        "provenance": {
            _AS_READ.get(key, key.replace("_", " ")): words(v)
            for key, v in outcome.provenance.items()
            if v not in ([], {}) and v not in (outcome.record, outcome.model)
        },
    }
