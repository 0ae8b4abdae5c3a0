"""The outcome of a study: first-order and total indices of every number, percentiles, bands of waveforms, and notes.

First-order index S1: the share of a number's variance that one parameter explains alone; total index ST: including its
interactions with the others. Estimators and their bootstrap intervals by SALib (Saltelli et al. 2010).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from fitting.results.provenance import engine, software
from solver.errors import InputError
from solver.quantities.legible import number

from .batch import FAILED, pulse_of
from .plan import Array, Plan
from .store import GROUP, Store, finer_differences

# Half-width of a 95 % interval of an index above which the study calls N small. It decreases as one over the square
# root of N. On 120 designs of Ishigami's function the bootstrap intervals contain the truth in 0.84 and 0.85 of all
# cases with ± 0.8 and ± 0.5 (total index, N = 8 and 16), and in 0.98 of cases with ± 0.24 or less (N >= 128), with an
# error of 0.05.
WIDE = 0.2
LEVELS = (5.0, 25.0, 50.0, 75.0, 95.0)  # percentiles
_FEWEST = 8  # minimum number of groups for indices
_CONSTANT = 1e-9  # relative spread of a number that does not vary


@dataclass(frozen=True)
class Index:
    """One parameter's share of one number's variance, with the half-widths of 95 % intervals."""

    measure: str
    varied: str
    S1: float
    S1_conf: float
    ST: float
    ST_conf: float

    @property
    def first(self) -> str:
        """S1 ± half of its 95 % interval."""
        return _index(self.S1, self.S1_conf)

    @property
    def total(self) -> str:
        """ST ± half of its 95 % interval."""
        return _index(self.ST, self.ST_conf)

    @property
    def widest(self) -> float:
        """The larger half-width of the two."""
        return max(self.S1_conf, self.ST_conf)


def _index(value: float, half: float) -> str:
    return f"{value + 0.0:.2f} ± {half:.2f}".replace("-0.00", "0.00").replace("-", "−")


@dataclass(frozen=True)
class Findings:
    """indices : by number, then by varied parameter. groups : number used for the indices; dropped : groups with a
    failed set. percentiles : by number, at LEVELS. failures : sets and their sentences."""

    indices: tuple[Index, ...]
    groups: int
    dropped: int
    percentiles: dict[str, tuple[float, ...]]
    failures: tuple[tuple[int, str], ...]


def findings(plan: Plan, sets: pl.DataFrame) -> Findings:
    """The findings from the results of a study. Raises ValueError if no set could be simulated."""
    failed = sets.filter(pl.col(FAILED).is_not_null())
    if len(failed) == len(sets):
        raise InputError(f"none of the {len(sets)} parameter sets could be simulated; the first: {failed[FAILED][0]}")
    good = sets.filter(pl.col(FAILED).is_null())
    percentiles = {name: tuple(np.percentile(good[name].to_numpy(), LEVELS).tolist()) for name in plan.measures}
    lost = failed[GROUP].unique()
    kept = sets.filter(~pl.col(GROUP).is_in(lost.implode()))
    indices = [index for name in plan.measures for index in _indices(plan, name, kept)]
    why = tuple(zip(failed["set"].to_list(), failed[FAILED].to_list(), strict=True))
    return Findings(tuple(indices), plan.base - len(lost), len(lost), percentiles, why)


def _indices(plan: Plan, name: str, sets: pl.DataFrame) -> Sequence[Index]:
    """The indices of one number from its groups of D + 2 sets; none if it varies by no more than the beats' tolerance
    (the mean flow that enters, for example), or there are too few groups."""
    y = sets[name].to_numpy()
    if len(y) < _FEWEST * plan.group:
        return ()
    pulse = float(np.median(pulse_of(name.rpartition(".")[0], sets)))
    if not np.ptp(y) > max(_CONSTANT * np.abs(y).max(), plan.model.tolerance * pulse):
        return ()
    from SALib.analyze import sobol

    found = sobol.analyze(plan.problem, y, calc_second_order=False, seed=plan.seed + 1)  # SALib ignores a seed of 0
    columns = (found[key] for key in ("S1", "S1_conf", "ST", "ST_conf"))
    rows = zip(plan.varied, *columns, strict=True)
    return [Index(name, each.name, *map(float, numbers)) for each, *numbers in rows]


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
                f"{n} of the sets {'was' if n == 1 else 'were'} also run with half the step and half the element "
                f"length: the beats of P and Q differ by {number(largest, 2)} at most ({worst}; relative L2, P without "
                "its mean)."
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
