"""A record judged by the whole catalogue: prepared and named."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from discrepancy.find import study as studies
from discrepancy.find.study import Study, prepare
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.hypothesis import candidates
from fitting.inference.runs import Runs
from fitting.inference.unknown import Unknown
from fitting.records.read.record import Record
from fitting.results.estimate import Estimate
from solver.network.description import Network
from solver.quantities.coordinate import SCALE

if TYPE_CHECKING:
    import pytest


def judge(
    record: Record, network: Network, runs: Runs | None = None, among: Sequence[str] = ()
) -> tuple[Study, Naming]:
    """Find and name, without FMU or files: what the bank of hidden effects calls. Raises Unusable.

    among : names of effects, default all: every pair of a bench is refitted, and they grow with the square.
    """
    runs = runs or Runs()
    study = prepare(record, network, runs=runs)
    return study, name(study.problem, tuple(t for t in study.terms if not among or t.effect in among), runs)


def few(patch: pytest.MonkeyPatch, *among: str) -> None:
    """Studies search among these effects alone: for tests of what a study does with what it finds."""
    patch.setattr(studies, "candidates", lambda *given: tuple(t for t in candidates(*given) if t.effect in among))


def value_of(unknown: Unknown, x: float, sd: float = 0.0, quantile: float = 1.0) -> Estimate:
    """The value of an unknown with its interval in the unit that is reported, within its range."""
    ends = unknown.size * np.clip([x - quantile * sd, x, x + quantile * sd], unknown.low, unknown.high)
    low, value, high = map(float, unknown.nominal * np.exp(ends) if unknown.kind == SCALE else unknown.nominal + ends)
    return Estimate(value, unknown.unit, (low, high))
