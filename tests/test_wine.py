"""The Windows binary of a native FMU, run by Wine in the host in C: its answers are those on Linux."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from c_host import SOURCE, Answer, CHost, Unpacked, unpack
from fmus import COARSE, Store
from test_native_fmu_hosts import run

from build_fmu import build_native
from solver import load

ZIG = importlib.util.find_spec("ziglang") is not None
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("wine") is None or not ZIG, reason="needs wine and the package ziglang"),
]


@pytest.fixture(scope="module")
def both(stored: Store, tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    """The sheep for Linux and Windows, in a folder with a blank and a letter that is not ASCII."""
    fmu = stored(build_native, load("sheep"), settings=COARSE, platforms=("linux64", "win64"))
    return unpack(fmu, tmp_path_factory.mktemp("wine") / "an élastic sheep")


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> CHost:
    """The host compiled for Windows."""
    program = tmp_path_factory.mktemp("host") / "checker.exe"
    compiler = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-windows-gnu", "-std=c11", "-O1", "-Wall"]
    subprocess.run([*compiler, "-o", program, SOURCE], check=True)
    return CHost(program)


def wine(host: CHost, commands: list[str], folder: Path) -> list[Answer]:
    """The answers of the host in Wine, whose files are in ``folder``."""
    given = {**os.environ, "WINEPREFIX": os.fspath(folder / "wine"), "WINEDEBUG": "-all"}
    done = host.run(commands, given, ["wine", os.fspath(host.program)])
    assert done.code == 0, done.errors
    return done.answers


def for_windows(command: str, fmu: Unpacked) -> str:
    """A command with the library of Windows, and the paths that Wine has for those of Linux."""
    library = fmu.folder / "binaries" / "win64" / "sheep.dll"
    return command.replace(os.fspath(fmu.library), "Z:" + os.fspath(library).replace("/", "\\"))


def test_the_windows_binary_has_the_same_numbers(c_host: CHost, windows: CHost, both: Unpacked, tmp_path: Path) -> None:
    """20 steps of the sheep with all outputs read: the same answers, numbers to the last bit."""
    resources = (both.folder / "resources").as_uri()
    commands = run(both, uri=resources)
    here = c_host.run(commands)
    assert here.code == 0 and [each.status for each in here.answers] == ["ok"] * len(commands)
    uri = resources.replace("file:///", "file:///Z:/")
    found = wine(windows, [for_windows(c, both) for c in run(both, uri=uri)], tmp_path)
    assert found == here.answers


def test_a_truncated_resource_is_refused(windows: CHost, both: Unpacked, tmp_path: Path) -> None:
    """Half a program: no instance and a sentence with the file, no crash."""
    cut = tmp_path / "resources"
    shutil.copytree(both.folder / "resources", cut)
    program = cut / "arterial.bin"
    program.write_bytes(program.read_bytes()[: program.stat().st_size // 2])
    uri = cut.as_uri().replace("file:///", "file:///Z:/")
    library, begin, *_ = (for_windows(c, both) for c in run(both, uri=uri))
    _, refused = wine(windows, [library, begin], tmp_path)
    assert refused.status == "null" and "arterial.bin" in refused.log[0]
