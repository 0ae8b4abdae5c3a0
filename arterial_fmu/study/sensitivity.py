"""The findings of a study: first-order and total indices of every number, percentiles, and the accuracy of the steps.

First-order index S1: the share of a number's variance that one parameter explains alone; total index ST: including its
interactions with the others. Estimators and their bootstrap intervals by SALib (Saltelli et al. 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from solver.errors import InputError

from .batch import FAILED
from .plan import Array, Plan
from .store import GROUP

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
    indices = [index for name in plan.measures for index in _indices(plan, name, kept[name].to_numpy())]
    why = tuple(zip(failed["set"].to_list(), failed[FAILED].to_list(), strict=True))
    return Findings(tuple(indices), plan.base - len(lost), len(lost), percentiles, why)


def _indices(plan: Plan, name: str, y: Array) -> Sequence[Index]:
    """The indices of one number y : (groups (D + 2),); none if it does not vary, or there are too few groups."""
    if len(y) < _FEWEST * plan.group or not np.ptp(y) > _CONSTANT * np.abs(y).max():
        return ()
    from SALib.analyze import sobol

    found = sobol.analyze(plan.problem, y, calc_second_order=False, seed=plan.seed + 1)  # SALib ignores a seed of 0
    columns = (found[key] for key in ("S1", "S1_conf", "ST", "ST_conf"))
    rows = zip(plan.varied, *columns, strict=True)
    return [Index(name, each.name, *map(float, numbers)) for each, *numbers in rows]
