"""A law that was learned from a record, as a study keeps it: plain frozen data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fitting.results.estimate import Estimate
from solver.laws import effects
from solver.network.description import Network

from .recorded import pair_json


@dataclass(frozen=True)
class LearnedLaw:
    """A law with what it does to the gap.

    formula : of what it adds. parameters : with 95 % intervals. seen : by segment, lowest and highest strain [-] and
    highest strain rate [1/s] that it was learned from; of outlets P - P_venous [Pa] and its rate. beside : the effects
    that it acts beside, instead : those that it stands for, where they explain a part. before,
    after : the gap on (fitted, held-out) beats. record : path and hash. network, archive : with the law, and its FMU.
    explains : False of tables, which describe what acts.
    """

    name: str
    where: tuple[str, ...]
    formula: str
    parameters: Mapping[str, Estimate]
    seen: Mapping[str, tuple[float, float, float]]
    beside: tuple[str, ...]
    instead: tuple[str, ...]
    before: tuple[float, float]
    after: tuple[float, float]
    record: tuple[str, str]
    network: Network = field(repr=False)
    archive: bytes = field(repr=False)
    explains: bool = True

    @property
    def of_outlet(self) -> bool:
        """Whether it is one of outlets."""
        return effects.BY_NAME[self.name].owner == "outlet" if self.explains else False

    @property
    def closed(self) -> float:
        """The part of the gap to held-out beats that it closes."""
        return 1.0 - self.after[1] / self.before[1]


def law_json(law: LearnedLaw) -> dict[str, Any]:
    """The plain content of verdict.json."""
    state = "pressure" if law.of_outlet else "strain"
    return {
        "name": law.name,
        "explains": law.explains,
        "where": law.where,
        "formula": law.formula,
        "parameters": {name: each.plain for name, each in law.parameters.items()},
        "seen": {s: {state: [low, high], "rate": rate} for s, (low, high, rate) in law.seen.items()},
        "beside": law.beside,
        "instead": law.instead,
        "gap": {"before": pair_json(law.before), "after": pair_json(law.after)},
    }
