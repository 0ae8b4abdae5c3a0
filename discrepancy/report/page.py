"""The folder of a study and its report: one HTML page that needs nothing else, and its figures as PNG."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import exp
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fitting.pages.page import environment, words
from fitting.records.recordings import size_text
from fitting.results.result_files import check_unmixed, json_text
from solver.errors import InputError
from solver.io.writing import check_destinations, make_folder, write_folder
from solver.network.files import dumps
from solver.quantities.legible import number, plus_minus
from solver.quantities.units import printed
from solver.simulate import Progress

from .. import thresholds
from ..findings import isolability, map_marks, recorded
from ..findings.outcome import LearnedLaw, Outcome, verdict_json
from ..findings.shown_map import SourceMapShown
from . import tables, verdict_text
from .verdict_text import DESCRIBED, MODEL, law_text, map_sentences

if TYPE_CHECKING:
    from fitting.pages.panels import Drawing


FMU, ITS_FMU, TABLE = "model_learned.fmu", "model_described.fmu", "source.csv"
FILES = (MODEL, FMU, DESCRIBED, ITS_FMU, TABLE)  # of what was learned
_STATE = ".state"  # the journal's folder
_FILES = ("model.toml", "model.fmu", *FILES, "report.html", "verdict.json")  # of a study, as they are written
_AS_READ = {"gap_as_given": "gap of the file as it is"}


def report_files(outcome: Outcome) -> dict[str, str | bytes]:
    """The figures and, last, the page, by their names in the folder."""
    from .figures import figures  # matplotlib takes a second

    drawings = figures(outcome)
    pictures: dict[str, str | bytes] = {f"figures/{name}.png": drawn.png for name, drawn in drawings.items()}
    return pictures | {"report.html": page(outcome, drawings)}


def figure_files() -> tuple[str, ...]:
    """The names of all figures that a report may have."""
    from .figures import NAMES

    return tuple(f"figures/{name}.png" for name in NAMES)


def page(outcome: Outcome, drawings: Mapping[str, Drawing]) -> str:
    """The page with its figures inside. The template selects and places the parts of an outcome; these functions format
    them."""
    templates = environment(Path(__file__).parent / "templates")
    templates.filters |= {
        "entry": map_marks.entry,
        "gap": tables.gap_text,
        "label": map_marks.label_text,
        "number": number,
        "percent": tables.percent,
        "places": map_marks.places_text,
        "plain": map_marks.plain,
        "printed": printed,
        "pulse": tables.pulse_text,
        "times": tables.times_noise,
    }
    templates.globals |= {
        "at": thresholds,
        "limits": isolability,
        "recorded": recorded,
        "size": size_text,
        "tables": tables,
        "wording": verdict_text,
        "Z": tables.Z,
    }
    return templates.get_template("report.html.j2").render(
        outcome=outcome,
        drawings=drawings,
        acts=map_sentences(outcome.map, outcome.sentence) if outcome.map else [],
        beats=json.dumps(tables.beats(outcome), separators=(",", ":")).replace("<", "\\u003c"),
        z_map=np.abs(outcome.z_map[: tables.harmonics_shown(outcome)]).T.tolist(),
        phases={(f"{at.site}.{at.signal}", at.harmonic): at.phase for at in outcome.located},
        plus_minus=plus_minus,
        exp=exp,
        provenance={
            _AS_READ.get(key, key.replace("_", " ")): words(value)
            for key, value in outcome.provenance.items()
            if value not in ([], {}) and value not in (outcome.record, outcome.model)
        },
    )


# --- the folder -------------------------------------------------------------------------------------------------------


def check_folder(folder: Path, given: Iterable[str | os.PathLike[str] | None]) -> None:
    """Make the folder of a study; raise ValueError now, not after all work, if something there is in its way.

    given : the files that the study is of, which it neither replaces nor removes.
    """
    check_unmixed(folder, "discover")
    for path in (folder / _STATE, folder / "figures"):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file where a study has a folder; move it, or give another --out.")
    for path in (folder / file for file in _FILES):
        if path.is_dir():
            raise InputError(f"{path}: is a folder where a study has a file; move it, or give another --out.")
    check_destinations(*(folder / file for file in _FILES), given=given, folders=True)
    make_folder(folder)


def write_study(outcome: Outcome, fmu: bytes | None, folder: Path, progress: Progress) -> Outcome:
    """All files of a study, the verdict last. Files of an earlier verdict that this one does not have are removed.

    A folder with a verdict.json always holds the files that belong to it. An unusable record writes nothing over the
    study of a usable one; the returned outcome says so.
    """
    if outcome.verdict == "unusable" and _holds_study(folder):
        kept = f"{folder}: nothing was written; it holds an earlier study of a record that could be used."
        return replace(outcome, warnings=(*outcome.warnings, kept), written=False)
    progress(0.94, "writing the report")
    files: dict[str, str | bytes] = {}
    if outcome.network_after is not None and fmu is not None:
        files = {"model.toml": dumps(outcome.network_after), "model.fmu": fmu}
    files |= learned_files(outcome.learned, outcome.map if outcome.verdict in ("unknown", "partial") else None)
    files |= report_files(outcome) | {"verdict.json": json_text(verdict_json(outcome))}
    write_folder(folder, files, gone={*figure_files(), *_FILES} - set(files))
    progress(1.0, "done")
    return outcome


def _holds_study(folder: Path) -> bool:
    """Whether a study is in a folder whose record could be used."""
    try:
        return bool(json.loads((folder / "verdict.json").read_text(encoding="utf-8"))["verdict"] != "unusable")
    except (OSError, ValueError, LookupError, TypeError):
        return (folder / "model.toml").exists()


def learned_files(law: LearnedLaw | None, shown: SourceMapShown | None) -> dict[str, str | bytes]:
    """The network with the law or the tables, with its origin in a comment, and its FMU. Without a law also the terms
    of the source map as a table with its band, which describes the record and is not an explanation."""
    files: dict[str, str | bytes] = {}
    if law is not None:
        model, fmu = (MODEL, FMU) if law.is_law else (DESCRIBED, ITS_FMU)
        source = f"# From {law.record[0]} (sha256 {law.record[1]}).\n"
        files = {model: f"# {law_text(law)}\n{source}\n{dumps(law.network)}", fmu: law.archive}
    signals = shown is not None and shown.signals and not (law and law.is_law)
    return files | {TABLE: _table(shown)} if shown is not None and signals else files


def _table(shown: SourceMapShown) -> str:
    """g(t) of every place with its standard deviation, in SI, over one beat."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["time [s]"]
    for a in shown.signals:
        name = a.place.label + (f" ({a.part})" if a.part else "")
        head += [f"{name} [{a.unit}]", f"sd of {name} [{a.unit}]"]
    writer.writerow(head)
    columns = [shown.time, *(c for a in shown.signals for c in (a.mean, a.band))]
    writer.writerows([f"{x:.9g}" for x in row] for row in zip(*columns, strict=True))
    return text.getvalue()
