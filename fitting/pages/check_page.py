"""The page of a check: figures by matplotlib, text by Jinja2; one file that needs no network."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from solver.files import write_whole
from solver.units import of_signal, readable

from ..agreement import Agreement, LoopArea
from ..check import CheckReport
from ..result_files import make_folder
from .page import environment, words
from .panels import BAND, DASHED, MEASURED, SIMULATED, Drawing, by_place, drawing, legend, shown
from .style import STYLE


def write_check(report: CheckReport, directory: str | os.PathLike[str]) -> Path:
    """Write check.json, check.html and figures as PNG (waveforms, residuals, loops); returns the path of the page.

    Raises ValueError if the directory cannot be written.
    """
    folder = make_folder(directory)
    drawn = figures(report)
    write_whole(folder / "check.json", report.to_json())
    for name, figure in drawn.items():
        write_whole(folder / f"{name}.png", figure.png)
    write_whole(folder / "check.html", page(report, drawn))
    return folder / "check.html"


def figures(report: CheckReport) -> dict[str, Drawing]:
    """The figures of a report by file name: waveforms, residuals, and loops where P and R are compared."""
    with rc_context(STYLE):
        drawn = {"waveforms": _waveforms(report), "residuals": _residuals(report)}
        if report.loops:
            drawn["loops"] = _loops(report)
    return drawn


def page(report: CheckReport, drawings: Mapping[str, Drawing]) -> str:
    """The report as one HTML page with its figures inside."""
    template = environment(Path(__file__).parent / "templates").get_template("check.html.j2")
    return template.render(
        report=report,
        rows=[_row(channel) for channel in report.channels],
        loops=[_loop_row(loop) for loop in report.loops],
        drawings=drawings,
        worst=report.worst.name,
        provenance=_provenance(report.sources["parameter_set"]["provenance"]),
    )


# --- the table ----------------------------------------------------------------------------------------------------


def _row(channel: Agreement) -> dict[str, str]:
    unit, factor = of_signal(channel.name)
    harmonic = "" if channel.worst_z is None else f"{channel.worst_harmonic} ({channel.worst_z:.1f})"
    return {
        "name": channel.name,
        "unit": unit,
        "pulse": f"{channel.pulse * factor:.4g}",
        "rmse": f"{channel.rmse * factor:.2g}",
        "relative": f"{100 * channel.relative:.2g}",
        "largest": f"{100 * channel.largest:.2g}",
        "mean_error": _signed(channel.mean_error * factor),
        "mean_z": "" if channel.mean_z is None else _signed(channel.mean_z),
        "pulse_error": _signed(100 * channel.pulse_error / channel.pulse),
        "whitened": "–" if channel.whitened is None else f"{channel.whitened:.2f}",
        "whitened_sensor": "–" if channel.whitened_sensor is None else f"{channel.whitened_sensor:.2f}",
        "harmonic": harmonic or "–",
    }


def _loop_row(loop: LoopArea) -> dict[str, str]:
    _, factor = readable("J/m")
    change = _signed(100 * (loop.simulated / loop.measured - 1)) if loop.measured else "–"
    measured, simulated = (f"{factor * area:.4g}" for area in (loop.measured, loop.simulated))
    return {"site": loop.site, "measured": measured, "simulated": simulated, "change": change}


def _provenance(entries: Mapping[str, Any]) -> dict[str, str]:
    """Where the set comes from, in words; what is empty is left out."""
    return {f"set: {key.replace('_', ' ')}": words(value) for key, value in entries.items() if value not in ([], {})}


def _signed(value: float) -> str:
    return f"{value:+.2g}".replace("-", "−")


# --- figures ------------------------------------------------------------------------------------------------------


def _waveforms(report: CheckReport) -> Drawing:
    """What drove the FMU, then every channel: measured mean, ± 2 standard deviations between beats, FMU."""
    names = [report.driver, *(channel.name for channel in report.channels)]
    figure, panels = by_place(names)
    for name, panel in panels.items():
        waveform = report.waveforms[name]
        measured, simulated, scatter = shown(name, waveform.measured, waveform.simulated, waveform.scatter)
        time = np.linspace(0.0, report.T, len(measured))
        panel.fill_between(time, measured - 2 * scatter, measured + 2 * scatter, color=BAND, alpha=0.45, linewidth=0)
        panel.plot(time, measured, color=MEASURED)
        if name == report.driver:
            panel.set_title(f"{name} (drives the FMU)", loc="left")
        else:
            panel.plot(time, simulated, color=SIMULATED, linestyle=DASHED)
        panel.margins(x=0)
    legend(figure, ("measured", MEASURED, "-"), ("FMU", SIMULATED, DASHED), band="± 2 sd between beats")
    return drawing(figure, "Mean beats. The band is ± 2 standard deviations between the measured beats.")


def _residuals(report: CheckReport) -> Drawing:
    """FMU less measured mean beat, and ± 2 standard deviations of that mean."""
    figure, panels = by_place([channel.name for channel in report.channels])
    beats = float(report.run["beats_measured"])
    for name, panel in panels.items():
        waveform = report.waveforms[name]
        residual, scatter = shown(name, waveform.simulated - waveform.measured, waveform.scatter / np.sqrt(beats))
        time = np.linspace(0.0, report.T, len(residual))
        panel.fill_between(time, -2 * scatter, 2 * scatter, color=BAND, alpha=0.45, linewidth=0)
        panel.axhline(0.0, color=MEASURED, linewidth=0.6)
        panel.plot(time, residual, color=SIMULATED, linewidth=0.9)
        panel.margins(x=0)
    legend(figure, ("FMU less measured", SIMULATED, "-"), band="± 2 sd of the measured mean")
    return drawing(
        figure,
        f"FMU less measured mean beat. The band is ± 2 standard deviations of the measured mean by the channel's own "
        f"noise; that of {report.driver} comes on top.",
    )


def _loops(report: CheckReport) -> Drawing:
    """Pressure against radius of every site that has both."""
    columns = 4
    rows = -(-len(report.loops) // columns)
    figure = Figure(figsize=(2.7 * min(columns, max(2, len(report.loops))), 2.4 * rows + 0.4), layout="constrained")
    for i, loop in enumerate(report.loops):
        panel = figure.add_subplot(rows, min(columns, len(report.loops)), i + 1)
        P, R = report.waveforms[f"{loop.site}.P"], report.waveforms[f"{loop.site}.R"]
        p_measured, p_simulated = shown("P", P.measured, P.simulated)
        r_measured, r_simulated = shown("R", R.measured, R.simulated)
        panel.plot(r_measured, p_measured, color=MEASURED)
        panel.plot(r_simulated, p_simulated, color=SIMULATED, linestyle=DASHED)
        panel.set_title(loop.site, loc="left")
        panel.set_xlabel("radius [mm]")
        panel.set_ylabel("pressure [mmHg]")
    legend(figure, ("measured", MEASURED, "-"), ("FMU", SIMULATED, DASHED))
    return drawing(figure, "Pressure against radius, mean beats.")
