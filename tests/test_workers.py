"""Work that several processes share: what comes of it is that of one process, whatever becomes of the others."""

from __future__ import annotations

import math
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from io import BufferedReader, BytesIO
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from forked import NETWORK
from small_network import term, terms
from test_discrepancy_network import beats

from discrepancy.name.model_selection import name
from fitting.inference.fit import Member
from fitting.inference.models.batches import _elsewhere, simulated
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.network_record import network_problem
from fitting.inference.runs import Meter, OutOfTime, Runs
from fitting.parallel.workers import Workers, cores, serve


class Counting(Workers):
    """Two processes, the second one there already; ``away`` counts its answers."""

    def __init__(self) -> None:
        super().__init__(2)
        self.away = 0
        for _ in range(1000):
            if "there" in self.share([4.0, 4.0], math.sqrt, lambda _: "there", here):
                break
        self.away = 0

    def share(self, tasks: Sequence[Any], there: Any, taken: Callable[[Any], Any], here: Any) -> list[Any]:
        def counted(answer: Any) -> Any:
            self.away += 1
            return taken(answer)

        return super().share(tasks, there, counted, here)

    @property
    def process(self) -> subprocess.Popen[bytes]:
        (process,) = self._processes
        return process


def here(_: float) -> str:
    time.sleep(0.02)
    return "here"


class Hour:
    """Sleep of an hour for another process; ``sent`` when it was asked for."""

    def __init__(self) -> None:
        self.sent = Event()

    def __reduce__(self) -> Any:
        self.sent.set()
        return float, (3600.0,)


def away(answer: Any) -> str:
    return f"away {answer:g}"


@pytest.fixture
def two() -> Iterator[Counting]:
    with Counting() as workers:
        yield workers


@pytest.fixture(scope="module")
def kept() -> Iterator[Counting]:
    with Counting() as workers:
        yield workers


@pytest.fixture
def lasting(kept: Counting) -> Counting:
    """The same for all tests that leave the other process alive: it has imported what simulates."""
    kept.away = 0
    return kept


@pytest.fixture(scope="module")
def problem() -> NetworkProblem:
    """A record of the fork."""
    return network_problem(beats(), NETWORK)


def asked(problem: NetworkProblem) -> list[Member]:
    """34 points near the fork, of which one breaks down, and 2 with a stenosis: three batches of two processes."""
    rng, stenosis = np.random.default_rng(0), (term("stenosis", "B"),)
    plain, narrow = problem.hypothesis(()), problem.hypothesis(stenosis)
    found = [Member((), plain, 0.3 * rng.normal(size=len(plain))) for _ in range(34)]
    found += [Member(stenosis, narrow, np.abs(0.3 * rng.normal(size=len(narrow)))) for _ in range(2)]
    found[30] = Member((), plain, np.array([400.0, *np.zeros(len(plain) - 1)]))
    return found


# --- simulations ------------------------------------------------------------------------------------------------------


def test_the_same_coefficients(problem: NetworkProblem, lasting: Counting) -> None:
    """Batches of other members end with other residuals of the periodic state, below 1e-5: 7e-12 here."""
    members, told = asked(problem), list[int]()
    alone, shared = Runs(), Runs(Meter(told.append), workers=lasting)
    expected, found = (simulated(problem.simulator, members, runs) for runs in (alone, shared))
    assert lasting.away > 0
    assert [x is None for x in found] == [x is None for x in expected]
    for x, y in zip(expected, found, strict=True):
        if x is not None and y is not None:
            assert np.abs(y - x).max(axis=0) == pytest.approx(0.0, abs=1e-10 * np.abs(x[1:]).max())
    assert shared.meter.simulations == told[-1] == alone.meter.simulations


def test_the_same_name(lasting: Counting) -> None:
    """R_t of B off by 0.3: the same verdict as of one process, sizes and confidence to 1e-9 (equal, measured)."""
    problem = network_problem(beats(), NETWORK.with_parameters({"B.outlet.R_t": 0.1}))
    candidates = tuple(t for t in terms("terminal_reflection", "stenosis") if t.place == "B")
    one, other = (name(problem, candidates, Runs(workers=workers), "common") for workers in (Workers(1), lasting))
    assert lasting.away > 0
    assert (one.verdict, one.best.label) == (other.verdict, other.best.label)
    assert other.confidence == pytest.approx(one.confidence, abs=1e-9)
    np.testing.assert_allclose(other.best.fit.x, one.best.fit.x, atol=1e-9)


