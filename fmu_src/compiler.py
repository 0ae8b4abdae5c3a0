"""C files to shared libraries, by the machine's compiler for itself or by that of the package ziglang for others.

Standard library alone, because the build of a wheel (``native/arterial_backend.py``) uses it too, where nothing else is
installed. Not part of the code of FMUs.
"""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

# for every processor of its kind, and without contraction: the same numbers everywhere
FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-shared",
         "-fvisibility=hidden", "-s")  # fmt: skip
_STEPS = ("engine.c", "engine.h", "run.h", "steps.c")  # what FMUs need of the engine


@dataclass(frozen=True)
class Platform:
    """Where libraries run. fmi2, fmi3 : its folder in ``binaries/`` of an FMU. target : what ziglang calls it."""

    fmi2: str
    fmi3: str
    target: str
    suffix: str


PLATFORMS = {
    "linux64": Platform("linux64", "x86_64-linux", "x86_64-linux-gnu.2.17", ".so"),
    "aarch64-linux": Platform("aarch64-linux", "aarch64-linux", "aarch64-linux-gnu.2.17", ".so"),
    "win64": Platform("win64", "x86_64-windows", "x86_64-windows-gnu", ".dll"),
    "darwin64": Platform("darwin64", "x86_64-darwin", "x86_64-macos", ".dylib"),
    "aarch64-darwin": Platform("darwin64", "aarch64-darwin", "aarch64-macos", ".dylib"),
}


class NotCompiled(Exception):
    """What a compiler says of files that it cannot compile."""


def ziglang(target: str = "") -> list[str] | None:
    """The compiler of the package ziglang for a target, default this machine; None where it is not installed."""
    there = importlib.util.find_spec("ziglang") is not None
    return [sys.executable, "-m", "ziglang", "cc", *(["-target", target] if target else [])] if there else None


def own() -> list[list[str]]:
    """The machine's C compilers."""
    return [[found] for found in map(shutil.which, ("cc", "gcc", "clang")) if found]


def engine_files(folder: Path) -> list[Path]:
    """The C files of the engine. folder : ``native/``, or its copy in a wheel."""
    return sorted(folder.glob("*.c"))


def fmu_sources(folder: Path) -> dict[str, bytes]:
    """The C files of FMUs by path in such a folder; empty where they are not."""
    files = [*(folder / name for name in _STEPS), *sorted(folder.glob("fmu/*.[ch]"))]
    whole = len(files) > len(_STEPS) and all(file.is_file() for file in files)
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files} if whole else {}


def fmu_library(name: str, sources: Mapping[str, bytes], made_by: str) -> str:
    """The file name of a platform's library for FMUs, with a hash of what it is made of.

    made_by : the target of ziglang, or the command of another compiler.
    """
    key = hashlib.sha256(repr((sorted(sources.items()), FLAGS, made_by)).encode()).hexdigest()[:16]
    return f"{name}-{key}{PLATFORMS[name].suffix}"


def compiled(command: Sequence[str], files: Sequence[Path], suffix: str, define: str = "") -> bytes:
    """The library of C files. define : NAME=VALUE for the preprocessor. Raises NotCompiled.

    The same files give the same bytes wherever they are: no path is in them.
    """
    options = [] if suffix == ".dll" else ["-fPIC"]
    last = [] if suffix == ".dll" else ["-lm"]
    options += ["-Wl,--build-id=none"] if suffix == ".so" else []
    options += [f"-D{define}"] if define else []
    with tempfile.TemporaryDirectory(prefix="arterial_compile_") as folder:
        out = f"arterial{suffix}"
        line = [*command, *FLAGS, *options, *(str(file.resolve()) for file in files), "-o", out, *last]
        done = subprocess.run(line, capture_output=True, text=True, cwd=folder)
        if done.returncode:
            raise NotCompiled(f"{' '.join(command)} does not compile {files[0].parent}: {done.stderr.strip()}")
        return (Path(folder) / out).read_bytes()
