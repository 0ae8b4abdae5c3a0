"""Fixtures shared by the tests."""

from __future__ import annotations

import pytest

from solver import Network, load


@pytest.fixture(scope="session")
def sheep() -> Network:
    """The paper's network, Table 1."""
    return load("sheep")