def test_time_is_over_everywhere(problem: NetworkProblem, lasting: Counting) -> None:
    """A deadline that is over: no simulation in either process, the same exception as of one; the other process lives,
    for there may be more to do by a later deadline."""
    members, late = asked(problem), time.monotonic() - 1.0
    for workers in (Workers(1), lasting):
        runs = Runs(deadline=late, workers=workers)
        with pytest.raises(OutOfTime, match="allow more time"):
            simulated(problem.simulator, members, runs)
        assert runs.meter.simulations == 0
    assert _elsewhere((problem.simulator, members, list(range(len(members))), late)) == (None, 0)
    assert lasting.jobs == 2


# --- processes --------------------------------------------------------------------------------------------------------


def test_in_order(two: Counting) -> None:
    """Twenty roots, some of them from the other process."""
    squares = [float(i * i) for i in range(20)]
    assert two.share(squares, math.sqrt, float, lambda x: float(here(x) == "here") * math.sqrt(x)) == list(range(20))
    assert two.away > 0


def test_nobody_waits_for_one_that_begins() -> None:
    """A process takes a second to begin: this one has done all by then."""
    with Workers(2) as workers:
        assert workers.share([1.0, 2.0], math.sqrt, away, str) == ["1.0", "2.0"]


def test_an_error_is_raised_here(two: Counting) -> None:
    """-1 has no root, there or here: the sentence of this process; the other one has ended, and all is done here."""
    process = two.process
    with pytest.raises(ValueError, match="math domain error"):
        two.share([-1.0, 4.0], math.sqrt, away, lambda x: here(x) and str(math.sqrt(x)))
    two.close()
    assert process.returncode is not None and two.jobs == 1
    assert two.share([4.0, 9.0], math.sqrt, away, str) == ["4.0", "9.0"]


def test_one_that_is_killed(two: Counting) -> None:
    """Killed while it sleeps for an hour: its task is done here."""
    first, process = Hour(), two.process

    def kill(_: Hour) -> str:
        assert first.sent.wait(60.0)
        process.kill()
        return "here"

    assert two.share([first, Hour()], time.sleep, away, kill) == ["here", "here"]
    assert two.jobs == 1


def test_what_cannot_be_sent(two: Counting) -> None:
    """A task that no pickle holds is done here."""
    assert two.share([lambda: 1, lambda: 2], math.sqrt, away, lambda task: task()) == [1, 2]


def test_an_interrupt_leaves_no_process(two: Counting) -> None:
    """Interrupted here while the other sleeps for an hour."""
    first, process = Hour(), two.process

    def interrupted(_: Hour) -> str:
        assert first.sent.wait(60.0)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), two:
        two.share([first, Hour()], time.sleep, away, interrupted)
    assert process.returncode is not None


def test_it_ends_with_its_pipe(two: Counting) -> None:
    """As when this process is killed: nothing more comes."""
    process = two.process
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(60.0) == 0


def test_what_it_writes() -> None:
    """A first word, then the answer to every task."""
    tasks = b"".join(pickle.dumps((math.sqrt, x)) for x in (4.0, 9.0))
    answers = BytesIO()
    serve(BufferedReader(BytesIO(tasks)), answers)  # type: ignore[type-var]
    assert answers.getvalue() == b"!" + pickle.dumps(2.0) + pickle.dumps(3.0)


@pytest.mark.parametrize(("jobs", "tasks"), [(1, [4.0, 9.0]), (2, [4.0]), (2, [])])
def test_no_process_without_need(monkeypatch: pytest.MonkeyPatch, jobs: int, tasks: list[float]) -> None:
    """One job, or nothing to share."""
    monkeypatch.setattr(subprocess, "Popen", partial(pytest.fail, "a process"))
    with Workers(jobs) as workers:
        assert workers.share(tasks, math.sqrt, away, str) == [str(x) for x in tasks]


def test_none_can_be_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system refuses a process, all is done here."""

    def refused(*_: object, **__: object) -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(subprocess, "Popen", refused)
    with Workers(2) as workers:
        for _ in range(10):
            assert workers.share([1.0, 2.0], math.sqrt, away, here) == ["here", "here"]


def test_cores() -> None:
    """At least the one that runs this."""
    assert cores() >= 1


def test_what_a_process_started_ends_with_it(tmp_path: Path) -> None:
    """Another process runs a program, as it runs FMUs; at Ctrl-C here the program ends, too: its pipe does."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    program = f"import time; pipe = open({str(pipe)!r}, 'w'); pipe.write('x'); pipe.flush(); time.sleep(3600)"
    opened = []

    def stop(_: Any) -> None:
        opened.append(open(pipe))
        assert opened[0].read(1) == "x"
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Counting() as workers:
        workers.share([[sys.executable, "-c", program]] * 2, subprocess.call, away, stop)
    assert opened[0].read() == ""
    opened[0].close()
