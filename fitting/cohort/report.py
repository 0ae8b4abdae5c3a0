"""The report of a cohort: tables of the command line, JSON, and the files of a result folder."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.table import Table

from fitting.pages.style import png
from solver.console import right
from solver.legible import DASH, number, plus_minus
from solver.writing import write_folder

from ..parameter_set import set_content
from ..provenance import software
from ..result_files import json_text
from .claims import Claim
from .figures import cohort_figures
from .fits import QUANTITIES, Cohort, Recording, Summary

# heading, quantity, factor from SI
_SHOWN = (
    ("E_inc, MPa", "E_inc", 1e-6),
    ("E, MPa", "E", 1e-6),
    ("φ0, kPa·s", "phi0", 1e-3),
    ("φ0/E, ms", "phi0/E", 1e3),
    ("φNL/φ0, s", "phiNL/phi0", 1.0),
    ("R0, mm", "R0", 1e3),
    ("R0 measured,\nmm", "R0 measured", 1e3),
)


def tables(cohort: Cohort) -> list[RenderableType]:
    """Means ± standard deviations of the main model by site, the claims, and the failures."""
    shown = [cohort] if cohort.evidence is None or cohort.evidence.decided else [cohort, *cohort.others]
    means = [_means(each) for each in shown]
    means[-1].caption = _sentence(cohort)
    claims = Table("claim", "verdict", "why", title=f"Claims of the paper; {cohort.label}", show_lines=True)
    for claim in cohort.claims():
        claims.add_row(claim.name, claim.verdict, claim.text)
    if not cohort.failures:
        return [*means, claims]
    unused = Table(cohort.noun, "site", "why", title="Not used", show_lines=True)
    for failure in cohort.failures:
        unused.add_row(failure.entry.animal, failure.entry.site, failure.sentence)
    return [*means, claims, unused]


def _means(cohort: Cohort) -> Table:
    """The numbers of ``_SHOWN`` by site."""
    numbers = [right(heading) for heading in ("n", *(heading for heading, _, _ in _SHOWN))]
    spread = f" ± standard deviation between {cohort.noun}s" if len(cohort.animals) > 1 else ""
    title = f"{cohort.label}; {cohort.main} model, {cohort.elastic} law{': mean' if spread else ''}{spread}"
    table = Table("site", *numbers, title=title, padding=0)  # eight quantities fit 80 columns
    for site, row in cohort.table().items():
        n = str(row["E"].n) if "E" in row else "0"
        table.add_row(site, n, *(_cell(row.get(quantity), factor) for _, quantity, factor in _SHOWN))
    return table


def _sentence(cohort: Cohort) -> str:
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
        "claims": [_claim(claim) for claim in cohort.claims()],
        "recordings": [_recording(each) for each in cohort.recordings],
        "failures": [{**asdict(f.entry), "model": f.model, "sentence": f.sentence} for f in cohort.failures],
    }
    return json_text(content, indent=1)


def _cell(summary: Summary | None, factor: float) -> str:
    """Mean ± standard deviation, one below the other: seven numbers fit 80 columns."""
    if summary is None:
        return DASH
    mean, sd = factor * summary.mean, factor * summary.sd
    return plus_minus(mean, sd).replace(" ± ", "\n±") if sd > 0.0 else number(mean, 4)


def _claim(claim: Claim) -> dict[str, Any]:
    return {**asdict(claim), "numbers": dict(claim.numbers)}


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
    return {"name": cohort.elastic, **evidence, "sentence": _sentence(cohort)}
