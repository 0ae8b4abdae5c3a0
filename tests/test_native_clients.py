"""Hosts of other makers drive a native FMU as those of tests/test_clients.py drive the other one; two threads, too."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from fmus import MS, Instance, Store
from native_fmus import half_sine, needs_compiler
from test_clients import HOSTS, check_by_fmutool, check_client, check_container, job, run_client

from build_fmu import build_native
from fmu_src.variables.arteries_variables import INTERPOLATIONS
from solver import Network

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def built(sheep: Network, stored: Store) -> dict[str, Path]:
    """The native FMU by its start value of inlet.interpolation."""
    return {kind: stored(build_native, sheep, starts={"inlet.interpolation": kind}) for kind in INTERPOLATIONS}


@pytest.fixture(scope="module")
def reference(built: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """What FMPy finds, call by call."""
    folder = tmp_path_factory.mktemp("fmpy")
    found = run_client("fmpy", [job(fmu, folder / kind) for kind, fmu in built.items()], folder)
    return dict(zip(built, found, strict=True))


@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
@pytest.mark.parametrize("client", HOSTS)
def test_same_answers(
    client: str,
    interpolation: str,
    built: dict[str, Path],
    reference: dict[str, np.ndarray],
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    """In C with no Python on the host's path."""
    bare = {"PATH": "/nonexistent", "LD_PRELOAD": ""}
    check_client(client, interpolation, built, reference, tmp_path, request, **bare)


def test_two_threads(built: dict[str, Path], tmp_path: Path) -> None:
    """Two instances of one library side by side, with other walls: the bits that each has alone."""

    def run(which: int, folder: str) -> list[list[float]]:
        instance = Instance(built["smooth"], tmp_path / folder)
        instance.initialize({"CA.E": (1.5e6, 2.5e6)[which]})
        found = [instance.step(i, half_sine((i + 1) * MS)) for i in range(400)]
        instance.slave.freeInstance()
        return found

    alone = [run(which, f"alone{which}") for which in range(2)]
    assert alone[0] != alone[1]
    with ThreadPoolExecutor(2) as threads:
        together = [*threads.map(run, range(2), ("one", "two"))]
    assert together == alone


def test_fmutool_finds_nothing(built: dict[str, Path]) -> None:
    check_by_fmutool(built["hold"])


def test_within_a_container(sheep: Network, reference: dict[str, np.ndarray], tmp_path: Path) -> None:
    build_native(sheep, tmp_path, starts={"inlet.interpolation": "smooth", "CA.phi0": 2e3})
    check_container(tmp_path, reference["smooth"])
