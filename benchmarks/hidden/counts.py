"""Proportions with their bounds, and Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from scipy.stats import beta

Each = TypeVar("Each")

NO_RECORDS = "no records"


@dataclass(frozen=True)
class Share:
    """``hits`` of ``n``."""

    hits: int
    n: int

    @property
    def value(self) -> float:
        return self.hits / self.n if self.n else float("nan")

    @property
    def bounds(self) -> tuple[float, float]:
        """95 % interval of Clopper and Pearson (Biometrika 26, 1934, 404)."""
        k, n = self.hits, self.n
        low = float(beta.ppf(0.025, k, n - k + 1)) if k > 0 else 0.0
        high = float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
        return low, high

    def __str__(self) -> str:
        if not self.n:
            return NO_RECORDS
        low, high = (100.0 * b for b in self.bounds)
        return f"{100.0 * self.value:.1f} % ({self.hits}/{self.n}; {low:.1f}–{high:.1f})"


def share(lines: Iterable[Each], test: Callable[[Each], bool]) -> Share:
    """The number that pass."""
    chosen = list(lines)
    return Share(sum(map(test, chosen)), len(chosen))


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]], left: int = 1) -> str:
    """A table; all columns but the first ``left`` are right-aligned."""
    marks = ["---" if i < left else "---:" for i in range(len(header))]
    body = [header, marks, *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in row) + " |" for row in body)
