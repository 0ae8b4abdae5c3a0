"""Classes of |z| and of separations, with colours that everyone tells apart: the same in figures and on the page."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

# Brewer's Blues, white first: light to dark also in grey and to colour-blind readers
_BLUES = ("#ffffff", "#deebf7", "#c6dbef", "#9ecae1", "#6baed6", "#3182bd", "#08519c")


@dataclass(frozen=True)
class Scale:
    """Classes of a number that is not negative: class i holds bounds[i] … bounds[i+1], the last all that is above."""

    name: str
    bounds: tuple[float, ...]
    colours: tuple[str, ...] = _BLUES

    def index(self, value: float) -> int:
        """The class of a value."""
        return max(bisect_right(self.bounds, value) - 1, 0)

    def colour(self, value: float) -> str:
        """The colour of a value."""
        return self.colours[self.index(value)]

    @property
    def texts(self) -> list[str]:
        """The classes in words."""
        between = [f"{low:g} – {high:g}" for low, high in zip(self.bounds[1:], self.bounds[2:], strict=False)]
        return [f"< {self.bounds[1]:g}", *between, f"> {self.bounds[-1]:g}"]


Z = Scale("|z|", (0.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0))
APART = Scale("separation d′", (0.0, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0))
