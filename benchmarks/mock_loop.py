"""One calibration of a real mock circulation, judged on other steps: the tables of docs/real-recordings.md.

    python benchmarks/mock_loop.py FOLDER --network FILE --free NUMBER … [--fit 2,10,20] [--judge 6,14,18]
                                   [--set NAME=VALUE …]

FOLDER holds files of the "Mock Circulatory Loop Generated Database for Dynamic Characterization of Pressure-based
Cardiac Output Monitoring Systems" (U.S. Food and Drug Administration, 2024, RST24CV01.01; CC0 1.0), as they are: time
[s], flow [mL/s], central and peripheral pressure [mmHg], without a header, named ``NV_step10_COresolution.csv``. Three
of them, 10 s long, are in examples/data/mock-loop.

The steps of ``--fit`` are calibrated together, and judged on these and on those of ``--judge`` with no number changed;
``--set``: other numbers of the network, also of effects that it lacks. RMS is over the mean beat, model less measured;
pulsation: the same without the means. Beside it stands what no model is needed for, the ratios P/Q of the harmonics 1
to 16 of the fitted step of nearest flow times the flow of the other. Nothing is asserted.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import JsonFile, start, store, tabulate
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.inference.models.simulator import HARMONICS_BEYOND, Simulator
from fitting.inference.runs import Runs
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.channels.inflow import inflow
from fitting.records.read.columns import Reading
from fitting.records.read.record import read_record
from fitting.results.parameter_set import unit_of
from solver import Settings
from solver.network.description import Network
from solver.network.files import parse_quantity, read_network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, MMHG

COLUMNS = {"1": "time [s]", "2": "inlet.Q [mL/s]", "3": "Ao.P [mmHg]", "4": "Pe.P [mmHg]"}
CHANNELS = ("Ao.P", "Pe.P")
RATIOS = 16  # harmonics that ratios of P and Q are taken of
K = 30  # harmonics that are compared: a beat of 0.8 s, up to 37 Hz

Pair = tuple[float, float]  # of CHANNELS


@dataclass(frozen=True)
class Judged:
    """A calibration under the flow of another file [mmHg]: rms, pulsation, error of the mean, and the pulsation that is
    left by the ratios of the harmonics."""

    fitted: str
    file: str
    rms: Pair
    pulsation: Pair
    mean: Pair
    ratios: Pair


def left(beats: Beats, network: Network) -> tuple[Pair, Pair, Pair]:
    """rms, pulsation and error of the mean [mmHg] that a network leaves under the flow of a record."""
    settings = Settings()
    simulator = Simulator(network, inflow(beats, settings.dt, network), beats.T, CHANNELS, K, settings,
                          beyond=HARMONICS_BEYOND)  # fmt: skip
    X = simulator.coefficients(network, {}, Runs())[0]
    found = []
    for i, name in enumerate(CHANNELS):
        difference = (np.fft.irfft(X[:, i], beats.N, norm="forward") - beats.mean(name)) / MMHG
        found.append((np.sqrt(np.mean(difference**2)), np.std(difference), np.mean(difference)))
    rms, pulsation, mean = ((float(a), float(b)) for a, b in zip(*found, strict=True))
    return rms, pulsation, mean


def by_ratios(fitted: Beats, judged: Beats) -> Pair:
    """Pulsation [mmHg] that is left where the harmonics of P are those of Q times their ratio in another record."""
    k = np.arange(1, RATIOS + 1)
    found = []
    for name in CHANNELS:
        (Q, P), (q, p) = ([np.fft.rfft(b.mean(n), norm="forward")[k] for n in (INFLOW, name)] for b in (fitted, judged))
        found.append(float(np.sqrt(2.0 * (np.abs(P / Q * q - p) ** 2).sum())) / MMHG)
    return found[0], found[1]


def together(paths: Sequence[Path], fit: Sequence[int], judge: Sequence[int], network: Network,
             free: Sequence[str]) -> tuple[list[Judged], Calibration]:  # fmt: skip
    """One calibration of some steps, with zeros of sensors, judged on each and on others; by ratios: of the fitted step
    whose mean flow is nearest."""
    steady = {step(path): path for path in paths if path.stem.startswith("NV_") and "SVV" not in path.stem}
    beats = {i: align(read_record(steady[i], Reading(names=COLUMNS))) for i in (*fit, *judge)}
    begun = time.process_time()
    result = calibrate([beats[i] for i in fit], network, free)
    seconds = time.process_time() - begun
    found, judged = found_by(result, network), []
    for i, each in beats.items():
        others = [beats[j] for j in fit if j != i] or [each]
        near = min(others, key=lambda other: abs(other.mean(INFLOW).mean() - each.mean(INFLOW).mean()))
        said = f"{steady[i].stem}, {'fitted' if i in fit else 'held out'}"
        judged.append(Judged(near.source, said, *left(each, found), by_ratios(near, each)))
    columns = ("nearest fitted", "judged on", "rms", "pulsation", "by ratios P/Q", "error of the mean")
    cells = [(j.fitted, j.file, both(j.rms), both(j.pulsation), both(j.ratios), both(j.mean)) for j in judged]
    tabulate(f"{' / '.join(CHANNELS)} in mmHg", columns, cells, left=0, width=190)
    print(f"{seconds:.0f} s", *(f"{name} = {number(value, 3)}" for name, value in result.values.items()),
          *result.report, sep="\n")  # fmt: skip
    return judged, result


def found_by(result: Calibration, network: Network) -> Network:
    """The network as calibrated, with the zeros of its sensors."""
    zeros = {name: value for name, (value, _) in result.zeros.items()}
    return result.parameter_set().apply(network).with_terms(zeros)


def assigned(network: Network, texts: Sequence[str]) -> Network:
    """The network with other numbers, NAME=VALUE, also of effects that it lacks."""
    pairs = [[part.strip() for part in text.split("=", 1)] for text in texts]
    return network.with_terms({name: parse_quantity(text, unit_of(name), name) for name, text in pairs})


def step(path: Path) -> int:
    """The number of a file's step, 0 where it has none."""
    found = re.search(r"step(\d+)", path.stem)
    return int(found[1]) if found else 0


def both(pair: Pair) -> str:
    return " / ".join(number(each, 2) for each in pair)


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of the CSV files.")],
    network: Annotated[Path, typer.Option(help="Network file.")],
    free: Annotated[list[str], typer.Option(help="What is calibrated, as for arterial-fmu calibrate.")],
    fit: Annotated[str, typer.Option(help="Normovolemic steps that are calibrated.")] = "2,10,20",
    judge: Annotated[str, typer.Option(help="Normovolemic steps that the calibration is judged on.")] = "6,14,18",
    given_numbers: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE of the network.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        typer.echo(f"{folder}: no CSV file; the docstring of this script says which database it is for.", err=True)
        raise typer.Exit(2)
    fitted, others = ([int(i) for i in text.split(",")] for text in (fit, judge))
    judged, result = together(paths, fitted, others, assigned(read_network(network), given_numbers or []), free)
    store(json_file, {"judged": judged, "values": dict(result.values)})


if __name__ == "__main__":
    start(main)
