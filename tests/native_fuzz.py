"""The fuzzing hosts native_fuzz2.c and native_fuzz3.c: compiled with the engine's sources and run."""

from __future__ import annotations

import os
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import NamedTuple

import fmpy

from fmu_src import compiler
from fmu_src.native.binaries import SOURCES

HERE = Path(__file__).resolve().parent
HEADERS = Path(fmpy.__file__).parent / "c-code"
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


class Counts(NamedTuple):
    """Calls, how many of them, of steps and of derivatives succeeded, and lines in the log."""

    calls: int
    fine: int
    steps: int
    derived: int
    lines: int


class NoSanitizers(Exception):
    """Why the hosts cannot be compiled."""


def functions(fmi: int) -> set[str]:
    """The functions of a version of the standard, by its header."""
    header = (HEADERS / f"fmi{fmi}Functions.h").read_text(encoding="utf-8")
    return set(re.findall(rf"#define (fmi{fmi}\w+) +fmi{fmi}FullName", header))


def called(fmi: int) -> set[str]:
    """The functions that a host calls, its macros carried out."""
    line = [*_compiler(), "-E", "-P", f"-I{HEADERS}", str(HERE / f"native_fuzz{fmi}.c")]
    text = subprocess.run(line, capture_output=True, text=True, check=True).stdout
    return {name for name in re.findall(rf"\b(fmi{fmi}\w+)\(", text) if not name.endswith("TYPE")}


def _compiler() -> list[str]:
    found = compiler.own()
    if not found:
        raise NoSanitizers("there is no C compiler (cc)")
    return found[0]


def compiled(fmi: int, folder: Path) -> Path:
    """A host with the FMU's sources in it, under the address and undefined-behaviour sanitizers; the sources are
    compiled once for both hosts of a folder.

    Raises NoSanitizers where they cannot be had.
    """
    program = folder / f"fuzz{fmi}"
    _compile([*_sources(folder), str(HERE / f"native_fuzz{fmi}.c"), "-o", str(program), "-lm"], folder)
    return program


@cache
def _sources(folder: Path) -> list[str]:
    """The object files of the FMU's sources."""
    _compile(["-c", *map(str, sorted(SOURCES.glob("*.c"))), *map(str, sorted(SOURCES.glob("fmu/*.c")))], folder)
    return [*map(str, sorted(folder.glob("*.o")))]


def _compile(line: list[str], folder: Path) -> None:
    flags = ["-std=gnu11", "-g", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{HEADERS}", *SANITIZERS]
    done = subprocess.run([*_compiler(), *flags, *line], cwd=folder, capture_output=True, text=True)
    if "sanitizer" in done.stderr or "libasan" in done.stderr:
        raise NoSanitizers("the compiler has no sanitizers")
    assert done.returncode == 0, done.stderr


def run(program: Path, fmu: Path, seed: int, calls: int) -> tuple[Counts | None, str]:
    """Random calls to three instances of an unpacked FMU.

    Returns the counts, None where the host died, and its error output.
    """
    description = fmpy.read_model_description(os.fspath(fmu))
    variables = [v for v in description.modelVariables if v.causality != "independent"]
    outputs = sum(v.causality == "output" for v in variables)
    scratch = fmu / "scratch"
    scratch.mkdir(exist_ok=True)
    numbers = [seed, calls, len(variables) - outputs, outputs]
    token = description.guid if description.fmiVersion == "2.0" else description.instantiationToken
    line = [str(program), str(fmu / "resources"), token, *map(str, numbers), str(scratch)]
    done = subprocess.run(line, capture_output=True, text=True, timeout=500)
    counts = Counts(*map(int, done.stdout.split())) if done.returncode == 0 else None
    return counts, done.stderr
