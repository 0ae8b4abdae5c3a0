"""A table of targets against measurements: met, missed, or open if the bound is on the wrong side."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np
from scipy.stats import binom

from . import words as w
from .calibration import calibration_error, error_bounds, error_text, named
from .counts import NO_RECORDS, Share, markdown, share
from .tables import SEPARABLE
from .words import Line

_SAID = {True: "yes", False: "**no**", None: "–"}


class Targets:
    """Rows of the table, one after the other."""

    def __init__(self) -> None:
        self._rows: list[tuple[str, str, str, str]] = []

    def add(self, what: str, target: str, measured: object, met: bool | str | None = None) -> None:
        """A row; met : true, false, "open", or None where there is no target or no record."""
        self._rows.append((what, target, str(measured), met if isinstance(met, str) else _SAID[met]))

    def at_least(self, what: str, least: float, s: Share) -> None:
        """A share that should be large."""
        self.add(what, f"≥ {100 * least:g} %", s, _met(s.value >= least, s.bounds[0] >= least) if s.n else None)

    def at_most(self, what: str, most: float, s: Share) -> None:
        """A share that should be small."""
        self.add(what, f"≤ {100 * most:g} %", s, _met(s.value <= most, s.bounds[1] <= most) if s.n else None)

    def between(self, what: str, least: float, most: float, s: Share) -> None:
        """A share that should be neither small nor large."""
        low, high = s.bounds
        met = _met(least <= s.value <= most, least <= low and high <= most) if s.n else None
        self.add(what, f"{100 * least:g}–{100 * most:g} %", s, met)

    def every(self, what: str, s: Share) -> None:
        """A requirement without exception, which no number of records can prove."""
        self.add(what, "all", s, _met(s.hits == s.n, False) if s.n else None)

    def none(self, what: str, s: Share) -> None:
        """An event that must not occur."""
        self.add(what, "none", s, _met(s.hits == 0, False) if s.n else None)

    def median_at_most(self, what: str, most: float, values: Sequence[float]) -> None:
        """Numbers whose median should be small; its bounds are order statistics."""
        if values:
            low, high = median_bounds(values)
            middle = median(values)
            bounds = f" ({low:.2f}–{high:.2f})" if np.isfinite(low) else ""
            text = f"median {middle:.2f}{bounds}, 90 % {np.quantile(values, 0.9):.2f}; {len(values)}"
            self.add(what, f"≤ {most:g}", text, _met(middle <= most, high <= most))

    def confidence(self, what: str, lines: Sequence[Line]) -> None:
        """The calibration error of the confidence."""
        stated = named(lines)
        if stated:
            met = _met(calibration_error(stated) <= 0.05, error_bounds(stated)[1] <= 0.05)
            self.add(f"{what}, calibration error of the confidence", "≤ 0.05", error_text(stated), met)

    def parameters(self, what: str, lines: Sequence[Line]) -> None:
        """Errors and intervals of the parameters of effects with a single correct name at the correct place."""
        found = [e for x in lines if w.hides(x) == "single" and w.right_place(x) and w.single(x) for e in w.errors(x)]
        if found:
            relative = [error / size for _, size, error, _ in found if size]
            self._bias(f"{what}, parameter: median relative error", 0.1, relative)
            self.covered(f"{what}, parameter: 95 % interval covers", [e[3] for e in found])

    def _bias(self, what: str, most: float, relative: Sequence[float]) -> None:
        """Relative errors of either sign whose median should be small."""
        if relative:
            middle, (low, high) = median(relative), median_bounds(relative)
            bounds = f"{100 * low:+.2f} to {100 * high:+.2f}; " if np.isfinite(low) else ""
            met = _met(abs(middle) <= most, -most <= low and high <= most)
            self.add(what, f"≤ {100 * most:g} %", f"{100 * middle:+.2f} % ({bounds}{len(relative)})", met)

    def covered(self, what: str, holds: Sequence[bool]) -> None:
        """The number of 95 % intervals that contain the truth."""
        self.between(what, 0.9, 0.98, Share(sum(holds), len(holds)))

    def outside(self, what: str, lines: Sequence[Line]) -> None:
        """Effects outside the catalogue: a name without the note that more remains is wrong."""
        said = "named without the note that more remains"
        self.at_most(f"{what}, outside the catalogue: {said}", 0.05, share(w.of(lines, "outside"), w.committed))
        self.at_most("– of these with d′ ≥ 30", 0.05, share(w.of(lines, "outside", 30.0), w.committed))
        apart = [x for x in w.of(lines, "outside") if w.separation(x) >= SEPARABLE]
        self.at_most(f"– of these with separation ≥ {SEPARABLE:g}", 0.05, share(apart, w.committed))

    def seconds(self, what: str, most: float, longest: float, lines: Sequence[Line]) -> None:
        """CPU time of a diagnosis in one process: nearly all within ``most``, none above ``longest`` [s]."""
        s = [x["seconds"] for x in lines if "seconds" in x]
        if s:
            text = f"median {median(s):.2g}, 95 % {np.quantile(s, 0.95):.2g}, largest {max(s):.4g} s; {len(s)}"
            self.add(f"{what}, CPU time of find and name, one process", "–", text)
            self.at_least(f"– at most {most:g} s", 0.95, Share(sum(each <= most for each in s), len(s)))
            self.none(f"– more than {longest:g} s", Share(sum(each > longest for each in s), len(s)))

    def __str__(self) -> str:
        rows = [row for row in self._rows if row[2] != NO_RECORDS]
        return markdown(("quantity", "target", "measured (95 % bounds)", "met"), rows, left=2)


def _met(value: bool, bound: bool) -> bool | str:
    return value if value == bound or not value else "open"


def median_bounds(values: Sequence[float]) -> tuple[float, float]:
    """95 % interval of the median, between two of the values; infinite for fewer than six."""
    x = sorted(values)
    k = int(binom.ppf(0.025, len(x), 0.5))
    return (x[k - 1], x[-k]) if k > 0 else (-float("inf"), float("inf"))


def gaps(lines: Sequence[Line], least: float = 0.0) -> list[dict[str, float]]:
    """Whitened RMS of held-out beats of what was named right, where ``least`` was left by the refitted model."""
    found = [x["gap"]["held_out"] for x in lines if w.hides(x) == "single" and w.named_right(x)]
    return [g for g in found if g.get("refitted", 0.0) >= least and "best" in g]
