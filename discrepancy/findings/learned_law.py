"""A law learned from a record, as a study stores it: plain frozen data."""

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
    """A learned law with its effect on the gap.

    formula : of the added term. parameters : with 95 % intervals. seen : range of the data, by segment: lowest and
    highest strain [-] and highest strain rate [1/s]; for outlets P - P_venous [Pa] and its rate. beside : effects that
    act with it, instead : effects of a partial verdict that it replaces. before, after : the gap on (fitted, held-out)
    beats. record : path and hash. network, archive : with the law, and its FMU. explains : False for tables, which only
    describe a source.
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
        """True if it is a law of outlets."""
        return effects.BY_NAME[self.name].owner == "outlet" if self.explains else False

    @property
    def closed(self) -> float:
        """The fraction of the gap to held-out beats that it closes."""
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
