"""Figures of a cohort, as in the paper: R0 against measured, E and φ0, relaxation time, nonlinear viscosity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ..pages.style import BLACK, BLUE, GREEN, ORANGE, SKY, STYLE, VERMILION
from .claims import Claim
from .fits import Cohort

_FEWEST = 4  # minimum width of an axis, in sites


def cohort_figures(cohort: Cohort) -> dict[str, Figure]:
    """The figures by name: unstressed_radius, stiffness_and_viscosity, relaxation_time, nonlinear_viscosity.

    Dots are animals (or subjects). The last figure is missing if the main model is linear.
    """
    claims = {claim.name: claim for claim in cohort.claims()}
    with rc_context(STYLE):
        figures = {
            "unstressed_radius": _radius(cohort, claims.get("unstressed radius")),
            "stiffness_and_viscosity": _stiffness(cohort),
            "relaxation_time": _relaxation(cohort, claims.get("relaxation time")),
        }
        if "nonlinear viscosity" in claims:
            figures["nonlinear_viscosity"] = _bend(cohort, claims["nonlinear viscosity"])
    return figures


def _radius(cohort: Cohort, claim: Claim | None) -> Figure:
    """Fitted bars and measured crosses; beside them, where R0 was measured, the error on a scale that shows it."""
    title = "Unstressed radius" + (f": fitted as measured? {claim.verdict}" if claim else "")
    figure, axes = _figure(cohort, title, 2 if claim else 1)
    _bars(axes[0], cohort, "R0", 1e3, SKY, "fitted, mean ± sd")
    axes[0].set_ylabel("$R_0$, mm")
    if claim and claim.allowed:
        rows = cohort.table()
        means = [1e3 * rows[estimate.label]["R0 measured"].mean for estimate in claim.estimates]
        style: dict[str, Any] = {"color": BLACK, "markersize": 8, "markeredgewidth": 1.5, "zorder": 4}
        axes[0].plot(_places(cohort, claim), means, "x", label="measured, mean", **style)
        ends = [(100 * (e.low - 1.0), 100 * (e.high - 1.0)) for e in claim.estimates]
        low, high = (100 * (end - 1.0) for end in claim.allowed)
        _margin(axes[1], low, 0.0, high, f"±{100 * (claim.margin or 0):.0f} %")
        axes[1].vlines(_places(cohort, claim), *zip(*ends, strict=True), color=VERMILION, linewidth=3.0)
        errors = [100 * (estimate.value - 1.0) for estimate in claim.estimates]
        axes[1].plot(_places(cohort, claim), errors, "o", color=VERMILION, label="mean and 90 % interval")
        axes[1].set_ylabel("fitted less measured $R_0$, %")
    for ax in axes:
        _legend(ax)
    return figure


def _stiffness(cohort: Cohort) -> Figure:
    figure, axes = _figure(cohort, "Stiffness and viscosity", 2)
    bars = (
        ("E_inc", 1e-6, ORANGE, "incremental modulus $E_{inc}$, MPa"),
        ("phi0", 1e-3, GREEN, r"viscosity $\phi_0$, kPa·s"),
    )
    for ax, (quantity, factor, colour, label) in zip(axes, bars, strict=True):
        _bars(ax, cohort, quantity, factor, colour, "mean ± sd")
        ax.set_ylabel(label)
        _dots(ax, cohort, quantity, factor)
        _legend(ax)
    return figure


def _relaxation(cohort: Cohort, claim: Claim | None) -> Figure:
    """Site means with standard deviations; the margin about the mean over sites, and the tested intervals."""
    title = "Relaxation time" + (f": the same at all sites? {claim.verdict}" if claim else "")
    figure, (ax,) = _figure(cohort, title, 1)
    _dots(ax, cohort, "phi0/E", 1e3)
    style: dict[str, Any] = {"color": BLACK, "markersize": 6, "capsize": 4, "linewidth": 1.2}
    ax.errorbar(*_summaries(cohort, "phi0/E", 1e3), fmt="o", label="mean ± sd", **style)
    if claim and claim.allowed is not None and "mean" in claim.numbers:
        mean = 1e3 * claim.numbers["mean"]
        low, high = (mean * end for end in claim.allowed)
        _margin(ax, low, mean, high, f"±{100 * (claim.margin or 0.0):.0f} % of the mean over sites")
        places = _places(cohort, claim) + 0.22
        ends = [(mean * estimate.low, mean * estimate.high) for estimate in claim.estimates]
        ax.vlines(places, *zip(*ends, strict=True), color=VERMILION, linewidth=3.0, label="90 % interval of the site")
    ax.set_ylim(0.0, 1.06 * ax.get_ylim()[1])
    ax.set_ylabel(r"relaxation time $\phi_0/E$, ms")
    _legend(ax)
    return figure


def _bend(cohort: Cohort, claim: Claim) -> Figure:
    figure, (ax,) = _figure(cohort, "Nonlinear viscosity", 1)
    _dots(ax, cohort, "phiNL/phi0", 1.0)
    ax.axhline(0.0, color=BLACK, linewidth=0.6)
    places = _places(cohort, claim)
    values = np.array([estimate.value for estimate in claim.estimates])
    differ = np.array([estimate.p is not None and estimate.p < 0.05 for estimate in claim.estimates])
    ends = [(estimate.low, estimate.high) for estimate in claim.estimates]
    ax.vlines(places, *zip(*ends, strict=True), color=BLUE, linewidth=2.5, label="95 % interval of the mean")
    for which, face, text in ((differ, BLUE, "differs from 0 (Holm, 5 %)"), (~differ, "white", "not shown to differ")):
        if which.any():
            ax.plot(places[which], values[which], "o", color=BLUE, markerfacecolor=face, markersize=7, label=text)
    ax.set_ylabel(r"$\phi_{NL}/\phi_0$, s")
    _legend(ax)
    return figure


# --- parts --------------------------------------------------------------------------------------------------------


def _figure(cohort: Cohort, title: str, n: int) -> tuple[Figure, Sequence[Axes]]:
    figure = Figure(figsize=(5.2 * n, 3.8), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.06))
    axes = list(figure.subplots(1, n, squeeze=False)[0])
    figure.suptitle(f"{title}\n{cohort.label}; {cohort.main} model, {cohort.elastic} law", fontsize=10)
    for ax in axes:
        ax.set_xticks(range(len(cohort.sites)), cohort.sites)
        beside = 0.5 * max(0, _FEWEST - len(cohort.sites))  # bars keep their width
        ax.set_xlim(-0.6 - beside, len(cohort.sites) - 0.4 + beside)
        ax.set_xlabel("artery")
    return figure, axes


def _places(cohort: Cohort, claim: Claim) -> np.ndarray:
    """The positions of the estimates' sites on the axis."""
    return np.array([cohort.sites.index(estimate.label) for estimate in claim.estimates])


