"""One tube with a Windkessel as a model of a real mock circulation: the tables of docs/real-recordings.md.

    python benchmarks/mock_loop.py FOLDER [--network FILE --free NUMBER …] [--fit 2,10,20] [--judge 6,14,18]
    python benchmarks/mock_loop.py FOLDER --together --network FILE --free NUMBER … [--set NAME=VALUE …]

FOLDER holds files of the "Mock Circulatory Loop Generated Database for Dynamic Characterization of Pressure-based
Cardiac Output Monitoring Systems" (U.S. Food and Drug Administration, 2024, RST24CV01.01; CC0 1.0), as they are: time
[s], flow [mL/s], central and peripheral pressure [mmHg], without a header, named ``NV_step10_COresolution.csv``. Three
of them, 10 s long, are in examples/data/mock-loop.

Every file is read and cut into beats, gets a first model with the stated low-passes, and that is calibrated (--network,
--free: another one, with its own). Then
each calibration of a step of ``--fit`` is driven by the flow of every step of ``--judge``, with no number changed. RMS
is over the mean beat, model less measured; pulsation: the same without the means. Beside it stands what no model is
needed for, the ratios P/Q of the harmonics 1 to 16 of the fitted step times the flow of the other. ``--together``: one
calibration of all steps of ``--fit``, judged on these and on those of ``--judge``; ``--set``: other numbers of the
network, also of effects that it lacks. Nothing is asserted.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.table import JsonFile, start, store, tabulate
from fitting.calibrate.network_calibration import Calibration, calibrate
from fitting.first.model import first_model
from fitting.inference.models.simulator import HARMONICS_BEYOND, Simulator
from fitting.inference.runs import Runs
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.channels.filters import with_filters
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
FILTERS = ("inlet.Q=lowpass 10 Hz", "Ao.P=lowpass 55 Hz", "Pe.P=lowpass 55 Hz")  # as the database says
CHANNELS = ("Ao.P", "Pe.P")
FREE = ("all.E:1", "all.L:1", "all.R0:1", "all.outlet.C:1", "all.outlet.R1:1", "all.outlet.R2:1")
RATIOS = 16  # harmonics that ratios of P and Q are taken of
K = 30  # harmonics that are compared: a beat of 0.8 s, up to 37 Hz

Pair = tuple[float, float]  # of CHANNELS


@dataclass(frozen=True)
class Row:
    """What became of one file. rms, pulsation [mmHg] : of CHANNELS; seconds : of one core."""

    file: str
    beats: int
    period: float
    read: float
    first: float
    first_rms: Pair
    calibrated: float
    settled: bool
    values: dict[str, float]
    undetermined: tuple[str, ...]
    chi2: float
    rms: Pair
    pulsation: Pair
    scatter: Pair


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


@dataclass
class Clock:
    """CPU seconds between calls."""

    since: float = field(default_factory=time.process_time)

    def lap(self) -> float:
        now = time.process_time()
        seconds, self.since = now - self.since, now
        return seconds


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


def measured(path: Path, given: Network | None, free: Sequence[str]) -> tuple[Row, Beats, Network]:
    """A file, its beats, and its first model, or the network that is given, calibrated with it."""
    clock = Clock()
    beats = align(read_record(path, Reading(names=COLUMNS)))
    read = clock.lap()
    network = given or with_filters(first_model(beats).network, FILTERS)
    first = clock.lap()
    first_rms = left(beats, network)[0]
    clock.lap()
    result: Calibration = calibrate(beats, network, free)
    calibrated = clock.lap()
    found = found_by(result, network)
    rms, pulsation, _ = left(beats, found)
    scatter = [float(beats.scatter(name).mean() / np.sqrt(beats.n_beats) / MMHG) for name in CHANNELS]
    row = Row(
        path.stem, beats.n_beats, beats.T, read, first, first_rms, calibrated, result.converged, dict(result.values),
        tuple(sorted(result.undetermined)), result.chi2 / result.dof, rms, pulsation, (scatter[0], scatter[1]),
    )  # fmt: skip
    return row, beats, found


def together(paths: Sequence[Path], fit: Sequence[int], judge: Sequence[int], network: Network,
             free: Sequence[str]) -> tuple[list[Judged], Calibration]:  # fmt: skip
    """One calibration of some steps, judged on each and on others, with its zeros of sensors; by ratios: of the fitted
    step whose mean flow is nearest."""
    steady = {step(path): path for path in paths if path.stem.startswith("NV_") and "SVV" not in path.stem}
    beats = {i: align(read_record(steady[i], Reading(names=COLUMNS))) for i in (*fit, *judge)}
    clock = Clock()
    result = calibrate([beats[i] for i in fit], network, free)
    seconds = clock.lap()
    found, judged = found_by(result, network), []
    for i, each in beats.items():
        others = [beats[j] for j in fit if j != i]
        near = min(others, key=lambda other: abs(other.mean(INFLOW).mean() - each.mean(INFLOW).mean()))
        said = f"{steady[i].stem}, {'fitted' if i in fit else 'held out'}"
        judged.append(Judged(near.source, said, *left(each, found), by_ratios(near, each)))
    show((), judged)
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


def show(rows: Sequence[Row], judged: Sequence[Judged]) -> None:
    """Both tables."""
    columns = ("file", "beats", "read, s", "first, s", "rms of first", "calibrated, s", "χ²/dof", "rms", "pulsation",
               "of the mean beat", "not determined")  # fmt: skip
    cells = [
        (r.file, f"{r.beats} of {r.period:.3f} s", f"{r.read:.2f}", f"{r.first:.2f}", both(r.first_rms),
         f"{r.calibrated:.1f}" + ("" if r.settled else " (not settled)"), number(r.chi2), both(r.rms),
         both(r.pulsation), both(r.scatter), ", ".join(r.undetermined))
        for r in rows
    ]  # fmt: skip
    if rows:
        tabulate(f"rms of {' / '.join(CHANNELS)} in mmHg; CPU seconds", columns, cells, width=190)
    others = ("fitted", "judged on", "rms", "pulsation", "by ratios P/Q", "error of the mean")
    found = [(j.fitted, j.file, both(j.rms), both(j.pulsation), both(j.ratios), both(j.mean)) for j in judged]
    tabulate("fitted, judged: mmHg; by ratios: of the fitted step", others, found, left=0, width=190)


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of the CSV files.")],
    network: Annotated[Path | None, typer.Option(help="Network file in place of first models.")] = None,
    free: Annotated[list[str] | None, typer.Option(help="What is calibrated, as for arterial-fmu calibrate.")] = None,
    fit: Annotated[str, typer.Option(help="Normovolemic steps whose calibrations are judged.")] = "2,10,20",
    judge: Annotated[str, typer.Option(help="Normovolemic steps that they are judged on.")] = "6,14,18",
    joint: Annotated[bool, typer.Option("--together", help="One calibration of all steps of --fit.")] = False,
    given_numbers: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE of the network.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    paths = sorted(folder.glob("*.csv"), key=lambda path: (path.stem.partition("_step")[0], step(path), path.stem))
    if not paths:
        typer.echo(f"{folder}: no CSV file; the docstring of this script says which database it is for.", err=True)
        raise typer.Exit(2)
    given = None if network is None else assigned(read_network(network), given_numbers or [])
    if joint:
        if given is None:
            typer.echo("--together: give the network with --network.", err=True)
            raise typer.Exit(2)
        fitted, others = ([int(i) for i in text.split(",")] for text in (fit, judge))
        judged, result = together(paths, fitted, others, given, free or FREE)
        store(json_file, {"judged": judged, "values": dict(result.values)})
        return
    found = [measured(path, given, free or FREE) for path in paths]
    steady = {step(path): each for path, each in zip(paths, found, strict=True)
              if path.stem.startswith("NV_") and "SVV" not in path.stem}  # fmt: skip
    pairs = [(steady[int(a)], steady[int(b)]) for a in fit.split(",") for b in judge.split(",")
             if int(a) in steady and int(b) in steady]  # fmt: skip
    judged = [Judged(a[0].file, b[0].file, *left(b[1], a[2]), by_ratios(a[1], b[1])) for a, b in pairs]
    rows = [row for row, _, _ in found]
    show(rows, judged)
    store(json_file, {"files": rows, "judged": judged})


if __name__ == "__main__":
    start(main)
