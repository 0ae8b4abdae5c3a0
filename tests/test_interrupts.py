"""Ctrl-C: every command ends with 130 and one sentence; its processes are gone, and nothing is half written.

Real signals, to commands in a terminal of their own: sent once the terminal shows what is being done.
"""

from __future__ import annotations

import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from fitting.cohort.virtual import virtual_cohort, write_cohort
from fitting.records.read.record import write_record
from solver import load, simulate_periodic
from solver.io.exit_codes import ExitCode
from solver.io.interrupts import interrupts_again, interrupts_later

ROOT = Path(__file__).resolve().parents[1]
MARK = "TEST_OF_INTERRUPTS"  # in the environment of all processes of a command


@pytest.fixture(scope="module")
def folder(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """sheep.fmu, a record of the network (ten beats, some noise), and those of a cohort."""
    folder = tmp_path_factory.mktemp("work")
    shutil.copy(fmus["sheep"], folder)
    beat = simulate_periodic(load("sheep"))
    time = 1e-3 * np.arange(5001)
    rng = np.random.default_rng(1)
    names = ("inlet.Q", "AA.P", "CA.P", "CA.R", "FA.P")
    channels = {n: np.interp(time % 0.5, beat.time - beat.time[0], beat[n]) for n in names}
    noisy = {n: x + 0.01 * np.std(x) * rng.standard_normal(len(x)) for n, x in channels.items()}
    write_record(folder / "sheep.csv", time, noisy)
    write_cohort(virtual_cohort(1, animals=2), folder / "cohort")
    return folder


# what is typed, and what the terminal shows when Ctrl-C comes; the last ones take longer
COMMANDS = {
    "run": ("run sheep.fmu --stop-time 1000s --out out/r.csv", "running"),
    "solve": ("solve sheep --duration 1000s --out out/r.csv", "simulating"),
    "build": ("build sheep --out out", "building"),
    "doctor": ("doctor sheep.fmu", "one step"),
    "virtual": ("virtual --animals 400 --out out", "virtual"),
    "check": ("check sheep_table1 sheep.fmu sheep.csv --out out", "running the FMU"),
    "fit": ("fit cohort/virtual-S01_AA.csv --site AA --h 0.38mm --bootstrap 100000 --out out/AA.json", "bootstrap"),
    "isolability": ("isolability sheep --channels AA.P --out out/p.json", "simulating"),
    "cohort": ("cohort cohort/cohort.csv --out out --jobs 2", "virtual-"),
    "calibrate": ("calibrate sheep.csv sheep --free all.E --starts 50 --jobs 2 --out out/s.json", "of 50 starts"),
    "discover": ("discover sheep.csv --model sheep.fmu --out out --jobs 2", "running the file"),
    "study": ("study sheep --vary all.E=0.8..1.2x --jobs 2 --out out", "parameter sets"),
}
SLOW = ("virtual", "check", "isolability", "cohort", "calibrate", "discover", "study")
KEPT = {"discover": {".state"}, "study": {"plan.json", "parts"}}  # with which the same command goes on


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in COMMANDS])
def test_interrupted(name: str, folder: Path) -> None:
    """130, one sentence, no traceback, no process of it, and no file but those with which it goes on."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    code, drawn = interrupted(*COMMANDS[name], folder)
    assert (code, drawn.count("Interrupted: ")) == (ExitCode.INTERRUPTED, 1), drawn
    assert "Traceback" not in drawn and "Exception" not in drawn
    assert {path.name for path in out.iterdir()} <= KEPT.get(name, set())
    assert gone(folder)


def interrupted(line: str, shown: str, folder: Path) -> tuple[int, str]:
    """Exit code of a command, and all that its terminal showed, where Ctrl-C came once it showed something."""
    main, side = pty.openpty()
    command = [sys.executable, "-m", "arterial_fmu", *line.split()]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "200", "PYTHONPATH": str(ROOT), MARK: str(folder)}
    drawn, sent = "", False
    with subprocess.Popen(command, stdout=side, stderr=side, env=environment, cwd=folder, start_new_session=True) as it:
        os.close(side)
        while chunk := _read(main):
            drawn += chunk.decode("utf-8", "replace")
            if shown in drawn and not sent:
                it.send_signal(signal.SIGINT)
                sent = True
    os.close(main)
    assert sent, drawn
    return it.returncode, drawn


def _read(terminal: int) -> bytes:
    """What was written; nothing once no process has the other side, which Linux says by an error."""
    try:
        return os.read(terminal, 65536)
    except OSError:
        return b""


def gone(folder: Path) -> bool:
    """Whether no process of the command is left; one that was killed may need a moment to end."""
    for _ in range(1000):
        if not any(_marked(process, folder) for process in Path("/proc").glob("[0-9]*")):
            return True
        time.sleep(0.01)
    return False


def _marked(process: Path, folder: Path) -> bool:
    try:
        return f"{MARK}={folder}".encode() in (process / "environ").read_bytes().split(b"\0")
    except OSError:
        return False


# --- in this process ------------------------------------------------------------------------------------------------


def test_interrupts_wait() -> None:
    """Within the block Ctrl-C does nothing until it is asked for, or the block ends; then the usual answer is back."""
    usual, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), interrupts_later() as due:
        due()
        signal.raise_signal(signal.SIGINT)
        done.append("after the signal")
        due()
        done.append("never")
    with pytest.raises(KeyboardInterrupt), interrupts_later():
        signal.raise_signal(signal.SIGINT)
        done.append("to the end")
    assert done == ["after the signal", "to the end"] and signal.getsignal(signal.SIGINT) is usual


def test_interrupts_that_were_lost() -> None:
    """A library that clears every error clears Ctrl-C; the next report raises it again. Without any, nothing is raised,
    and the usual answer is back."""
    usual, done = signal.getsignal(signal.SIGINT), []
    with pytest.raises(KeyboardInterrupt), interrupts_again() as due:
        due()
        try:
            signal.raise_signal(signal.SIGINT)
        except:  # noqa: E722
            done.append("lost")
        due()
        done.append("never")
    with pytest.raises(KeyboardInterrupt), interrupts_again():
        signal.raise_signal(signal.SIGINT)
        done.append("never")
    assert done == ["lost"] and signal.getsignal(signal.SIGINT) is usual


def test_an_answer_of_a_host_is_its_own() -> None:
    """A host that answers Ctrl-C by itself, without an exception, is asked once."""
    usual, asked = signal.getsignal(signal.SIGINT), []
    signal.signal(signal.SIGINT, lambda *signalled: asked.append(signalled))
    try:
        with interrupts_again() as due:
            signal.raise_signal(signal.SIGINT)
            due()
            due()
    finally:
        signal.signal(signal.SIGINT, usual)
    assert len(asked) == 1


def test_interrupts_elsewhere() -> None:
    """In another thread, where no signal comes, the block is as any other."""

    def work() -> str:
        with interrupts_later() as due, interrupts_again() as lost:
            due()
            lost()
        return "done"

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(work).result() == "done"
