"""Calibration of the stated confidence: bins, calibration error, Brier score, and the reliability diagram."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from fitting.pages.style import BLACK, BLUE, STYLE, VERMILION, png

from . import words as w
from .counts import Share, markdown, share
from .words import Line

BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)
DRAWS = 20_000  # for intervals


def reliability(lines: Sequence[Line]) -> str:
    """Stated confidence against the success rate."""
    stated = named(lines)
    rows = []
    for own in binned(stated):
        low, high = min(x["confidence"] for x in own), max(x["confidence"] for x in own)
        rows.append((f"{low:.3f}–{high:.3f}", len(own), f"{_mean(own):.3f}", share(own, w.confident_right)))
    note = "Every record with a name, whatever is hidden; right: name and place of the first in the class."
    if stated:
        note += (
            f" Calibration error (mean distance of stated from right, weighted): {error_text(stated)}. "
            f"Brier score: {brier(stated):.3f}."
        )
    return f"{note}\n\n" + markdown(("confidence", "records", "mean stated", "right"), rows)


def named(lines: Sequence[Line]) -> list[Line]:
    """The lines that give a name with a confidence."""
    return [x for x in lines if w.claims(x)]


def binned(stated: Sequence[Line]) -> list[list[Line]]:
    """The lines by their confidence, without empty bins."""
    index = [min(int(np.searchsorted(BINS, x["confidence"], side="right")) - 1, len(BINS) - 2) for x in stated]
    bins = [[x for x, i in zip(stated, index, strict=True) if i == j] for j in range(len(BINS) - 1)]
    return [own for own in bins if own]


def calibration_error(stated: Sequence[Line]) -> float:
    """Expected calibration error: Σ n_b/n |mean confidence - share right| over the bins."""
    gaps = [len(own) * abs(_mean(own) - share(own, w.confident_right).value) for own in binned(stated)]
    return sum(gaps) / len(stated)


def error_bounds(stated: Sequence[Line]) -> tuple[float, float]:
    """95 % interval of the calibration error: the same sum over drawn shares, with a seed.

    A bin's share right is drawn from Beta(right + 1/2, wrong + 1/2), Jeffreys' posterior of its count (Brown, Cai and
    DasGupta, Stat. Sci. 16, 2001, 101). To draw the records again, as a bootstrap does, would leave a bin where all
    are right without any width. Few records show a large error whatever is stated, and the interval has that twice.
    """
    rng = np.random.default_rng(0)
    gaps = np.zeros(DRAWS)
    for own in binned(stated):
        right = share(own, w.confident_right)
        drawn = rng.beta(right.hits + 0.5, right.n - right.hits + 0.5, DRAWS)
        gaps += right.n * abs(_mean(own) - drawn)
    low, high = np.quantile(gaps / len(stated), (0.025, 0.975))
    return float(low), float(high)


def error_by_chance(stated: Sequence[Line]) -> tuple[float, float]:
    """Mean and 95 % quantile of the calibration error of as many records if every stated confidence were exact; with a
    seed."""
    rng, gaps = np.random.default_rng(0), np.zeros(DRAWS)
    for own in binned(stated):
        p = np.array([x["confidence"] for x in own])
        gaps += abs(p.sum() - (rng.random((DRAWS, len(p))) < p).sum(axis=1))
    return float(gaps.mean() / len(stated)), float(np.quantile(gaps, 0.95) / len(stated))


def error_text(stated: Sequence[Line]) -> str:
    """The calibration error with its interval, the number of records, and the error of exact confidences."""
    low, high = error_bounds(stated)
    mean, most = error_by_chance(stated)
    said = f"{calibration_error(stated):.3f} ({low:.3f}–{high:.3f}; {len(stated)})"
    return f"{said}; of exact confidences {mean:.3f}, 95 % ≤ {most:.3f}"


def brier(stated: Sequence[Line]) -> float:
    """Mean of (confidence - 1 if right, 0 if not)² (Brier, Mon. Weather Rev. 78, 1950, 1)."""
    return float(np.mean([(x["confidence"] - w.confident_right(x)) ** 2 for x in stated]))


def _mean(own: Sequence[Line]) -> float:
    return float(np.mean([x["confidence"] for x in own]))


def diagram(lines: Sequence[Line]) -> bytes:
    """The reliability diagram as PNG: share right against stated confidence, bench beside network, bars 95 %."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.2), layout="constrained")
        for ax, kind, colour in zip(figure.subplots(1, 2), ("bench", "network"), (BLUE, VERMILION), strict=True):
            stated = named([x for x in lines if x["kind"] == kind])
            ax.plot([0, 1], [0, 1], color=BLACK, linewidth=0.6, linestyle="--")
            for own in binned(stated):
                right = share(own, w.confident_right)
                ax.errorbar(_mean(own), right.value, _bars(right), fmt="o", color=colour, markersize=4, capsize=2)
                ax.annotate(f"{len(own)}", (_mean(own), right.value), (4, -9), textcoords="offset points", fontsize=7)
            what = f": error {calibration_error(stated):.3f}, Brier {brier(stated):.3f}" if stated else ""
            ax.set(title=f"{kind}{what}", xlabel="stated confidence", ylabel="share right", xlim=(0, 1), ylim=(0, 1.03))
        return png(figure)


def _bars(s: Share) -> list[list[float]]:
    low, high = s.bounds
    return [[s.value - low], [high - s.value]]
