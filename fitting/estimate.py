"""A number with its interval: what every fit, index and verdict hands on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from solver.legible import rounded
from solver.units import readable


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
        """The same with its interval in the range of what it is a number of."""
        below, above = (min(max(end, low), high) for end in self.ci95)
        return replace(self, ci95=(below, above))

    @property
    def plain(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {"value": self.value, "unit": self.unit, "ci95": list(self.ci95)}
