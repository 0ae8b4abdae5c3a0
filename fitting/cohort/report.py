"""The report of a cohort: tables of the command line, JSON, and the files of a result folder."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from solver.io.writing import write_folder

from ..pages.style import png
from ..results.parameter_set import set_content
from ..results.provenance import software
from ..results.result_files import json_text
from .figures import cohort_figures
from .fits import QUANTITIES, Cohort, Recording


def evidence_sentence(cohort: Cohort) -> str:
    """The law of all recordings, and the number of them that favour it individually."""
    alone = [each.evidence for each in cohort.recordings if each.evidence is not None]
    own = sum(each.decided and each.kept == cohort.elastic for each in alone)
    against = sum(each.decided and each.kept != cohort.elastic for each in alone)
    counted = f"; individually, {own} of {len(alone)} recordings favour it and {against} another law" if alone else ""
    return f"{cohort.law[0].upper()}{cohort.law[1:]}{counted}."


def write(cohort: Cohort, folder: str | os.PathLike[str]) -> list[Path]:
    """Write the figures, mean_set.json, mean_set.ssv and cohort.json, in this order; return their paths.

    All of them or none. Raises ValueError if the folder or a file cannot be written.
    """
    means = cohort.mean_set()
    figures = {f"{name}.png": png(figure) for name, figure in cohort_figures(cohort).items()}
    sets = {name: set_content(means, name) for name in ("mean_set.json", "mean_set.ssv")}
    return write_folder(folder, {**figures, **sets, "cohort.json": to_json(cohort)})


def to_json(cohort: Cohort) -> str:
    """All numbers as JSON text in SI; null for statistics that one animal cannot give."""
    content = {
        "data": cohort.data,
        "virtual_animals": cohort.virtual,
        "software": software(),
        "animals": cohort.animals,
        "sites": cohort.sites,
        "model": cohort.main,
        "elastic_law": _law(cohort),
        "units": QUANTITIES,
        "table": {
            name: {site: {q: asdict(s) for q, s in row.items()} for site, row in cohort.table(name).items()}
            for name in cohort.models
        },
        "claims": [{**asdict(claim), "numbers": dict(claim.numbers)} for claim in cohort.claims()],
        "recordings": [_recording(each) for each in cohort.recordings],
        "failures": [{**asdict(f.entry), "model": f.model, "sentence": f.sentence} for f in cohort.failures],
    }
    return json_text(content, indent=1)


def _recording(each: Recording) -> dict[str, Any]:
    fits = {
        name: {
            "values": dict(fitted.values),
            "sd": {key: fitted.sd(key) for key in fitted.model.free},
            "r2": fitted.r2,
            "chi2_per_dof": fitted.chi2 / fitted.dof,
            "beats": fitted.n_beats,
            "period": fitted.loop.T,
            "warnings": fitted.warnings,
        }
        for name, fitted in each.fits.items()
    }
    law = {} if each.evidence is None else {"elastic_law": each.evidence.plain}
    return {**asdict(each.entry), "sha256": each.sha256, **law, "fits": fits}


def _law(cohort: Cohort) -> dict[str, Any]:
    evidence = {} if cohort.evidence is None else cohort.evidence.plain
    return {"name": cohort.elastic, **evidence, "sentence": evidence_sentence(cohort)}
