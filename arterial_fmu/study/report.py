"""The output files of a study: study.json, indices.csv, figures, and study.html."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fitting.pages.page import environment
from fitting.results.provenance import software
from fitting.results.result_files import json_text
from solver.io.writing import write_folder
from solver.quantities.legible import DASH, number, significant
from solver.quantities.units import readable

from .outcome import Study, indices_csv, summary

SHOWN_SITES = 12  # with figures on the page
SHOWN_FAILURES = 20
WRITTEN = ("study.html", "sets.parquet", "waveforms.parquet", "indices.csv", "study.json")


def write(study: Study, folder: Path) -> list[Path]:
    """Write figures, study.json, indices.csv and study.html, all or none; return the most important paths."""
    from .figures import figures  # matplotlib takes a second

    drawings = figures(study, study.plan.sites[:SHOWN_SITES])
    html = page(study, drawings)
    pictures: dict[str, str | bytes] = {f"figures/{name}.png": drawn.png for name, drawn in drawings.items()}
    texts = {"study.json": json_text(summary(study)), "indices.csv": indices_csv(study), "study.html": html}
    write_folder(folder, pictures | texts)
    return [folder / name for name in WRITTEN]


def page(study: Study, drawings: Mapping[str, Any]) -> str:
    """The page with its figures inside."""
    template = environment(Path(__file__).parent / "templates").get_template("study.html.j2")
    plan, found = study.plan, study.found
    return template.render(
        study=study,
        drawings=drawings,
        varied=[_varied_row(study, i) for i in range(len(plan.varied))],
        sites={site: _site_rows(study, site) for site in plan.sites[:SHOWN_SITES]},
        not_shown=plan.sites[SHOWN_SITES:],
        failures=found.failures[:SHOWN_FAILURES],
        software=software(),
        percent=number(100 * len(found.failures) / plan.size, 2),
    )


def _varied_row(study: Study, i: int) -> dict[str, str]:
    """A varied parameter, and the number that depends on it most."""
    each = study.plan.varied[i]
    mine = [index for index in study.found.indices if index.varied == each.name]
    most = max(mine, key=lambda index: index.ST, default=None)
    low, high = _range(each)
    return {
        "name": each.name,
        "low": low,
        "high": high,
        "moves": f"{len(each.nominal)} parameter{'' if len(each.nominal) == 1 else 's'}",
        "most": DASH if most is None else f"{most.measure} ({most.total})",
    }


def _range(each: Any) -> tuple[str, str]:
    text, factor = ("×", 1.0) if each.factor else readable(each.unit)
    ends = (number(factor * end, 4) for end in (each.low, each.high))
    low, high = (f"{text} {end}" if each.factor else f"{end} {text}" for end in ends)
    return low, high


def _site_rows(study: Study, site: str) -> list[dict[str, Any]]:
    """For every number of a site: percentiles, and the index of every varied parameter."""
    rows = []
    for name, unit in study.plan.measures.items():
        if name.split(".")[0] != site:
            continue
        text, factor = readable(unit)
        found = study.indices(name)
        cells: list[tuple[str, ...]] = [(i.total, i.first) for i in found] or [(DASH,)] * len(study.plan.varied)
        rows.append(
            {
                "name": name.partition(".")[2].replace(".", " "),
                "unit": text,
                "percentiles": [significant(factor * v) for v in study.found.percentiles[name]],
                "indices": cells,
                "most": int(np.argmax([i.ST for i in found])) if found else -1,
            }
        )
    return rows
