"""Random calls into FMUs that need no Python, of FMI 2.0 and 3.0, under the address and undefined-behaviour sanitizers.

    python benchmarks/native_fuzz.py [--calls 100000] [--seed 1]

tests/native_fuzz2.c and native_fuzz3.c make the calls, tests/native_fuzz.py compiles them. Prints how many succeeded,
for arteries, a heart and a body, or what the sanitizers reported; the exit code is then 1.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Annotated

import fmpy
import typer

from build_fmu import build_native, build_native_model
from fmu_src.contents.models import body_model, heart_model
from solver import Settings, load
from tests.native_fuzz import NoSanitizers, compiled, run

COARSE = Settings(dt=2e-3, element_length=0.1)  # the FMU is under test, not the solver


def fmus(fmi: int, folder: Path) -> dict[str, Path]:
    """Unpacked FMUs by name."""
    made = {name: build_native(load(name), folder, COARSE, fmi=fmi) for name in ("sheep", "sheep_nonlinear")}
    made["heart"] = build_native_model(heart_model("human", None, fmi), folder, fmi=fmi)
    made["body"] = build_native_model(body_model("human", None, fmi), folder, fmi=fmi)
    return {name: Path(fmpy.extract(os.fspath(fmu), os.fspath(folder / name))) for name, fmu in made.items()}


def main(
    calls: Annotated[int, typer.Option(help="Calls to each FMU.")] = 100_000,
    seed: Annotated[int, typer.Option(help="Seed of the random numbers.")] = 1,
) -> None:
    """Make the calls and print how they ended."""
    died = 0
    with tempfile.TemporaryDirectory() as folder:
        for fmi in (2, 3):
            place = Path(folder) / f"fmi{fmi}"
            place.mkdir()
            try:
                program = compiled(fmi, Path(folder))
            except NoSanitizers as reason:
                print(f"no calls: {reason}")
                return
            for name, fmu in fmus(fmi, place).items():
                counts, report = run(program, fmu, seed, calls)
                died += counts is None
                print(f"FMI {fmi}.0, {name}: " + (
                    f"{counts.calls} calls, {counts.fine} succeeded, of them {counts.steps} steps and {counts.derived} "
                    f"derivatives; {counts.lines} lines logged, no report" if counts else report
                ))  # fmt: skip
    raise typer.Exit(1 if died else 0)


if __name__ == "__main__":
    typer.run(main)