def _summaries(cohort: Cohort, quantity: str, factor: float) -> tuple[list[int], list[float], list[float]]:
    """Places, means and standard deviations; 0 for that of a single animal."""
    rows = [(i, row[quantity]) for i, row in enumerate(cohort.table().values()) if quantity in row]
    return (
        [i for i, _ in rows],
        [factor * summary.mean for _, summary in rows],
        [factor * summary.sd if summary.n > 1 else 0.0 for _, summary in rows],
    )


def _bars(ax: Axes, cohort: Cohort, quantity: str, factor: float, colour: str, label: str) -> None:
    places, means, sds = _summaries(cohort, quantity, factor)
    ax.bar(places, means, width=0.65, color=colour, yerr=sds, capsize=4, error_kw={"linewidth": 1.2}, label=label)


def _margin(ax: Axes, low: float, middle: float, high: float, label: str) -> None:
    """The allowed range for the estimates of a claim."""
    ax.axhspan(low, high, color=SKY, alpha=0.25, linewidth=0, label=label)
    ax.axhline(middle, color=SKY, linewidth=1.0)


def _dots(ax: Axes, cohort: Cohort, quantity: str, factor: float) -> None:
    """One dot per animal, a little to the left, each animal always at the same offset."""
    cells = cohort.values(quantity)
    offsets = {animal: -0.3 + 0.16 * i / max(1, len(cohort.animals) - 1) for i, animal in enumerate(cohort.animals)}
    x = [cohort.sites.index(site) + offsets[animal] for animal, site in cells]
    y = [factor * value for value in cells.values()]
    style: dict[str, Any] = {"color": "0.25", "markersize": 4.5, "markeredgecolor": "white", "markeredgewidth": 0.5}
    ax.plot(x, y, "o", label=f"{cohort.noun}s", zorder=3, **style)


def _legend(ax: Axes) -> None:
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)
