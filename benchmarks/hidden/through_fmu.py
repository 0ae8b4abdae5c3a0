"""A sample of the bank through the whole workflow: record on disk, FMU through fmpy, rebuilt FMU, held-out beats."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from discrepancy.workflow import discover
from solver import write_network
from tests.truth.plan import seed_of, whole
from tests.truth.records import Case, make, write

from .bank import read
from .counts import markdown
from .row import Line


def sample(kind: str, group: str, seed: int, every: int, limit: int | None, path: Path) -> Iterator[Line]:
    """Every ``every``-th record of a plan that is not yet in the file; each line is appended as it finishes."""
    done = {line["index"] for line in read(path)}
    cases = whole(kind, group, seed)[:limit]
    for index in range(0, len(cases), every):
        if index not in done:
            line = _through(kind, seed, index, cases[index])
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            yield line


def _through(kind: str, seed: int, index: int, case: Case) -> Line:
    made = make(case, seed_of(kind, seed, index))
    with tempfile.TemporaryDirectory(prefix="hidden_") as folder:
        record, model = Path(folder) / "record.csv", Path(folder) / "model.toml"
        write(made, record)
        write_network(made.base, model)
        start = time.perf_counter()
        outcome = discover(record, model, Path(folder) / "out")
        return {
            "index": index,
            "kind": kind,
            "seed": seed,
            "hidden": [effect.name for effect in case.effects],
            "verdict": outcome.verdict,
            "named": [effect.name for effect in outcome.effects],
            "before": outcome.gap_before,
            "after": outcome.gap_after,
            "sites": dict(outcome.sites),
            "parity": outcome.parity,
            "seconds": time.perf_counter() - start,
        }


def table(lines: Iterable[Line]) -> str:
    """The sample in Markdown: gap on held-out beats before and after if it was 2 or more, whitened RMS of sites
    predicted from the others, difference between FMU and solver, time."""
    rows = []
    by_kind: dict[str, list[Line]] = {}
    for line in lines:
        by_kind.setdefault(line["kind"], []).append(line)
    for kind, found in by_kind.items():
        added = [x for x in found if x["after"] and x["before"][1] >= 2.0]
        cells = [
            f"{kind}: {len(found)}",
            sum(bool(x["after"]) for x in found),
            _middle(x["before"][1] for x in added),
            _middle(x["after"][1] for x in added),
            _middle(rms for x in added for rms in x["sites"].values()),
            _middle((x["parity"] for x in added if x["parity"]), largest=True),
            _middle((x["seconds"] for x in found), largest=True),
        ]
        rows.append(cells)
    header = ("records", "added", "gap before", "gap after", "sites after", "FMU against solver", "seconds")
    return markdown(header, rows)


def _middle(values: Iterable[float], largest: bool = False) -> str:
    found = sorted(values)
    if not found:
        return "–"
    end = f"largest {found[-1]:.2g}" if largest else f"90 % {np.quantile(found, 0.9):.3g}"
    return f"median {np.median(found):.3g}, {end}"
