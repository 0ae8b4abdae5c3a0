"""A record judged by the whole catalogue: prepared and named."""

from __future__ import annotations

from collections.abc import Sequence

from discrepancy.find.study import Study, prepare
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.runs import Runs
from fitting.records.read.record import Record
from solver.network.description import Network


def judge(
    record: Record, network: Network, runs: Runs | None = None, among: Sequence[str] = ()
) -> tuple[Study, Naming]:
    """Find and name, without FMU or files: what the bank of hidden effects calls. Raises Unusable.

    among : names of effects, default all: every pair of a bench is refitted, and they grow with the square.
    """
    runs = runs or Runs()
    study = prepare(record, network, runs=runs)
    return study, name(study.problem, tuple(t for t in study.terms if not among or t.effect in among), runs)
