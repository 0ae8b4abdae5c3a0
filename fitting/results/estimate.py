"""A number with its interval: the result type of every fit, index and verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from scipy.optimize import brentq
from scipy.special import stdtr, stdtrit

from solver.quantities.legible import rounded
from solver.quantities.units import readable

_IMPROBABLE = 1e-6


@dataclass(frozen=True)
class Estimate:
    """A number in SI with its 95 % interval."""

    value: float
    unit: str
    ci95: tuple[float, float]

    def __str__(self) -> str:
        unit, factor = readable(self.unit)
        half = 0.5 * factor * (self.ci95[1] - self.ci95[0])
        value, low, high = (rounded(factor * x, half) for x in (self.value, *self.ci95))
        return f"{value} ({low} to {high}) {unit}".rstrip()

    def within(self, low: float, high: float) -> Estimate:
        """The same with its interval clipped to a range."""
        below, above = (min(max(end, low), high) for end in self.ci95)
        return replace(self, ci95=(below, above))

    @property
    def plain(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"value": self.value, "unit": self.unit, "ci95": list(self.ci95)}


def mixture(parts: Sequence[tuple[float, float, float, float]]) -> tuple[float, float]:
    """95 % interval of a mixture of Student's t: probability, centre, standard deviation, degrees of freedom of each.

    A component without width (standard deviation 0) or with probability below 1e-6 is merged into the first one.
    """
    first = parts[0]
    probable = [part for part in parts if part[0] > _IMPROBABLE and part[2] > 0.0] or [first]
    ends = [tuple(m + stdtrit(n, q) * sd for _, m, sd, n in probable) for q in (0.025, 0.975)]
    if len(probable) == 1:
        return float(ends[0][0]), float(ends[1][0])
    total = sum(p for p, *_ in probable)
    low, high = (
        brentq(lambda x, q=q: sum(p * stdtr(n, (x - m) / sd) for p, m, sd, n in probable) / total - q, min(e), max(e))
        for q, e in zip((0.025, 0.975), ends, strict=True)
    )
    return float(low), float(high)
