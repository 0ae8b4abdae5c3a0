"""A record judged by the whole catalogue: prepared and named."""

from __future__ import annotations

from discrepancy.find.study import Study, prepare
from discrepancy.name.model_selection import name
from discrepancy.name.verdict import Naming
from fitting.inference.runs import Runs
from fitting.records.read.record import Record
from solver.network.description import Network


def judge(record: Record, network: Network, runs: Runs | None = None) -> tuple[Study, Naming]:
    """Find and name, without FMU or files: what the bank of hidden effects calls. Raises Unusable."""
    runs = runs or Runs()
    study = prepare(record, network, runs=runs)
    return study, name(study.problem, study.terms, runs)
