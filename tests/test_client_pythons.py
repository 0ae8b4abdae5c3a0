"""The same FMU in hosts with Python 3.10 to 3.13: what of these the machine has."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from c_host import CHost
from test_clients import job, run_c

from fmu_src.host import TESTED
from fmu_src.importer.interpreter import Interpreter, interpreter

OLDEST, NEWEST = TESTED
BETWEEN = [(3, minor) for minor in range(OLDEST[1] + 1, NEWEST[1])]
VERSIONS = [
    *(pytest.param(version, marks=pytest.mark.slow) for version in (OLDEST, NEWEST)),
    *(pytest.param(version, marks=pytest.mark.endurance) for version in BETWEEN),  # NumPy is downloaded for each
]


def installed(version: tuple[int, int]) -> Interpreter:
    """A Python of a version with a shared library: on the path, or made by pyenv; or a skip with the reason."""
    name = "python" + ".".join(map(str, version))
    found = [
        shutil.which(name),
        *sorted(Path.home().glob(f".pyenv/versions/{name.removeprefix('python')}.*/bin/python")),
    ]
    for command in filter(None, found):
        try:
            where = interpreter(os.fspath(command))
        except ValueError:  # a shim with no Python behind it
            continue
        if where.version[:2] == version and where.library is not None:
            return where
    pytest.skip(f"no {name} with a shared library on this machine")


def numpy_for(where: Interpreter, folder: Path) -> str:
    """A folder with numpy for a Python, from the package index; or a skip with the reason."""
    version = ".".join(map(str, where.version[:2]))
    line = [sys.executable, "-m", "pip", "install", "--quiet", "--target", os.fspath(folder), "--only-binary=:all:"]
    done = subprocess.run([*line, "--python-version", version, "numpy"], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"numpy for Python {version} could not be installed: {done.stderr.strip().splitlines()[-1:]}")
    return os.fspath(folder)


@pytest.fixture(scope="module")
def here(c_host: CHost, fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """The run under this Python."""
    folder = tmp_path_factory.mktemp("here")
    return run_c(c_host, job(fmus["sheep"], folder), folder)


@pytest.mark.parametrize("version", VERSIONS)
def test_equal_answers(
    version: tuple[int, int], here: np.ndarray, c_host: CHost, fmus: dict[str, Path], tmp_path: Path
) -> None:
    """50 steps, every output: equal to the run under this Python; no bit differed with numpy 2.2 to 2.4."""
    where = installed(version)
    environment = c_host.environment(where, PYTHONPATH=numpy_for(where, tmp_path / "numpy"))
    found = run_c(c_host, job(fmus["sheep"], tmp_path), tmp_path / "there", environment)
    np.testing.assert_allclose(found, here, rtol=1e-13, atol=1e-20)
