"""The paper's figure, from an FMU: flow and pressure in the sheep network, elastic against viscoelastic walls.

    python examples/demo.py [--out dist]

Builds ``sheep.fmu``, runs it twice through FMPy with the paper's half-sine as ``inlet.Q``, draws the last beat, and
prints the peaks and what the wall viscosity does to each harmonic of the flow in the carotid artery.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from arterial_fmu.cli.terminal.console import sentences
from arterial_fmu.cli.terminal.progress import bar
from build_fmu import build
from fmu_src.importer.run import FMUError, run_fmu
from solver import Network, load
from solver.io.writing import write_whole
from solver.quantities.units import MMHG

Array = np.ndarray

BEATS = 6
STEP = 1e-3  # s, communication step
REPEATS = 1e-3  # largest relative change between the last two beats of a usable run
SMALLEST = 1e-2  # of the largest harmonic: weaker ones are not listed
SITES = {"MD": "medial descending aorta", "CA": "carotid artery"}
# vermilion and blue of Okabe and Ito, which colour-blind readers can distinguish
STYLES = {
    "elastic": {"color": "#D55E00", "linewidth": 1.4},
    "viscoelastic": {"color": "#0072B2", "linewidth": 2.0},
}


@dataclass(frozen=True)
class Run:
    """One run of the FMU.

    stop_time [s], seconds it took [s]. time : (n + 1,) [s], both ends of the last beat, from 0. beat : (n + 1,) per
    output in SI, by FMU variable name. change : relative L2 difference of that beat from the one before.
    """

    stop_time: float
    seconds: float
    time: Array
    beat: Mapping[str, Array]
    change: float


def run(
    fmu: Path, network: Network, start_values: Mapping[str, float], progress: Callable[[float], None] | None = None
) -> Run:
    """Run the FMU for BEATS beats of the network's inflow; ``start_values`` in SI, by FMU variable name.

    Raises FMUError if the FMU fails, ValueError for an unknown name or if the last beat does not repeat.
    """
    began = time.perf_counter()
    period = network.inlet.T
    result = run_fmu(fmu, network.inlet.Q, BEATS * period, step=STEP, start_values=start_values, progress=progress)
    n = round(period / STEP)
    names = [f"{site}.{kind}" for site in SITES for kind in "PQ"]
    change = max(_change(result[name][-n - 1 :], result[name][-2 * n - 1 : -n]) for name in names)
    if not change <= REPEATS:
        raise ValueError(f"{fmu}: beat {BEATS} still differs by {change:.1g} from the one before; run more beats.")
    beat = {name: values[-n - 1 :] for name, values in result.items() if name != "time"}
    return Run(result["time"][-1], time.perf_counter() - began, np.arange(n + 1) * STEP, beat, change)


def _change(beat: Array, before: Array) -> float:
    return float(np.linalg.norm(beat - before) / np.linalg.norm(beat))


def harmonics(beat: Array) -> Array:
    """Amplitudes of the harmonics of a beat : (n + 1,), both ends included; [k] belongs to k cycles a beat, k >= 1."""
    n = len(beat) - 1
    return 2.0 * np.abs(np.fft.rfft(beat[:-1])) / n


# --- what is shown ------------------------------------------------------------------------------------------------


def draw(runs: Mapping[str, Run]) -> Figure:
    """Flow (top) and pressure (bottom) at the two sites of the paper's figure, one line per kind of wall."""
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    flows, pressures = figure.subplots(2, len(SITES), sharex=True)
    for (site, artery), flow, pressure in zip(SITES.items(), flows, pressures, strict=True):
        for walls, result in runs.items():
            style = {"label": f"{walls} walls", **STYLES[walls]}
            flow.plot(result.time, result.beat[f"{site}.Q"] * 1e6, **style)
            pressure.plot(result.time, result.beat[f"{site}.P"] / MMHG, **style)
        flow.set_title(f"{artery} ({site})", fontsize=11)
        pressure.set_xlabel("time [s]")
        pressure.sharey(pressures[0])
        _tidy(flow)
        _tidy(pressure)
    flows[0].set_ylabel("flow [mL/s]")
    flows[0].legend(frameon=False)
    pressures[0].set_ylabel("pressure [mmHg]")
    to_kilopascals = (lambda P: P * MMHG / 1e3, lambda P: P * 1e3 / MMHG)
    pressures[-1].secondary_yaxis("right", functions=to_kilopascals).set_ylabel("pressure [kPa]")
    figure.align_ylabels([flows[0], pressures[0]])
    return figure


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", linewidth=0.8)
    axes.axhline(0.0, color="0.6", linewidth=0.8)  # every scale starts from zero
    axes.set_axisbelow(True)
    axes.margins(x=0.0)
    axes.locator_params(axis="y", nbins=6, steps=[1, 2, 5, 10])


