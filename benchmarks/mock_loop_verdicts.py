"""What `discover` says of a real mock circulation, and how long ten starts of `calibrate` take: real-recordings.md.

    python benchmarks/mock_loop_verdicts.py FOLDER [--network FILE] [--time-limit "1 min"] [--starts 10] [--json FILE]

FOLDER as for benchmarks/mock_loop.py. Each file is studied with its first model, the stated low-passes given, or with
the network of --network, in a process of its own (``--jobs 1``); then the six numbers of the first model are calibrated
from so many starts. RMS is over the mean held-out beat, through the FMU, of the model without and with what was named.
Nothing is asserted.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.mock_loop import CHANNELS, COLUMNS, FILTERS, FREE, Clock, both
from benchmarks.table import JsonFile, start, store, tabulate
from fitting.calibrate.multistart import calibrate_from
from fitting.first.model import first_model
from fitting.records.alignment.align import align
from fitting.records.channels.filters import with_filters
from fitting.records.read.columns import Reading
from fitting.records.read.record import read_record
from solver.network.description import Network
from solver.network.files import read_network, write_network
from solver.quantities.units import MMHG

Row = dict[str, Any]


def spent() -> float:
    """CPU seconds of all child processes until now."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def studied(path: Path, limit: str, folder: Path, given: Network | None) -> Row:
    """The verdict on one file, with CPU and wall seconds."""
    beats = align(read_record(path, Reading(names=COLUMNS)))
    model, out = folder / f"{path.stem}.toml", folder / path.stem
    write_network(given or with_filters(first_model(beats).network, FILTERS), model)
    mapped = [word for column, name in COLUMNS.items() for word in ("--map", f"{column}={name}")]
    command = [sys.executable, "-m", "arterial_fmu", "discover", str(path), "--model", str(model), "--out", str(out)]
    begun, cpu = time.monotonic(), spent()
    done = subprocess.run([*command, *mapped, "--time-limit", limit, "--jobs", "1", "--quiet"], check=False)
    row: Row = {"file": path.stem, "exit": done.returncode, "cpu": spent() - cpu, "wall": time.monotonic() - begun}
    if not (out / "verdict.json").exists():
        return row
    verdict = json.loads((out / "verdict.json").read_text(encoding="utf-8"))
    channels = [verdict["gap"]["channels"].get(name) or {} for name in CHANNELS]
    rms = [[(c.get(key) or float("nan")) / MMHG for c in channels] for key in ("rms_before", "rms_after")]
    kept = ("verdict", "complete", "class", "effects", "gap", "map", "learned", "remains", "reason", "sentence")
    return row | {"rms_before": rms[0], "rms_after": rms[1]} | {key: verdict[key] for key in kept}


def from_many(path: Path, starts: int) -> Row:
    """CPU seconds of a calibration from many starts, and how many ended in the lowest minimum."""
    beats = align(read_record(path, Reading(names=COLUMNS)))
    network = with_filters(first_model(beats).network, FILTERS)
    clock = Clock()
    tried = calibrate_from(beats, network, FREE, starts, jobs=1)
    return {"starts": starts, "starts_cpu": clock.lap(), "ended": list(tried.report)}


def named(row: Row) -> str:
    """What was named, or acts."""
    effects = [f"{e['name']} at {', '.join(e['where'])}" for e in row["effects"]]
    return " + ".join(effects) or ", ".join(f"{p['kind']} {p['where']}" for p in row["map"] or ())


def main(
    folder: Annotated[Path, typer.Argument(help="Folder of the CSV files.")],
    limit: Annotated[str, typer.Option("--time-limit", help="Of naming, for each file.")] = "1 min",
    starts: Annotated[int, typer.Option(help="Of calibrate, with the first model; 0: none.")] = 10,
    network: Annotated[Path | None, typer.Option(help="Network file in place of first models.")] = None,
    files: Annotated[int | None, typer.Option(help="Of the folder, the first ones; default: all.")] = None,
    kept: Annotated[Path | None, typer.Option(help="Folder for the studies; default: none is kept.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    rows, given = list[Row](), None if network is None else read_network(network)
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        for path in sorted(folder.glob("*.csv"))[:files]:
            rows.append(studied(path, limit, kept or Path(made), given))
            rows[-1] |= from_many(path, starts) if starts else {}
            store(json_file, rows)
    columns = ("file", "verdict", "CPU, s", "wall, s", "rms before", "rms after", "named or acting", "starts, s")
    lines = []
    for r in rows:
        said = [r.get("verdict", "–") + ("" if r.get("complete") else ", incomplete"), f"{r['cpu']:.0f}"]
        rms = [both(r["rms_before"]), both(r["rms_after"]), named(r)] if "verdict" in r else ["–"] * 3
        lines.append((r["file"], *said, f"{r['wall']:.0f}", *rms, f"{r.get('starts_cpu', 0.0):.0f}"))
    title = f"rms of {' / '.join(CHANNELS)} in mmHg, held out; seconds of one core"
    tabulate(title, columns, lines, left=len(columns), width=190)


if __name__ == "__main__":
    start(main)
