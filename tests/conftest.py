"""Fixtures shared by the tests."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

# before NumPy is imported, and inherited by the processes that tests start: the matrices are small, and threads that
# wait for one another take several times as long on a busy machine
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import hypothesis
import pytest
from c_host import CHost, compiled
from commands import in_process
from fmus import COARSE, TIGHT, Instance, Store, built_once, mixed
from native_fmus import can_build
from snippets import Lines, documents

from build_fmu import build, build_native
from solver import Network, Settings, load

# a slow machine is no fault; the same examples at every run, others with --hypothesis-profile=explore
hypothesis.settings.register_profile("explore", deadline=None)
hypothesis.settings.register_profile("seeded", deadline=None, derandomize=True)
hypothesis.settings.load_profile("seeded")

# the files that take longest: first, so that at the end no core waits for another
LONGEST = (
    "install", "learned_law", "snippets_of_recordings", "examples", "readme", "toy", "site", "muscl", "nested_evidence",
    "regression", "source_map", "hidden_bank", "ports", "discrepancy_bench", "discrepancy_several", "native_fmu_hosts",
    "discrepancy_partial", "hidden_animals", "naming_off_centre",
    "snippets_of_fitting", "snippets_of_discrepancy",
    "cohort", "study", "native_fmu", "closed_loop", "filters", "profile", "notebooks", "native_balance",
    "discrepancy_walls", "discrepancy_workflow", "check_kinds", "cosimulation", "check", "fmu", "client_pythons",
)  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    """``pytest -m endurance --seeds 25 tests/test_fmu_fuzz.py`` makes 100 000 random calls."""
    parser.addoption("--seeds", type=int, default=2, help="how many seeds endurance tests draw random cases from")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """``further_seed`` : those seeds; 1 is that of the other tests."""
    if "further_seed" in metafunc.fixturenames:
        metafunc.parametrize("further_seed", range(2, 2 + metafunc.config.getoption("seeds")))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """In the order in which processes are to take them."""
    rank = {f"test_{name}": i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


def pytest_collection_finish() -> None:
    """Collect garbage less often, and leave out modules and tests: a twentieth of all time went there."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 10)


@pytest.fixture(scope="session")
def sheep() -> Network:
    """The paper's network, Table 1."""
    return load("sheep")


@pytest.fixture(scope="module")
def one_process(shared_folder: Path) -> Iterator[None]:
    """``python -m build_fmu`` and ``python -m arterial_fmu.cli.run`` are run where the test runs, by the same command
    line; the FMU of a network file and its options is built once for all processes of a run.

    For tests whose claim is not about processes: those that start them for good are in test_build.py, test_run.py,
    test_fmu*.py, and in the examples.
    """
    doors = {"build_fmu": "arterial_fmu.cli.build", "arterial_fmu.cli.run": "arterial_fmu.cli.run"}
    commands = {name: partial(in_process, import_module(door).main) for name, door in doors.items()}
    commands["build_fmu"] = built_once(commands["build_fmu"], shared_folder / "built")
    real = subprocess.run

    def run(line: list[str], **options: Any) -> Any:
        if isinstance(line, list) and line[:2] == [sys.executable, "-m"] and line[2] in commands:
            return commands[line[2]](line[3:])
        return real(line, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "run", run)
        yield


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all processes of a run."""
    folder = tmp_path_factory.getbasetemp()
    return folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder


@pytest.fixture(scope="session")
def lines(shared_folder: Path) -> Lines:
    """Lines of shell in documents."""
    return Lines(shared_folder / "lines")


@pytest.fixture(scope="module")
def folders(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A directory for each document whose snippets run in the module."""
    return {document: tmp_path_factory.mktemp("snippets") for document in documents(str(request.path))}


@pytest.fixture(scope="session")
def stored(shared_folder: Path) -> Store:
    """Builds each FMU once for all processes of a run: ``stored(build, network)``; nobody may write to it."""
    return Store(shared_folder / "stored")


class _Built(dict[str, Path]):
    """FMUs by name; three of them are called sheep.fmu. Each is built when it is first asked for."""

    def __init__(self, stored: Store) -> None:
        sheep = load("sheep")
        self._stored = stored
        self._made: dict[str, tuple[Network, Settings | None]] = {
            "sheep": (sheep, None),
            "sheep_nonlinear": (load("sheep_nonlinear"), None),
            "tight": (load("sheep_nonlinear"), TIGHT),
            "mixed": (mixed(), None),
            "coarse sheep": (sheep, COARSE),
            "stiff sheep": (sheep.with_parameters({"CA.E": 8e6}), None),
        }

    def __missing__(self, name: str) -> Path:
        network, settings = self._made[name]
        return self.setdefault(name, self._stored(build, network, settings=settings))


@pytest.fixture(scope="session")
def fmus(stored: Store) -> dict[str, Path]:
    return _Built(stored)


@pytest.fixture(scope="session")
def fast_fmu(stored: Store) -> Callable[..., Path]:
    """Builds the native FMU of a network, which gives the numbers of the other one (test_native_fmu.py) in a tenth of
    the time; the other one where there is neither a compiler nor a binary."""
    which = build_native if can_build() else build
    return lambda network, settings: stored(which, network, settings=settings)


@pytest.fixture
def instantiate(fmus: dict[str, Path], tmp_path: Path) -> Iterator[Callable[..., Instance]]:
    """Makes instances of FMUs by name, and frees them after the test."""
    made: list[Instance] = []

    def make(name: str, **options: Any) -> Instance:
        made.append(Instance(fmus[name], tmp_path / f"{len(made)}", **options))
        return made[-1]

    yield make
    for instance in made:
        instance.slave.freeInstance()


@pytest.fixture(scope="session")
def c_host(tmp_path_factory: pytest.TempPathFactory) -> CHost:
    """The co-simulation host in C."""
    return compiled(tmp_path_factory.mktemp("c_host"))