def peak_table(elastic: Run, viscoelastic: Run) -> Table:
    """Highest pressure and flow at the two sites, for both kinds of wall."""
    table = Table(title="Peaks of the last beat")
    for heading in ("", "elastic", "viscoelastic", "change"):
        table.add_column(heading, justify="right" if heading else "left")
    for kind, unit, scale, digits in (("P", "Pa", 1.0, 2), ("Q", "mL/s", 1e6, 5)):
        for site in SITES:
            before, after = (float(r.beat[f"{site}.{kind}"].max()) * scale for r in (elastic, viscoelastic))
            peaks = f"{before:.{digits}f}", f"{after:.{digits}f}"
            table.add_row(f"{kind} at {site}, {unit}", *peaks, f"{100 * (after / before - 1):+.1f} %")
    return table


def damping_table(elastic: Run, viscoelastic: Run) -> Table:
    """The remaining fraction of each harmonic of the flow at CA with wall viscosity; those below SMALLEST are
    omitted."""
    before, after = (harmonics(r.beat["CA.Q"]) * 1e6 for r in (elastic, viscoelastic))
    table = Table(title="Harmonics of the flow at CA")
    for heading in ("harmonic", "frequency, Hz", "elastic, mL/s", "viscoelastic, mL/s", "ratio"):
        table.add_column(heading, justify="right")
    for k in range(1, len(before)):
        if before[k] >= SMALLEST * before[1:].max():
            table.add_row(
                str(k),
                f"{k / elastic.time[-1]:.1f}",
                f"{before[k]:.5f}",
                f"{after[k]:.5f}",
                f"{after[k] / before[k]:.3f}",
            )
    return table


# --- the demo -----------------------------------------------------------------------------------------------------


@sentences(ValueError, FMUError, OSError)
def main(out: Annotated[Path, typer.Option(help="Directory of the FMU and the figures.")] = Path("dist")) -> None:
    """Build sheep.fmu, run it with elastic and with viscoelastic walls, and show the difference."""
    console, began = Console(), time.perf_counter()
    network = load("sheep")
    fmu = build(network, out)

    # the FMU starts with Table 1 of the paper; without wall viscosity the walls are elastic
    cases = {"elastic": {f"{segment.name}.phi0": 0.0 for segment in network.segments}, "viscoelastic": {}}
    runs = {}
    with bar(False) as progress:
        for walls, start_values in cases.items():

            def tell(part: float, label: str = f"{walls} walls") -> None:
                progress(part, label)

            runs[walls] = run(fmu, network, start_values, tell)

    pictures = [out / f"sheep.{suffix}" for suffix in ("png", "svg")]
    figure = draw(runs)
    for picture in pictures:
        buffer = io.BytesIO()
        figure.savefig(buffer, format=picture.suffix[1:], dpi=150)
        write_whole(picture, buffer.getvalue())

    for walls, result in runs.items():
        console.print(
            f"{walls} walls: reached {result.stop_time:g} s in {result.seconds:.1f} s, "
            f"last beat repeats to {result.change:.0e}"
        )
    console.print(peak_table(**runs))
    console.print(damping_table(**runs))
    console.print(f"FMU      {fmu}", *(f"figure   {picture}" for picture in pictures), sep="\n", markup=False)
    console.print(f"The demo took {time.perf_counter() - began:.1f} s.")


if __name__ == "__main__":
    typer.run(main)
