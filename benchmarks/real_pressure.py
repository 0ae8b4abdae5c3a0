"""Cutting of measured arterial pressure into beats: consecutive windows of 15 s and of 30 s.

    python benchmarks/real_pressure.py FOLDER [--every SECONDS] [--json FILE]

FOLDER holds records, one CSV file a patient with the columns ``time [s]`` and ``AA.P [mmHg]``. They are not included.
The numbers of docs/lab-files.md are of two ventilated patients, 125 Hz: the first ten minutes of ``sample_record`` and
``sample_record2`` of the R package waveformtools (github.com/JohannesNE/waveformtools, commit 24ba1dc; MIT licence,
copyright 2020 Johannes Enevoldsen), with time from 0, and nothing filtered or filled. The pressure is that of a
peripheral arterial line of a human, called AA so that it can be read.

Each window is written as a file and goes the way of any record: read, its sensor checked, its period found, its beats
cut. Shares are of all windows, so that one that is refused counts against each, with the 95 % interval of Clopper and
Pearson, as if windows were independent. Those that overlap (``--every 3``) are not, and theirs is too narrow; but they
tell whether it matters where a window begins. The exit code is 1 where a share is below its target, 2 without records.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from benchmarks.hidden.counts import share
from benchmarks.table import JsonFile, start, store, tabulate
from fitting.records.alignment.align import align
from fitting.records.alignment.beats import Beats
from fitting.records.read.record import Record, read_record

LENGTHS = (15.0, 30.0)  # of windows [s]
TARGET = 0.95  # of the windows
AGREES = 0.05  # of the period, by which it may differ from the median distance of upstrokes
SMOOTH = 0.08  # [s] over which samples are averaged before upstrokes are counted
USUAL = (0.05, 0.95)  # quantiles of the pressure: its usual range, which no artefact widens
LOW, HIGH = 0.35, 0.65  # of that range: a rise from below the one to above the other is an upstroke

SHARES = {"usable": "usable", "agrees": "at the rate of\nthe upstrokes", "same": "same beats, own\nperiod given"}


@dataclass(frozen=True)
class Window:
    """What became of one window: from, length [s] in its file; counted, period [s]; the sentence that refused it.

    usable : read, and cut into beats. agrees : at the rate of the upstrokes. same : and to the same beats, bit for bit,
    if the period that was found is given.
    """

    file: str
    begin: float
    seconds: float
    counted: float
    period: float = np.nan
    beats: int = 0
    same: bool = False
    refused: str = ""

    @property
    def usable(self) -> bool:
        return not self.refused

    @property
    def agrees(self) -> bool:
        return self.usable and abs(self.counted / self.period - 1.0) <= AGREES


def count_upstrokes(time: np.ndarray, pressure: np.ndarray) -> float:
    """The median distance of upstrokes [s], NaN if there are not two: a count that shares nothing with the fits."""
    there = ~np.isnan(pressure)
    time, pressure = time[there], pressure[there]
    wide = max(1, round(SMOOTH / float(np.median(np.diff(time)))))
    smooth = np.convolve(pressure, np.ones(wide) / wide, mode="same")
    bottom, top = np.quantile(smooth, USUAL)
    if top <= bottom:
        return np.nan
    begins, below = [], False
    for t, height in zip(time, (smooth - bottom) / (top - bottom), strict=True):
        if below and height > HIGH:
            begins.append(t)
        below = height < LOW or (below and height <= HIGH)
    return float(np.median(np.diff(begins))) if len(begins) > 1 else np.nan


def same(a: Beats, b: Beats) -> bool:
    """Whether two cuts are the same, bit for bit; NaN where a spike was left out of both."""
    return a.T == b.T and all(np.array_equal(a.values[name], x, equal_nan=True) for name, x in b.values.items())


def cut_again(record: Record, found: Beats) -> bool:
    """Whether the record is cut into the same beats with the period given that was found."""
    try:
        return same(align(record, found.T), found)
    except ValueError:
        return False


def windows(path: Path, seconds: float, every: float) -> Iterator[Window]:
    """The windows of a file, one ``every`` so many seconds. Raises ValueError if it is no record of one pressure."""
    title, *lines = path.read_text(encoding="utf-8").splitlines()
    if not (title.startswith("time [s],") and title.count(",") == 1 and ".P [" in title):
        raise ValueError(f"{path}: the columns must be time [s] and one pressure, AA.P [mmHg]; they are {title!r}.")
    time, pressure = np.genfromtxt(lines, delimiter=",").T
    rate = (len(time) - 1) / (time[-1] - time[0])
    n, apart = round(seconds * rate), round(every * rate)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        for i in range(0, len(lines) - n + 1, apart):
            part = slice(i, i + n)
            file.write_text("\n".join([title, *lines[part]]) + "\n", encoding="utf-8")
            counted = count_upstrokes(time[part], pressure[part])
            at = (path.stem, float(time[i]), seconds, counted)
            try:
                record = read_record(file)
                found = align(record)
            except ValueError as error:
                yield Window(*at, refused=str(error).removeprefix(f"{file}: "))
            else:
                yield Window(*at, found.T, found.n_beats, cut_again(record, found))


def groups(found: Sequence[Window]) -> dict[tuple[str, float], list[Window]]:
    """The windows of each file and length, and those of all files if there are several."""
    files = list(dict.fromkeys(each.file for each in found))
    chosen = {file: [each for each in found if each.file == file] for file in files}
    if len(files) > 1:
        chosen["all"] = list(found)
    return {
        (name, seconds): part
        for name, some in chosen.items()
        for seconds in LENGTHS
        if (part := [each for each in some if each.seconds == seconds])
    }


def show(found: Sequence[Window]) -> None:
    """A row a file and length; then a line for each window that missed something."""
    cells = []
    for (name, seconds), part in groups(found).items():
        least = min((each.beats for each in part if each.usable), default=0)
        cells.append((name, f"{seconds:g} s", len(part), least, *(share(part, attrgetter(what)) for what in SHARES)))
    columns = ("file", "window", "windows", "fewest beats", *(f"{text}\n>= {TARGET:.0%}" for text in SHARES.values()))
    tabulate("windows of measured arterial pressure: share % (of all windows; 95 % interval)", columns, cells)
    for each in found:
        where = f"{each.file}, {each.seconds:g} s from {each.begin:g} s"
        if not each.usable:
            print(f"refused: {where}: {each.refused}")
        elif not each.agrees:
            times = f"a period of {each.period:.3g} s, upstrokes every {each.counted:.3g} s"
            print(f"another rate: {where}: {times}")
        elif not each.same:
            print(f"other beats with its own period given: {where}")


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of the CSV files.")],
    every: Annotated[
        float | None, typer.Option(min=0.1, help="Between windows' beginnings [s]; default: a length.")
    ] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    paths = sorted(folder.glob("*.csv"))
    try:
        found = [each for path in paths for seconds in LENGTHS for each in windows(path, seconds, every or seconds)]
    except ValueError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None
    if not found:
        typer.echo(
            f"{folder}: no CSV file with {LENGTHS[0]:g} s of pressure; the docstring of this script says where the "
            "public recordings come from.",
            err=True,
        )
        raise typer.Exit(2)
    show(found)
    store(json_file, found)
    met = all(share(part, attrgetter(what)).value >= TARGET for part in groups(found).values() for what in SHARES)
    raise typer.Exit(0 if met else 1)


if __name__ == "__main__":
    start(main)
