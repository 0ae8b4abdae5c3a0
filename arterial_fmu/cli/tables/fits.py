"""Tables of fits, and of calibrations with their recordings, on the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from arterial_fmu.cli.terminal.console import right
from fitting.calibrate.calibrated import Calibration
from fitting.calibrate.held_out import HeldOut
from fitting.results.estimate import Estimate
from fitting.results.parameter_set import quantity_of
from fitting.wall.indices import E_inc, modulus, read_in
from fitting.wall.wall_fit import WallFit
from fitting.wall.wall_model import PARAMETERS
from solver.network.description import Segment
from solver.quantities.legible import (
    DASH,
    NOT_DETERMINED,
    interval,
    number,
    plus_minus,
    rounded,
    shown_in,
    signed,
    with_interval,
)
from solver.quantities.quantity import quantities
from solver.quantities.units import MMHG, of_signal


def _shown(parameter: str) -> tuple[str, float]:
    """Label with the display unit, factor from SI."""
    unit, factor = shown_in(quantities(Segment)[parameter])
    return f"{parameter.replace('phi', 'φ')}, {unit}", factor


_HYPHENATED = {
    "distensibility": "disten-\nsibility",
    "compliance": "compli-\nance",
    "relaxation_time": "relax-\nation_time",
}

_FOUR_DIGITS = 0.01  # half of an interval by which a number is rounded to four digits: columns stay narrow
_ROUND_OFF = 1e-9  # of a value: it does not depend on what was fitted
_PHI = "φ0 goes with the strain rate dR/dt/R0; φ0 R0/R is φ of Γ = √π φ h/(2 (1 - η²)) in P_v = Γ/(A0 √A) dA/dt"

SHOWN = {parameter: _shown(parameter) for parameter in PARAMETERS}


def fits_table(fits: Sequence[WallFit], chosen: WallFit) -> Table:
    """E_inc and the parameters ± half the 95 % interval by the law of the column, one column per model."""
    models = [right(f"{f.model.name}\n{f.model.elastic}" + (" (kept)" if f is chosen else "")) for f in fits]
    title = f"Wall of {chosen.site}: {chosen.n_beats} beats of {number(chosen.loop.T, 4)} s, {chosen.source}"
    table = Table("± half the 95 % interval", *models, title=title, caption=_PHI)
    table.add_row("E_inc, MPa", *(_around(E_inc(f.alone), 1e-6) for f in fits))
    for name, (label, factor) in SHOWN.items():
        if any(name in f.model.free or f.values[name] for f in fits):
            table.add_row(label, *(_estimate(f, name, factor) for f in fits))
    table.add_row("φ0 R0/R, kPa·s", *(number(1e-3 * f.phi_1D, 4) for f in fits))
    table.add_row("φ0/E, ms", *(number(1e3 * f.relaxation_time[0], 4) for f in fits))
    if any(f.lag[0] for f in fits):
        table.add_row("lag of P, ms", *(plus_minus(1e3 * f.lag[0], 2e3 * f.lag[1]) for f in fits))
    table.add_row("R²", *(f"{f.r2:.6f}" for f in fits))
    table.add_row("χ²/dof", *(number(f.chi2 / f.dof) for f in fits))
    table.add_row("condition number", *(f"{f.condition:.0f}" for f in fits))
    table.add_row("γ, µm", *(number(1e6 * f.filtered.gamma) for f in fits))
    table.add_row("harmonics kept", *(f"{len(f.filtered.kept)}" for f in fits))
    return table


def headline(fitted: WallFit, E_inc: Estimate) -> str:
    """The modulus that does not depend on the law, with its interval; then the law and its lead."""
    P = fitted.loop.P.mean() / MMHG
    return f"{fitted.site}: E_inc = {modulus(E_inc)} at the mean pressure of {number(P, 4)} mmHg; {fitted.law}."


def sensitivity_table(fitted: WallFit, bootstrapped: Mapping[str, tuple[float, float]]) -> Table:
    """Interval and bootstrap; the effect of a time lag, and of ignoring the noise of R, on the value."""
    # in units of the interval, because a relative change is meaningless for a value near 0
    moved = ("moved by P\n1 ms late", "by ignoring\nnoise of R")
    law = fitted.model.elastic if fitted.evidence is None or fitted.evidence.decided else "either"
    columns = ("95 % interval", *(["bootstrap"] if bootstrapped else []), *moved)
    table = Table("", *map(right, columns), title=f"Uncertainty: {fitted.model.name} model of {fitted.site}, {law} law")
    for name in fitted.model.free:
        label, factor = SHOWN[name]
        row = [label, _ends(fitted.ci95(name), factor)]
        if bootstrapped:
            row.append(_ends(bootstrapped[name], factor))
        lag = factor * fitted.by_lag[name] * fitted.values[name] if name in fitted.by_lag else None
        bias = factor * (fitted.ignored_noise[name] - fitted.values[name])
        row += [DASH if lag is None else signed(lag), signed(bias)]
        table.add_row(*row)
    return table


def indices_table(site: str, indices: Mapping[str, Estimate]) -> Table:
    """The physiological indices of a site."""
    columns = ("index", right("value"), right("95 % interval"), "unit")
    table = Table(*columns, title=f"{site} at the mean pressure of the beat")
    for name, estimate in indices.items():
        unit, factor = read_in(estimate.unit)
        table.add_row(name.replace("_", " "), *with_interval(estimate.value, estimate.ci95, factor), unit)
    return table


def network_indices_table(network: str, sites: Mapping[str, Mapping[str, Estimate]]) -> Table:
    """The indices of :func:`~fitting.calibrate.network_indices.network_indices`, one line per site: ± half the 95 %
    interval."""
    units = {name: read_in(estimate.unit) for found in sites.values() for name, estimate in found.items()}
    columns = [right(_HYPHENATED.get(name, name).replace("_", "\n") + (f"\n{unit}" if unit else ""))
               for name, (unit, _) in units.items()]  # fmt: skip
    title = f"Calibrated network '{network}', at the mean radius of the sites (± half the 95 % interval)"
    table = Table("site", *columns, title=title, padding=0)  # eight indices fit 80 columns
    for site, found in sites.items():
        table.add_row(site, *(_plus_minus(found.get(name), factor) for name, (_, factor) in units.items()))
    return table


def calibration_table(result: Calibration) -> Table:
    """Every fitted value with its interval, in its display unit."""
    title = f"Calibrated network '{result.network}': χ²/dof {number(result.chi2 / result.dof)}"
    table = Table("parameter", right("value"), right("95 % interval"), "unit", title=title)
    for name, value in result.values.items():
        unit, factor = shown_in(quantity_of(name))
        determined = name not in result.undetermined
        table.add_row(name, *with_interval(value, result.ci95[name], factor, determined), unit)
    return table


def _estimate(fitted: WallFit, name: str, factor: float) -> str:
    value = factor * fitted.values[name]
    if name not in fitted.model.free:
        return f"{number(value, 5)} (given)" if fitted.values[name] else DASH
    return plus_minus(value, factor * fitted.half(name))


def _ends(ends: tuple[float, float], factor: float) -> str:
    return interval(factor * ends[0], factor * ends[1])


def _around(estimate: Estimate, factor: float) -> str:
    low, high = estimate.ci95
    return plus_minus(factor * estimate.value, factor * (high - low) / 2.0)


def _plus_minus(estimate: Estimate | None, factor: float) -> str:
    if estimate is None:
        return DASH
    low, high = estimate.ci95
    value, half = factor * estimate.value, factor * (high - low) / 2.0
    mean = rounded(value, max(half, _FOUR_DIGITS * abs(value)))
    return f"{mean}\n(given)" if half < _ROUND_OFF * abs(value) else f"{mean}\n±{number(half, 2)}"


# --- the recordings of a calibration --------------------------------------------------------------------------------


def recordings_table(result: Calibration, held_out: Sequence[HeldOut] = ()) -> Table:
    """One line per recording: χ²/dof, the RMS residual over the beat by channel, and its own values."""
    channels = list(dict.fromkeys(name for each in result.recordings for name in each.rms))
    own = list(dict.fromkeys(name for each in result.recordings for name in each.values))
    columns = [right(f"{name}\n{of_signal(name)[0]}") for name in channels]
    columns += [right(f"{name}\n{shown_in(quantity_of(name))[0]}") for name in own]
    table = Table("recording", right("χ²/dof"), *columns, title="RMS residual over the beat")

    def row(label: str, ratio: str, rms: Mapping[str, float], values: Sequence[str]) -> None:
        table.add_row(label, ratio, *(_signal(name, rms) for name in channels), *values)

    for i, each in enumerate(result.recordings):
        weak = result.of(i).undetermined
        values = [NOT_DETERMINED if n in weak else _value(n, each.values, each.ci95) for n in own]
        row(each.label, number(each.chi2 / each.dof), each.rms, values)
    for fold in held_out:
        label = Path(fold.source).stem
        row(f"{label}, not fitted", DASH, fold.rms, [DASH] * len(own))
        if fold.refitted:
            row("  varying values fitted", DASH, fold.refitted, [_value(n, fold.values) for n in own])
    return table


def _signal(name: str, rms: Mapping[str, float]) -> str:
    return number(of_signal(name)[1] * rms[name]) if name in rms else DASH


def _value(name: str, values: Mapping[str, float], ci95: Mapping[str, tuple[float, float]] | None = None) -> str:
    return with_interval(values[name], ci95[name] if ci95 else None, shown_in(quantity_of(name))[1])[0]
