"""The outcome of a study: indices, percentiles, bands of waveforms, and notes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fitting.results.provenance import engine, software
from solver.quantities.legible import number

from .plan import Array, Plan
from .run import finer_differences
from .sensitivity import LEVELS, Findings, Index, findings
from .store import Store

# Half-width of a 95 % interval of an index above which the study calls N small. It decreases as one over the square
# root of N. On 120 designs of Ishigami's function the bootstrap intervals contain the truth in 0.84 and 0.85 of all
# cases with ± 0.8 and ± 0.5 (total index, N = 8 and 16), and in 0.98 of cases with ± 0.24 or less (N >= 128), with an
# error of 0.05.
WIDE = 0.2


@dataclass(frozen=True)
class Study:
    """A finished study. bands : percentiles (5, 100) of the beats of every channel [SI]."""

    plan: Plan
    found: Findings
    bands: Mapping[str, Array]
    differences: Mapping[str, Array]

    @staticmethod
    def of(store: Store) -> Study:
        """The study of a folder. Raises ValueError if no set could be simulated."""
        found = findings(store.plan, store.read("sets"))
        waves = store.read("waveforms")
        bands = {name: np.percentile(waves[name].drop_nulls().to_numpy(), LEVELS, axis=0) for name in store.plan.waves}
        return Study(store.plan, found, bands, finer_differences(store))

    @cached_property
    def _by_measure(self) -> Mapping[str, tuple[Index, ...]]:
        grouped: dict[str, list[Index]] = {}
        for index in self.found.indices:
            grouped.setdefault(index.measure, []).append(index)
        return {name: tuple(rows) for name, rows in grouped.items()}

    def indices(self, measure: str) -> tuple[Index, ...]:
        """The indices of one number, in the order of the varied parameters; none if it does not vary."""
        return self._by_measure.get(measure, ())

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the study, in sentences."""
        notes, found, plan = [], self.found, self.plan
        if self.differences:
            worst = max(self.differences, key=lambda name: float(self.differences[name].max()))
            largest, n = float(self.differences[worst].max()), len(self.differences[worst])
            notes.append(
                f"{n} of the sets were also run with half the step and half the element length: the beats of P and Q "
                f"differ by {number(largest, 2)} at most ({worst}; relative L2, P without its mean)."
            )
        if found.failures:
            notes.append(
                f"{len(found.failures)} of {plan.size} parameter sets could not be simulated; they are kept with their "
                f"sentences, and the {found.dropped} of {plan.base} groups of D + 2 sets that they belong to are left "
                "out of the indices."
            )
        if found.groups and not found.indices:
            notes.append("there are too few whole groups for indices; allow more --samples, or narrow the ranges.")
        widest = max(found.indices, key=lambda index: index.widest, default=None)
        if widest and widest.widest > WIDE:
            N = 2 ** math.ceil(math.log2(plan.base * (widest.widest / WIDE) ** 2))
            notes.append(
                f"the intervals of the indices are too wide to rank the parameters, up to ± {widest.widest:.2f} "
                f"({widest.varied} on {widest.measure}), because N = {plan.base} is small; --samples {N * plan.group} "
                f"(N = {N}) would bring them to about ± {WIDE:g}."
            )
        return tuple(notes)


def summary(study: Study) -> dict[str, Any]:
    """The study as plain data, numbers in SI."""
    plan, found = study.plan, study.found
    return {
        "model": plan.model.name,
        "software": software(),
        "engine": engine(),
        "sets": plan.size,
        "base": plan.base,
        "seed": plan.seed,
        "sites": list(plan.sites),
        "varied": {v.name: {"low": v.low, "high": v.high, "unit": v.unit, "factor": v.factor} for v in plan.varied},
        "groups": found.groups,
        "dropped_groups": found.dropped,
        "failures": [{"set": number, "sentence": sentence} for number, sentence in found.failures],
        "finer_steps": {
            name: {"sets": len(each), "median": float(np.median(each)), "largest": float(each.max())}
            for name, each in study.differences.items()
        },
        "numbers": {
            name: {
                "unit": unit,
                "percentiles": {f"{level:g}": v for level, v in zip(LEVELS, found.percentiles[name], strict=True)},
                "indices": {i.varied: {k: v for k, v in asdict(i).items() if k[0] == "S"} for i in study.indices(name)},
            }
            for name, unit in plan.measures.items()
        },
        "notes": list(study.notes),
    }


def indices_csv(study: Study) -> str:
    """The indices as a table: a line for each number and varied parameter."""
    rows = [
        f"{i.measure},{i.varied},{i.S1:.6g},{i.S1_conf:.6g},{i.ST:.6g},{i.ST_conf:.6g}" for i in study.found.indices
    ]
    return "\n".join(["number,varied,S1,S1_conf,ST,ST_conf", *rows]) + "\n"
