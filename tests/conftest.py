"""Fixtures shared by the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

# before NumPy is imported, and inherited by the processes that tests start: the matrices are small, and threads that
# wait for one another take several times as long on a busy machine
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import hypothesis
import pytest
from commands import in_process

from solver import Network, load

# a slow machine is no fault
hypothesis.settings.register_profile("no deadline", deadline=None)
hypothesis.settings.load_profile("no deadline")


@pytest.fixture(scope="session")
def sheep() -> Network:
    """The paper's network, Table 1."""
    return load("sheep")


@pytest.fixture(scope="module")
def one_process() -> Iterator[None]:
    """``python -m build_fmu`` and ``python -m fmu_src.run`` are run where the test runs, by the same command line.

    For tests whose claim is not about processes: those that start them for good are in test_build.py, test_run.py,
    test_fmu.py, and in the examples.
    """
    commands = {name: import_module(name).main for name in ("build_fmu", "fmu_src.run")}
    real = subprocess.run

    def run(line: list[str], **options: Any) -> Any:
        if isinstance(line, list) and line[:2] == [sys.executable, "-m"] and line[2] in commands:
            return in_process(commands[line[2]], line[3:])
        return real(line, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "run", run)
        yield
