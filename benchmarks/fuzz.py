"""Random calls into FMUs, in several processes: numbers of calls and rejections, and the end of each process.

    python -m benchmarks.fuzz [--calls 100000] [--jobs 2] [--seed 1]

tests/fuzz_machine.py defines the calls and the checks. The exit code is 1 if a process ended abnormally; the last call
of each is in build/fuzz/<seed>/calls.
"""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from build_fmu import build, build_model
from fmu_src.contents.models import body_model, heart_model
from solver import Settings, load

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES, STEPS = 100, 100  # sequences of a process, and rules of a sequence: about twelve thousand calls


def run(fmus: list[Path], seed: int) -> tuple[int, dict[str, int]]:
    """The exit code of one process, and what it counted."""
    folder = ROOT / "build" / "fuzz" / str(seed)
    folder.mkdir(parents=True, exist_ok=True)
    line = [sys.executable, ROOT / "tests" / "fuzz_machine.py", folder, EXAMPLES, STEPS, seed, *fmus]
    done = subprocess.run(list(map(str, line)), capture_output=True, text=True, check=False)
    (folder / "output").write_text(done.stdout + done.stderr, encoding="utf-8")
    return done.returncode, json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else {}


def main(
    calls: Annotated[int, typer.Option(help="At least so many calls.")] = 100_000,
    jobs: Annotated[int, typer.Option(help="Processes at a time.")] = 2,
    seed: Annotated[int, typer.Option(help="Seed of the first process; the others count on.")] = 1,
) -> None:
    """Make the calls and print how the processes ended."""
    folder = ROOT / "build" / "fuzz"
    # on a coarse grid, because the FMU is under test, not the solver
    fmus = [build(load(name), folder, Settings(dt=2e-3, element_length=0.1)) for name in ("sheep", "sheep_nonlinear")]
    fmus += [build_model(heart_model("human"), folder), build_model(body_model("human"), folder)]
    made = refused = died = processes = 0
    with Progress(console=Console(stderr=True)) as progress, ThreadPoolExecutor(jobs) as pool:
        bar = progress.add_task("calls", total=calls)
        while made < calls and not died:
            seeds = range(seed + processes, seed + processes + jobs)
            for code, found in pool.map(lambda each: run(fmus, each), seeds):
                processes, died = processes + 1, died + (code != 0)
                made, refused = made + found.get("calls", 0), refused + found.get("refused", 0)
                progress.update(bar, completed=made)
    print(f"{made} calls in {processes} processes, {refused} refused; {died} processes did not end well")
    raise typer.Exit(1 if died else 0)


if __name__ == "__main__":
    typer.run(main)
