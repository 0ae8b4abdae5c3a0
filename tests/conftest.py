"""Fixtures shared by the tests."""

from __future__ import annotations

import os

# before NumPy is imported, and inherited by the processes that tests start: the matrices are small, and threads that
# wait for one another take several times as long on a busy machine
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import pytest

from solver import Network, load


@pytest.fixture(scope="session")
def sheep() -> Network:
    """The paper's network, Table 1."""
    return load("sheep")
