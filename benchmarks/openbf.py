"""The published networks against openBF's own waveforms.

    python benchmarks/openbf.py [--data DIR] [--figure FILE] [--dt "2 ms"]

Without DIR the benchmark compares the middles of the vessels of cca and ibif, included in tests/data/openbf. DIR
contains openBF's results in its own format, <network>/<vessel>_P.csv and _Q.csv with five positions along each vessel.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import start, tabulate
from solver import Settings, Site, Waveforms, load, simulate, simulate_periodic
from solver.network.description import Network
from solver.network.files import parse_quantity

DIGEST = Path(__file__).resolve().parents[1] / "tests" / "data" / "openbf"
PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
Array = np.ndarray
Reference = Mapping[str, tuple[Array, Array]]  # times and values by output, such as d1_50.P


def _rows(path: Path) -> Array:
    with path.open(encoding="utf-8") as file:
        lines = [line for line in file if not line.startswith("#")]
    return np.array([[float(x) for x in row] for row in list(csv.reader(lines))[1:]])


def reference(network: Network, data: Path | None) -> dict[str, tuple[Array, Array]]:
    """openBF's last beat by output: time [s] and values in SI."""
    found = {}
    if data is None:
        with (DIGEST / f"{network.name}.csv").open(encoding="utf-8") as file:
            names = [name.partition(" ")[0] for name in file.readlines()[1].split(",")]
        table = _rows(DIGEST / f"{network.name}.csv")
        for i, name in enumerate(names[1:], 1):
            vessel, _, signal = name.rpartition(".")
            found[f"{vessel}_50.{signal}"] = (table[:, 0], table[:, i])
        return found
    for segment in network.segments:
        for signal in "PQ":
            for path in (data / network.name).glob(f"*{segment.name}_{signal}.csv"):
                table = _rows(path)
                for x, column in zip(PLACES, table[:, 1:].T, strict=True):
                    found[f"{segment.name}_{round(100 * x)}.{signal}"] = (table[:, 0], column)
    return found


def with_sites(network: Network) -> Network:
    """The network with the five places of openBF as sites."""
    sites = [Site(f"{s.name}_{round(100 * x)}", s.name, x) for s in network.segments for x in PLACES]
    return replace(network, sites=tuple(sites))


def compared(result: Waveforms, found: Reference, later: float = 0.0) -> dict[str, tuple[float, float, float]]:
    """By output, in parts of openBF's pulse: rms of the difference about its mean; its mean; other pulse.

    later [s] : by which openBF's times are taken to be late.
    """
    errors, T = {}, result.time[-1]
    for name, (t, wanted) in found.items():
        own = np.interp((np.mod(t, T) if result.time[0] == 0.0 else t) - later, result.time, result[name])
        difference, pulse = own - wanted, np.ptp(wanted)
        errors[name] = (np.std(difference) / pulse, np.mean(difference) / pulse, np.ptp(own) / pulse - 1.0)
    return errors


def tabulate_errors(network: Network, rows: Mapping[str, dict[str, tuple[float, float, float]]]) -> None:
    """A row for each beat and signal: median, and worst, of the sizes of its errors."""
    cells = []
    for label, errors in rows.items():
        for signal in "PQ":
            each = 100.0 * np.abs([e for key, e in errors.items() if key.endswith(signal)])
            middle, most = np.median(each, axis=0), each.max(axis=0)
            numbers = middle[0], most[0], middle[1], middle[2], most[2]
            cells.append((label if signal == "P" else "", signal, *(f"{x:.2f}" for x in numbers)))
    columns = ("beat", "signal", "shape", "worst", "mean", "pulse", "worst")
    tabulate(f"{network.name}, % of pulse", columns, cells, left=2)


def main(
    data: Annotated[Path | None, typer.Option(help="openBF's results, a directory per network.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw the waveforms here.")] = None,
    dt: Annotated[str, typer.Option(help="Time step.")] = "2 ms",
    element_length: Annotated[str, typer.Option(help="Longest element.")] = "5 cm",
    networks: Annotated[str, typer.Option(help="Names, with commas.")] = "cca,ibif",
) -> None:
    """Compare the published networks with openBF's results."""
    settings = Settings(
        dt=parse_quantity(dt, "s", "--dt"), element_length=parse_quantity(element_length, "m", "--element-length")
    )
    drawn: list[tuple[str, Waveforms, Reference, Waveforms]] = []
    for name in networks.split(","):
        network = with_sites(load(name))
        found = reference(network, data)
        result = simulate_periodic(network, settings=settings, tolerance=1e-4, start="periodic")
        same = last_beat(network, settings, max(t[-1] for t, _ in found.values()))
        rows = {"periodic": compared(result, found), "as many as openBF, from rest": compared(same, found)}
        rows["the same, time: 0.6 ms later"] = compared(same, found, later=6e-4)
        drawn.append((name, result, found, same))
        tabulate_errors(network, rows)
    if figure is not None:
        _draw(drawn, figure)


def last_beat(network: Network, settings: Settings, until: float) -> Waveforms:
    """The beat before ``until`` [s], from rest."""
    result = simulate(network, duration=until, settings=settings)
    kept = result.time >= until - 1.01 * network.inlet.T
    columns = {name: values[kept] for name, values in result.items()}
    return replace(result, time=result.time[kept], columns=columns)


def _draw(drawn: list[tuple[str, Waveforms, Reference, Waveforms]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = [
        (name, r, f, s, key) for name, r, f, s in drawn for key in f if "_50." in key and not key.startswith("d2")
    ]
    figure, axes = plt.subplots(
        2, len(panels) // 2, figsize=(3.4 * len(panels) / 2, 5.0), squeeze=False, sharex="col", layout="constrained"
    )
    for i, (name, result, found, same, key) in enumerate(panels):
        axis = axes[i % 2][i // 2]
        factor, unit = {"P": (1e-3, "kPa"), "Q": (1e6, "mL/s")}[key[-1]]
        t, wanted = found[key]
        at = np.mod(t, result.time[-1])
        order = np.argsort(at)
        axis.plot(at[order], factor * wanted[order], "o", color="0.5", markersize=4, mfc="none", label="openBF")
        axis.plot(result.time, factor * result[key], color="#0072B2", label="this solver, periodic beat")
        beat = np.mod(same.time, result.time[-1])
        turn = np.argsort(beat)
        axis.plot(
            beat[turn], factor * same[key][turn], "--", color="#D55E00", label="this solver, as many beats as openBF"
        )
        axis.set_ylabel(f"{key[-1]} [{unit}]")
        if i % 2 == 0:
            axis.set_title(f"{name}, {key[:-5]}".replace("_", " ").replace(" d1", " daughter d1"), fontsize=10)
        else:
            axis.set_xlabel("t [s]")
    figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    start(main)
