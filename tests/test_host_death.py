"""Where our own commands unpack FMUs, and what they say where the process that runs one dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fmu_src.importer.unpacking
from arterial_fmu.__main__ import app
from discrepancy import workflow
from fitting.check.fmu_run import RunFailed, periodic_answer, read_fmu
from fmu_src.importer import doctor
from fmu_src.importer.run import run_fmu
from fmu_src.importer.unpacking import places, undecoded, unpacking_folder
from solver.io.exit_codes import ExitCode, HostDied, ended
from solver.quantities.units import INFLOW

STRANGE = "Ärzte (a+b), ñ, 東京"


@pytest.fixture
def strange(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder that the wrapper does not survive."""
    folder = tmp_path / STRANGE
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", os.fspath(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


@pytest.fixture(scope="module")
def deadly(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that kills its host where it is instantiated, as the wrapper does in a folder that it does not find."""
    target = tmp_path_factory.mktemp("deadly") / "deadly.fmu"
    with zipfile.ZipFile(fmus["coarse sheep"]) as source, zipfile.ZipFile(target, "w") as copy:
        script = f"resources/{source.read('resources/slavemodule.txt').decode().strip()}.py"
        for name in source.namelist():
            text = source.read(name)
            killing = b"import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n"
            copy.writestr(name, killing + text if name == script else text)
    return target


def command(*words: str | Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "arterial_fmu", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, check=False)


# --- where to unpack ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_run_in_a_strange_folder(fmus: dict[str, Path], strange: Path, tmp_path: Path) -> None:
    """``run``, and what check, study and discover use, run where the wrapper alone crashes; nothing is left behind."""
    out = tmp_path / "out.csv"
    done = command("run", fmus["coarse sheep"], "--stop-time", "10 ms", "--out", out, "-q")
    assert (done.returncode, done.stderr) == (0, "")
    assert np.isfinite(run_fmu(fmus["coarse sheep"], None, 0.01, step=2e-3)["CA.P"]).all()
    beat = 1e-5 * np.sin(np.pi * np.arange(50) / 50) ** 2
    assert periodic_answer(read_fmu(fmus["coarse sheep"]), INFLOW, beat, 0.1, {}, beats=2).beats == 2
    assert list(strange.iterdir()) == []


def test_the_doctor_in_a_strange_folder(fmus: dict[str, Path], strange: Path) -> None:
    """The doctor's own step runs; it still tells that other hosts would crash there."""
    findings = {finding.what: finding for finding in doctor.examine(fmus["coarse sheep"])}
    assert findings["one step"].state == doctor.OK
    assert findings["temporary folder"].state == doctor.PROBLEM


def test_order(strange: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """TMPDIR, the system's folders, the home folder, the current one: the first that is plain and can be written."""
    monkeypatch.setenv("HOME", os.fspath(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    system = [Path("/tmp"), Path("/var/tmp")] if os.name == "posix" else []
    assert list(places()) == [strange, *system, tmp_path / "home", tmp_path]
    for plain in (tmp_path / "a b-._~9", tmp_path):
        plain.mkdir(exist_ok=True)
        monkeypatch.setenv("TMPDIR", os.fspath(plain))
        with unpacking_folder("fmu_") as folder:
            assert Path(folder).parent == plain
        assert not Path(folder).exists()
    monkeypatch.setattr(fmu_src.importer.unpacking, "places", lambda: iter([strange, tmp_path / "nowhere", tmp_path]))
    with unpacking_folder("fmu_") as folder:
        assert Path(folder).parent == tmp_path


def test_no_folder(strange: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nowhere: one sentence that names what was tried."""
    monkeypatch.setattr(fmu_src.importer.unpacking, "places", lambda: iter([strange]))
    with pytest.raises(ValueError, match=r"no folder to unpack the FMU into, among .*東京: .*; set TMPDIR to"):
        with unpacking_folder("fmu_"):
            pass


@pytest.mark.parametrize("letter", "()+,%#&'@!äß東\\\"")
def test_letters(letter: str) -> None:
    """What pathlib encodes in a URI the wrapper does not decode, but for blanks."""
    assert undecoded(f"/tmp/a{letter}b c") == letter


# --- death of a host ----------------------------------------------------------------------------------------------


def test_words() -> None:
    """Signals by number and name; else the exit code."""
    assert ended(-11) == "died of signal 11 (SIGSEGV)"
    assert ended(3) == "ended with exit code 3"
    assert ended(0xC0000005) == "ended with exit code 3221225477"


def test_run(deadly: Path, tmp_path: Path) -> None:
    """``run`` outlives its FMU: one sentence, exit code 1."""
    done = command("run", deadly, "--stop-time", "10 ms", "--out", tmp_path / "out.csv", "-q")
    assert done.returncode == ExitCode.DOES_NOT_RUN
    assert f"{deadly}: the process that ran it died of signal 11 (SIGSEGV); ask arterial-fmu doctor" in done.stderr
    assert done.stderr.count("\n") == 1 and not (tmp_path / "out.csv").exists()


def test_check_and_study(deadly: Path) -> None:
    """What check, calibrate, study and discover call tells the death, and not as a sentence of the FMU."""
    with pytest.raises(HostDied, match=r"deadly\.fmu: the process that ran it died of signal 11 \(SIGSEGV\)") as died:
        periodic_answer(read_fmu(deadly), INFLOW, np.ones(8), 0.1, {}, beats=2)
    assert not isinstance(died.value, RunFailed | ValueError)


def test_discover(deadly: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A death is no verdict on the record: exit code 1, and the sentence."""

    def dies(*_: object, **__: object) -> None:
        raise HostDied(deadly, -signal.SIGSEGV)

    monkeypatch.setattr(workflow, "discover", dies)
    record = tmp_path / "record.csv"
    record.touch()
    done = CliRunner().invoke(app, ["discover", os.fspath(record), "--model", "sheep", "--out", os.fspath(tmp_path)])
    assert done.exit_code == ExitCode.DOES_NOT_RUN
    assert "died of signal 11 (SIGSEGV)" in done.stderr and "cannot be used" not in done.stderr


def test_doctor(deadly: Path) -> None:
    """The doctor's trial names the signal."""
    finding = doctor._trial(deadly, sys.executable, "report it")
    assert (finding.state, finding.found) == (
        doctor.PROBLEM,
        "failed after load: the process died of signal 11 (SIGSEGV)",
    )


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_interrupted_run(fmus: dict[str, Path], tmp_path: Path) -> None:
    """Ctrl-C of ``run``, also where only the first process gets it: it ends, and there is no result."""
    line = [sys.executable, "-m", "arterial_fmu", "run", os.fspath(fmus["sheep"]), "--stop-time", "1000 s"]
    line += ["--out", os.fspath(tmp_path / "out.csv")]
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "sheep.fmu" not in process.stderr.readline():  # its progress, whichever line of it comes first
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        process.stderr.read()
        assert process.wait() != 0 and not (tmp_path / "out.csv").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="prctl")
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow), signal.SIGKILL]
)
def test_ended_run(fmus: dict[str, Path], tmp_path: Path, number: signal.Signals) -> None:
    """A run that is ended, or whose terminal is closed, takes the FMU's process and its folder along."""
    line = [sys.executable, "-m", "arterial_fmu", "run", os.fspath(fmus["sheep"]), "--stop-time", "1000 s"]
    line += ["--out", os.fspath(tmp_path / "out.csv")]
    environment = {**os.environ, "TMPDIR": os.fspath(tmp_path)}
    with subprocess.Popen(line, stderr=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stderr is not None
        while "sheep.fmu (" not in process.stderr.readline():  # it runs
            assert process.poll() is None
        process.send_signal(number)
        assert "Interrupted: nothing was written." in process.stderr.read()  # to the end, which both have to close
        assert process.wait() == (-number if number == signal.SIGKILL else 128 + number)
    assert list(tmp_path.iterdir()) == []
