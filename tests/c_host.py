"""The co-simulation host in C (checker.c): compiled for the tests, given its commands, its answers read."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy
import pytest

from fmu_src.importer.interpreter import Interpreter, interpreter

SOURCE = Path(__file__).with_name("checker.c")


@dataclass(frozen=True)
class Answer:
    """What the host answered to one command, and what the FMU logged meanwhile as "STATUS CATEGORY TEXT"."""

    status: str
    rest: str
    log: tuple[str, ...]

    @property
    def values(self) -> list[float]:
        return [float(word) for word in self.rest.split()]


@dataclass(frozen=True)
class Unpacked:
    """An FMU's folder, with what the host must know of it."""

    folder: Path

    @cached_property
    def _description(self) -> fmpy.model_description.ModelDescription:
        return fmpy.read_model_description(os.fspath(self.folder))

    @cached_property
    def references(self) -> dict[str, int]:
        return {v.name: v.valueReference for v in self._description.modelVariables}

    @property
    def outputs(self) -> list[str]:
        return [v.name for v in self._description.modelVariables if v.causality == "output"]

    @property
    def library(self) -> Path:
        return self.folder / "binaries" / "linux64" / f"{self._description.coSimulation.modelIdentifier}.so"

    def instantiate(self, i: int, library: int = 0, uri: str | None = None) -> str:
        """The command that makes instance i."""
        return f"instantiate {i} {library} 1 {self._description.guid} {uri or f'file://{self.folder}/resources'}"


def unpack(fmu: Path, folder: Path) -> Unpacked:
    return Unpacked(Path(fmpy.extract(os.fspath(fmu), os.fspath(folder))))


@dataclass(frozen=True)
class Run:
    """A run of the host: exit code, negative where a signal killed it, error output, and an answer for each command."""

    code: int
    errors: str
    answers: list[Answer]

    def __getitem__(self, i: int) -> Answer:
        return self.answers[i]


class CHost:
    """The compiled host, to be run inside the environment of a Python."""

    def __init__(self, program: Path) -> None:
        self.program = program

    def environment(self, where: Interpreter | None = None, **more: str) -> dict[str, str]:
        """That of the doctor's command line."""
        own = (where or interpreter()).environment()
        path = own.get("PATH", "$PATH").replace("$PATH", os.environ.get("PATH", ""))
        return {**os.environ, **own, "PATH": path, **more}

    def run(
        self,
        commands: Iterable[str],
        environment: Mapping[str, str] | None = None,
        line: Sequence[str] = (),
        **options: Any,
    ) -> Run:
        """Give the host its commands; ``line`` is another command line that starts it."""
        done = subprocess.run(
            line or [os.fspath(self.program)],
            input="".join(f"{line}\n" for line in commands).encode("utf-8", "surrogateescape"),
            capture_output=True,
            env=environment or self.environment(),
            timeout=300,
            **options,
        )
        return Run(done.returncode, done.stderr.decode("utf-8", "replace"), _answers(done.stdout))


def _answers(output: bytes) -> list[Answer]:
    answers, log = [], []
    for line in output.decode("utf-8", "replace").splitlines():
        first, _, rest = line.partition(" ")
        if first == "log":
            log.append(rest)
        else:
            answers.append(Answer(first, rest, tuple(log)))
            log = []
    return answers


def compiled(folder: Path) -> CHost:
    """The host, or a skip with the reason."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if sys.platform != "linux" or compiler is None:
        pytest.skip("the host in C needs Linux and a C compiler (cc)")
    if interpreter().library is None:
        pytest.skip(f"{sys.executable} has no shared library (sysconfig {sysconfig.get_config_var('LDLIBRARY')})")
    program = folder / "checker"
    flags = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, "-o", program, SOURCE, "-ldl"], check=True)
    return CHost(program)
