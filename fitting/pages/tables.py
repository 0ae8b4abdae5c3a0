"""What the command line prints: rich tables of fits and calibrations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from rich.table import Table

from solver.console import right
from solver.network import Segment
from solver.quantity import quantities
from solver.units import printed, readable

from ..calibrate import Calibration
from ..estimate import Estimate, decimals
from ..indices import read_in
from ..parameter_set import unit_of
from ..wall_fit import WallFit
from ..wall_model import PARAMETERS


def _shown(parameter: str) -> tuple[str, float]:
    """Label with the unit that people read, factor from SI."""
    quantity = quantities(Segment)[parameter]
    unit, factor = readable(quantity.unit, quantity.display)
    return f"{parameter.replace('phi', 'φ')}, {unit}", factor


_HYPHENATED = {
    "distensibility": "disten-\nsibility",
    "compliance": "compli-\nance",
    "relaxation_time": "relax-\nation_time",
}

SHOWN = {parameter: _shown(parameter) for parameter in PARAMETERS}


def fits_table(fits: Sequence[WallFit], chosen: WallFit) -> Table:
    """Parameters ± half the 95 % interval, one column a model."""
    models = [right(fitted.model.name + (" (kept)" if fitted is chosen else "")) for fitted in fits]
    title = f"Wall of {chosen.site}: {chosen.n_beats} beats of {chosen.loop.T:.5g} s, {chosen.source}"
    table = Table("± half the 95 % interval", *models, title=title)
    for name, (label, factor) in SHOWN.items():
        if any(name in f.model.free or f.values[name] for f in fits):
            table.add_row(label, *(_estimate(f, name, factor) for f in fits))
    table.add_row("φ0/E, ms", *(f"{1e3 * f.relaxation_time[0]:.4g}" for f in fits))
    if any(f.lag[0] for f in fits):
        table.add_row("lag of P, ms", *(f"{1e3 * f.lag[0]:.3g} ± {2e3 * f.lag[1]:.2g}" for f in fits))
    table.add_row("R²", *(f"{f.r2:.6f}" for f in fits))
    table.add_row("χ²/dof", *(f"{f.chi2 / f.dof:.3g}" for f in fits))
    table.add_row("condition number", *(f"{f.condition:.0f}" for f in fits))
    table.add_row("γ, µm", *(f"{1e6 * f.filtered.gamma:.3g}" for f in fits))
    table.add_row("harmonics kept", *(f"{len(f.filtered.kept)}" for f in fits))
    return table


def sensitivity_table(fitted: WallFit, bootstrapped: Mapping[str, tuple[float, float]]) -> Table:
    """Interval and bootstrap; how a time lag, or ignoring the noise of R, would move the value."""
    # in units of the interval: a relative change says nothing of a value near 0
    moved = ("moved by P\n1 ms late", "by ignoring\nnoise of R")
    columns = ("95 % interval", *(["bootstrap"] if bootstrapped else []), *moved)
    table = Table("", *map(right, columns), title=f"How sure: {fitted.model.name} model of {fitted.site}")
    for name in fitted.model.free:
        label, factor = SHOWN[name]
        row = [label, interval(fitted.ci95(name), factor)]
        if bootstrapped:
            row.append(interval(bootstrapped[name], factor))
        lag = factor * fitted.by_lag[name] * fitted.values[name] if name in fitted.by_lag else None
        bias = factor * (fitted.ignored_noise[name] - fitted.values[name])
        row += ["–" if lag is None else f"{lag:+.2g}", f"{bias:+.2g}"]
        table.add_row(*row)
    return table


def indices_table(site: str, indices: Mapping[str, Estimate]) -> Table:
    """What a physiologist reads."""
    columns = ("index", right("value"), right("95 % interval"), "unit")
    table = Table(*columns, title=f"{site} at the mean pressure of the beat")
    for name, estimate in indices.items():
        unit, factor = read_in(estimate.unit)
        table.add_row(name.replace("_", " "), f"{factor * estimate.value:.4g}", interval(estimate.ci95, factor), unit)
    return table


def network_indices_table(network: str, sites: Mapping[str, Mapping[str, Estimate]]) -> Table:
    """The indices of :func:`~fitting.network_indices.network_indices`, a line a site: ± half the 95 % interval."""
    units = {name: read_in(estimate.unit) for found in sites.values() for name, estimate in found.items()}
    columns = [right(_HYPHENATED.get(name, name).replace("_", "\n") + (f"\n{unit}" if unit else ""))
               for name, (unit, _) in units.items()]  # fmt: skip
    title = f"{network} calibrated, at the mean radius of the sites (± half the 95 % interval)"
    table = Table("site", *columns, title=title, padding=0)  # eight indices fit 80 columns
    for site, found in sites.items():
        table.add_row(site, *(_plus_minus(found.get(name), factor) for name, (_, factor) in units.items()))
    return table


def calibration_table(result: Calibration) -> Table:
    """Every value that moved, with its interval and unit, in SI."""
    title = f"{result.network} calibrated: χ²/dof {result.chi2 / result.dof:.3g}"
    table = Table("parameter", right("value"), right("95 % interval"), "unit", title=title)
    for name, value in result.values.items():
        table.add_row(name, f"{value:.5g}", interval(result.ci95[name], 1.0), printed(unit_of(name)))
    return table


def _estimate(fitted: WallFit, name: str, factor: float) -> str:
    value = factor * fitted.values[name]
    if name not in fitted.model.free:
        return f"{value:.5g} (given)" if fitted.values[name] else "–"
    half = factor * (fitted.ci95(name)[1] - fitted.ci95(name)[0]) / 2.0
    return f"{rounded(value, half)} ± {rounded(half, half)}"


def rounded(value: float, half: float) -> str:
    """The value to the digits that an interval of ± ``half`` leaves: two of the half."""
    if not (math.isfinite(half) and half > 0.0):
        return f"{value:.5g}"
    return f"{value:.{min(8, max(0, decimals(half)))}f}"


def interval(ends: tuple[float, float] | None, factor: float) -> str:
    if ends is None:
        return "–"
    low, high = factor * ends[0], factor * ends[1]
    return f"{rounded(low, (high - low) / 2.0)} … {rounded(high, (high - low) / 2.0)}"


def _plus_minus(estimate: Estimate | None, factor: float) -> str:
    if estimate is None:
        return "–"
    low, high = estimate.ci95
    return f"{factor * estimate.value:.4g}\n±{factor * (high - low) / 2.0:.2g}"
