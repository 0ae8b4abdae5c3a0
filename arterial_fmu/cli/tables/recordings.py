"""The residual of a calibration in each recording, fitted or held out, and the values of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table

from arterial_fmu.cli.terminal.console import right
from fitting.calibrate.calibrated import Calibration
from fitting.calibrate.held_out import HeldOut
from fitting.results.parameter_set import quantity_of
from solver.quantities.legible import DASH, NOT_DETERMINED, number, shown_in, with_interval
from solver.quantities.units import of_signal


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
