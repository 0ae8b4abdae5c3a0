"""The fitted wall of a site in a notebook: its parameters with their intervals, as HTML and as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from arterial_fmu.cli.tables.fits import SHOWN
from fitting.pages.figures import loop_figure
from fitting.pages.style import Picture
from fitting.records.alignment.beats import Beats
from fitting.wall.indices import E_inc
from fitting.wall.wall_fit import WallFit
from fitting.wall.wall_model import PARAMETERS, UNITS
from solver.network.description import Segment
from solver.quantities.legible import number, with_interval
from solver.quantities.quantity import quantities
from solver.quantities.units import printed

from .tables import table


def html(fitted: WallFit) -> str:
    """Every parameter in its display unit, measures of the quality of the fit, and its warnings."""
    rows = [_row(fitted, name) for name in PARAMETERS if name in fitted.model.free or fitted.values[name]]
    stiffness = E_inc(fitted)
    rows.insert(0, ("E_inc, MPa", *with_interval(stiffness.value, stiffness.ci95, 1e-6)))
    given = quantities(Segment)["h"]
    rows.append((f"h, {given.display}", number(1e3 * fitted.h, 4), "given"))
    quality = (
        f"φ0 R0/R {number(1e-3 * fitted.phi_1D, 4)} kPa·s; φ0/E {number(1e3 * fitted.relaxation_time[0], 4)} ms; "
        f"R² {fitted.r2:.6f}; χ²/dof {number(fitted.chi2 / fitted.dof)}; condition number {fitted.condition:.0f}"
    )
    of = f"{fitted.n_beats} beats of {number(fitted.loop.T, 4)} s, {Path(fitted.source).name}"
    title = f"Wall of {fitted.site}, model {fitted.model.name}, {fitted.model.elastic} law: {of}"
    return table(title, ("parameter", "value", "95 % interval"), rows, (quality, fitted.law, *fitted.warnings))


def columns(fitted: WallFit) -> Mapping[str, Sequence[Any]]:
    """The five parameters, h and eta; both ends of the interval equal the value if it was given."""
    units = {**UNITS, "h": "m", "eta": "1"}
    ends = [fitted.ci95(name) for name in units]
    return {
        "site": [fitted.site] * len(units),
        "parameter": list(units),
        "value": [float(fitted.values[name]) for name in units],
        "low": [low for low, _ in ends],
        "high": [high for _, high in ends],
        "unit": [printed(unit) for unit in units.values()],
        "free": [name in fitted.model.free for name in units],
    }


def figure(fitted: WallFit, beats: Beats | None = None) -> Picture:
    """The loop, measured and fitted, and the spectrum of the residual."""
    return loop_figure([fitted], beats)


def _row(fitted: WallFit, name: str) -> tuple[str, str, str]:
    label, factor = SHOWN[name]
    if name not in fitted.model.free:
        return label, number(factor * fitted.values[name], 5), "given"
    return label, *with_interval(fitted.values[name], fitted.ci95(name), factor)
