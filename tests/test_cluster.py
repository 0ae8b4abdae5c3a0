"""Tasks on a real cluster of dask.distributed on loopback: the numbers of one process, whatever dies meanwhile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from fitting.parallel import tasks
from fitting.parallel.threads import ENVIRONMENT

ROOT = Path(__file__).resolve().parents[1]
LONGEST = 500.0  # s that a scheduler or a worker lives, whatever happens to the test


SQUARE = """
import os, time
from pathlib import Path

def square(task):
    number, folder = task
    with (Path(folder) / f"{os.getpid()}.txt").open("a") as file:
        file.write(f"{number}\\n")
    time.sleep(0.1)
    return number**2

def wrong(task):
    raise ValueError(f"{task}: cannot be done.")
"""


@dataclass(frozen=True)
class Cluster:
    address: str
    workers: tuple[subprocess.Popen[bytes], ...]


@pytest.fixture
def cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Cluster]:
    """A scheduler and two workers, which end by themselves at the latest after LONGEST."""
    (tmp_path / "squares.py").write_text(SQUARE)
    monkeypatch.syspath_prepend(str(tmp_path))
    environment = {**os.environ, **ENVIRONMENT, "PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"}
    address = tmp_path / "scheduler.json"

    def started(program: str, *options: str) -> subprocess.Popen[bytes]:
        line = ["timeout", str(LONGEST), sys.executable, "-m", f"distributed.cli.dask_{program}", *options]
        return subprocess.Popen(
            [*line, "--no-dashboard"], env=environment, cwd=tmp_path, stderr=subprocess.DEVNULL, start_new_session=True
        )

    processes = [started("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(address))]
    try:
        while not (address.is_file() and address.read_text().endswith("}")):
            assert processes[0].poll() is None
            time.sleep(0.05)
        where = json.loads(address.read_text())["address"]
        for _ in range(2):
            processes.append(started("worker", where, "--no-nanny", "--nthreads", "1"))
        yield Cluster(where, tuple(processes[1:]))
    finally:
        for process in processes:
            _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.mark.slow
def test_a_worker_dies(cluster: Cluster, tmp_path: Path) -> None:
    """Two workers, one killed in mid-run: every result once, and that of one process; some tasks were begun twice."""
    from squares import square, wrong  # type: ignore[import-not-found]

    work = [(number, str(tmp_path)) for number in range(40)]
    found: list[tuple[int, int]] = []
    for i, answer in tasks.done(square, work, scheduler=cluster.address):
        found.append((i, answer))
        if len(found) == 8 and len(list(tmp_path.glob("*.txt"))) < 2:
            while len(list(tmp_path.glob("*.txt"))) < 2:  # until the second one works, too
                time.sleep(0.05)
        if len(found) == 12:
            _kill(cluster.workers[0])
    assert len(found) == 40 and sorted(found) == [(i, i**2) for i in range(40)]
    with pytest.raises(ValueError, match="cannot be done"):
        list(tasks.done(wrong, work[:2], scheduler=cluster.address))


@pytest.mark.slow
def test_a_study_on_a_cluster(cluster: Cluster, tmp_path: Path) -> None:
    """The bytes of a study in this process, with one worker killed when the first batch is there."""
    from test_study import sheep, varied

    from arterial_fmu.study.plan import Plan
    from arterial_fmu.study.store import Store, run

    plan = Plan(sheep(), varied("CA.phi0=10..120kPa*s", "all.E=0.8..1.2x"), 32, 1, ("CA",))
    there, here = (Store(tmp_path / name, plan) for name in ("there", "here"))
    killed = []

    def kill(fraction: float, _: str) -> None:
        if fraction > 0.0 and not killed:
            killed.append(_kill(cluster.workers[1]))

    assert run(plan, there, scheduler=cluster.address, progress=kill) == run(plan, here, jobs=1) == 128
    assert killed
    for name in ("sets", "waveforms", "finer"):
        file = f"{name}.parquet"
        assert (tmp_path / "there" / file).read_bytes() == (tmp_path / "here" / file).read_bytes()


@pytest.mark.slow
def test_starts_on_a_cluster(cluster: Cluster) -> None:
    """A calibration from four starts by two workers: the numbers of this process, bit by bit."""
    from test_starts import found, same

    same(found(4, scheduler=cluster.address), found(4))


def test_no_scheduler() -> None:
    """One sentence, soon; and dask is imported by nobody who does not ask for it."""
    with pytest.raises(ValueError, match="--scheduler tcp://127.0.0.1:9: no scheduler answers there"):
        list(tasks.done(abs, [1], scheduler="tcp://127.0.0.1:9"))
    with pytest.raises(ValueError, match="--scheduler nonsense: not an address; write it like tcp://"):
        list(tasks.done(abs, [1], scheduler="nonsense"))
    with pytest.raises(ValueError, match="jobs 0: must be a whole number of processes"):
        list(tasks.done(abs, [1], jobs=0))
    code = "import sys; import arterial_fmu.study.command; print({'dask', 'distributed', 'SALib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "set()\n"


def test_processes_of_this_computer() -> None:
    """Two processes, or one: every result once."""
    assert sorted(tasks.done(abs, [-1, -2, -3, -4], jobs=2)) == [(0, 1), (1, 2), (2, 3), (3, 4)]
    assert list(tasks.done(abs, [-1, -2], jobs=1)) == [(0, 1), (1, 2)]
