"""The page of a check: figures by matplotlib, text by Jinja2; one self-contained file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context

from solver.io.writing import write_folder
from solver.quantities.legible import DASH, endless, number, shown_in, signed, with_interval
from solver.quantities.units import of_signal, readable

from ..check.agreement import Agreement, LoopArea
from ..check.fmu_check import CheckReport
from ..results.estimate import Estimate
from ..results.parameter_set import quantity_of
from ..wall.indices import modulus
from .page import environment, in_words
from .panels import DASHED, MEASURED, SIMULATED, Curve, Drawing, drawing, loops, waveforms
from .style import STYLE

FILES = ("check.json", "waveforms.png", "residuals.png", "loops.png", "check.html")


def write_check(report: CheckReport, directory: str | os.PathLike[str]) -> Path:
    """Write check.json, check.html and figures as PNG (waveforms, residuals, loops); returns the path of the page.

    Raises ValueError if the directory cannot be written.
    """
    drawn = figures(report)
    files: dict[str, str | bytes] = {"check.json": report.to_json()}
    files |= {f"{name}.png": figure.png for name, figure in drawn.items()}
    files["check.html"] = page(report, drawn)
    return write_folder(directory, files, gone=set(FILES) - set(files))[-1]


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
    provenance, data = in_words(report.sources["parameter_set"]["provenance"])
    return template.render(
        report=report,
        rows=[_row(channel) for channel in report.channels],
        loops=[_loop_row(loop) for loop in report.loops],
        drawings=drawings,
        worst=report.worst.name,
        change=number(report.run["change"], 2),
        values=_value_rows(report.sources["parameter_set"]),
        stiffness=_stiffness(report.sources["parameter_set"]["provenance"]),
        provenance=provenance,
        data=data,
    )


# --- the table ----------------------------------------------------------------------------------------------------


def _row(channel: Agreement) -> dict[str, str]:
    unit, factor = of_signal(channel.name)
    harmonic = "" if channel.worst_z is None else f"{channel.worst_harmonic} ({channel.worst_z:.1f})"
    return {
        "name": channel.name,
        "unit": unit,
        "pulse": number(channel.pulse * factor, 4),
        "rmse": number(channel.rmse * factor, 2),
        "relative": number(100 * channel.relative, 2),
        "largest": number(100 * channel.largest, 2),
        "mean_error": signed(channel.mean_error * factor),
        "mean_z": DASH if channel.mean_z is None else signed(channel.mean_z),
        "pulse_error": signed(100 * channel.pulse_error / channel.pulse),
        "whitened": DASH if channel.whitened is None else f"{channel.whitened:.2f}",
        "whitened_sensor": DASH if channel.whitened_sensor is None else f"{channel.whitened_sensor:.2f}",
        "harmonic": harmonic or DASH,
    }


def _loop_row(loop: LoopArea) -> dict[str, str]:
    _, factor = readable("J/m")
    change = signed(100 * (loop.simulated / loop.measured - 1)) if loop.measured else DASH
    measured, simulated = (number(factor * area, 4) for area in (loop.measured, loop.simulated))
    return {"site": loop.site, "measured": measured, "simulated": simulated, "change": change}


def _value_rows(parameters: Mapping[str, Any]) -> list[dict[str, str]]:
    """The values of the parameter set, with intervals where they are informative."""
    weak, rows = set(parameters["provenance"].get("undetermined", ())), []
    for name, each in parameters["values"].items():
        unit, factor = shown_in(quantity_of(name))
        determined = name not in weak and not endless(each["value"], each["ci95"])
        value, ends = with_interval(each["value"], each["ci95"], factor, determined)
        rows.append({"name": name, "value": value, "interval": ends, "unit": unit})
    return rows


def _stiffness(provenance: Mapping[str, Any]) -> str:
    """E_inc of the set of one site, and its elastic law."""
    found = provenance.get("indices", {}).get("E_inc")
    if found is None:
        return ""
    law = provenance.get("elastic_law", {}).get("sentence")
    E_inc = modulus(Estimate(found["value"], found["unit"], tuple(found["ci95"])))
    return f"E_inc = {E_inc} at the mean pressure" + (f"; {law}" if law else "")


# --- figures ------------------------------------------------------------------------------------------------------


_CURVES: tuple[Curve, ...] = (("measured", MEASURED, "-"), ("FMU", SIMULATED, DASHED))


def _waveforms(report: CheckReport) -> Drawing:
    """The drive of the FMU, then every channel: measured mean, ± 2 standard deviations between beats, FMU."""
    names = [report.driver, *(channel.name for channel in report.channels)]
    waves = {name: report.waveforms[name] for name in names}
    beats = {name: (w.measured, None if name == report.driver else w.simulated) for name, w in waves.items()}
    scatter = {name: w.scatter for name, w in waves.items()}
    figure, panels = waveforms(report.T, beats, scatter, _CURVES, "± 2 sd between beats")
    panels[report.driver].set_title(f"{report.driver} (drives the FMU)", loc="left")
    return drawing(figure, "Mean beats. The band is ± 2 standard deviations between the measured beats.")


def _residuals(report: CheckReport) -> Drawing:
    """FMU minus measured mean beat, and ± 2 standard deviations of that mean."""
    waves = {channel.name: report.waveforms[channel.name] for channel in report.channels}
    residuals = {name: (np.zeros_like(w.measured), w.simulated - w.measured) for name, w in waves.items()}
    of_mean = {name: w.scatter / np.sqrt(float(report.run["beats_measured"])) for name, w in waves.items()}
    curves = (("", MEASURED, "-"), ("FMU less measured", SIMULATED, "-"))
    figure, _ = waveforms(report.T, residuals, of_mean, curves, "± 2 sd of the measured mean")
    return drawing(
        figure,
        f"FMU less measured mean beat. The band is ± 2 standard deviations of the measured mean by the channel's own "
        f"noise; that of {report.driver} comes on top.",
    )


def _loops(report: CheckReport) -> Drawing:
    """Pressure against radius of every site that has both."""
    pairs = {loop.site: [report.waveforms[f"{loop.site}.{kind}"] for kind in "PR"] for loop in report.loops}
    sites = {site: [(P.measured, R.measured), (P.simulated, R.simulated)] for site, (P, R) in pairs.items()}
    return drawing(loops(sites, _CURVES), "Pressure against radius, mean beats.")
