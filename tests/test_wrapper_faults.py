"""What pythonfmu's wrapper does wrong, seen from a host in C: what an FMU mends, and what docs/simulators.md lists.

The second kind is tested as it is, so that the list stays true: where a newer wrapper is better, a test here fails.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import quote

import pytest
from c_host import CHost, Unpacked, unpack

from fmu_src.importer import doctor, trial

CRASH = -signal.SIGSEGV
ENCODED = "!\"#$%&'()*+,:;<=>?@[\\]^`{|}é心"  # characters that a URI holds encoded, or that hosts encode


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def sheep_fmu(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(fmus["sheep"], tmp_path_factory.mktemp("sheep"))


@pytest.fixture(scope="module")
def mixed_fmu(fmus: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(fmus["mixed"], tmp_path_factory.mktemp("mixed"))


# --- mended by the FMU ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("end", ["", "free 0,free 1", "free 1,free 0", "free 0", "free 0,free 1,close 1,close 0"])
def test_two_fmus_end_well(c_host: CHost, sheep_fmu: Unpacked, mixed_fmu: Unpacked, end: str) -> None:
    """A host that ran two FMUs ends with code 0, in whichever order it frees them, or not at all (upstream #228)."""
    commands = []
    for i, fmu in enumerate((sheep_fmu, mixed_fmu)):
        commands += [f"library {i} {fmu.library}", fmu.instantiate(i, i)]
    for i in (0, 1):
        commands += [f"setup {i} 0 1", f"enter {i}", f"exit {i}", f"step {i} 0 0.001"]
    run = c_host.run([*commands, *filter(None, end.split(","))])
    assert (run.code, run.errors) == (0, "")
    assert {answer.status for answer in run.answers} == {"ok"}


def test_a_host_in_python_that_keeps_the_library_ends_well(sheep_fmu: Unpacked) -> None:
    """Without the mend, a process that ends with the library loaded is aborted."""
    line = [sys.executable, os.fspath(trial.__file__), os.fspath(sheep_fmu.folder)]
    done = subprocess.run(line, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == '{"done": "free"}'


def test_interrupt_ends_the_host(c_host: CHost, sheep_fmu: Unpacked) -> None:
    """Ctrl-C ends a host that does not treat it, also after the wrapper has started Python in it."""
    process = subprocess.Popen(
        [c_host.program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=c_host.environment()
    )
    assert process.stdin is not None and process.stdout is not None
    with process:
        process.stdin.write(f"library 0 {sheep_fmu.library}\n{sheep_fmu.instantiate(0)}\nwait 60\n".encode())
        process.stdin.flush()
        assert [process.stdout.readline()[:2] for _ in range(2)] == [b"ok", b"ok"]
        time.sleep(0.1)  # it may come before the host waits: the outcome is the same
        process.send_signal(signal.SIGINT)
    assert process.returncode == -signal.SIGINT


# --- as it is -------------------------------------------------------------------------------------------------------


def test_places_that_crash(c_host: CHost, sheep_fmu: Unpacked, tmp_path: Path) -> None:
    """The wrapper decodes blanks of a resource URI and nothing else: it crashes where it does not find its files.

    The same place not encoded, as no standard has it, is found. The doctor names the same characters.
    """
    strange = tmp_path / f"a b{ENCODED}".replace("/", "")
    shutil.copytree(sheep_fmu.folder / "resources", strange / "resources")
    plain = tmp_path / "a b-._~"
    shutil.copytree(sheep_fmu.folder / "resources", plain / "resources")
    library = f"library 0 {sheep_fmu.library}"

    def ends(uri: str) -> int:
        return c_host.run([library, sheep_fmu.instantiate(0, uri=uri)]).code

    assert ends((plain / "resources").as_uri()) == 0
    assert ends(f"file://{strange}/resources".replace(" ", "%20")) == 0
    for letter in ENCODED:
        assert doctor.undecoded(f"/tmp/a{letter}b") == letter
    for letter in ("(", "é"):
        assert ends(f"file://{tmp_path}/a{quote(letter)}b/resources") == CRASH
    for host in ("file:", "file://localhost"):
        assert ends(f"{host}{sheep_fmu.folder}/resources") == CRASH


def test_reason_of_fatal_is_lost_with_categories(c_host: CHost, sheep_fmu: Unpacked) -> None:
    """Messages of a status fatal have a null category: they come only where no category is chosen."""
    commands = [f"library 0 {sheep_fmu.library}", sheep_fmu.instantiate(0), "logging 0 1 logStatusFatal logAll"]
    run = c_host.run([*commands, "getReal 0 9999", "logging 0 1", "getReal 0 9999", "free 0"])
    assert [answer.status for answer in run.answers] == ["ok", "ok", "ok", "fatal", "ok", "fatal", "ok"]
    assert run[3].log == ()
    assert run[5].log[0].startswith("fatal - ")  # "-" is a null pointer
    assert "value reference 9999: there is no such variable." in run[5].log[0]


def test_what_the_wrapper_does_not_offer(c_host: CHost, sheep_fmu: Unpacked) -> None:
    """Derivatives of inputs and directional derivatives: refused with a sentence, and nothing breaks."""
    reference = sheep_fmu.references["inlet.Q"]
    commands = [f"library 0 {sheep_fmu.library}", sheep_fmu.instantiate(0), "setup 0 0 1", "enter 0", "exit 0"]
    commands += [f"derivatives 0 {reference} 1 1e-3", f"directional 0 {sheep_fmu.references['inlet.P']} {reference}"]
    run = c_host.run([*commands, "step 0 0 0.001", "free 0"])
    assert run.code == 0
    assert [answer.status for answer in run.answers[-4:]] == ["error", "error", "ok", "ok"]
    assert run[5].log == ("error cppfmu FMI function not supported: fmi2SetRealInputDerivatives",)
    assert run[6].log == ("error cppfmu FMI function not supported: fmi2GetDirectionalDerivative",)


@pytest.mark.parametrize("call", ["write 0 7 state.bin", "restoreNothing 0"])
def test_calls_that_kill_the_host(c_host: CHost, sheep_fmu: Unpacked, tmp_path: Path, call: str) -> None:
    """A null state, to restore or to write."""
    commands = [f"library 0 {sheep_fmu.library}", sheep_fmu.instantiate(0), call, "getReal 0 0"]
    assert c_host.run(commands, cwd=tmp_path).code == CRASH


def test_text_that_is_not_utf_8(c_host: CHost, sheep_fmu: Unpacked, tmp_path: Path) -> None:
    """The wrapper puts a null pointer in a list of Python, which has no defined outcome: most runs kill the host, in
    some the slave is lost and the next call fails. None goes on as if nothing had happened."""
    commands = [f"library 0 {sheep_fmu.library}", sheep_fmu.instantiate(0), "setString 0 0 \udcff\udcfe", "getReal 0 0"]
    run = c_host.run(commands, cwd=tmp_path)
    assert run.code == CRASH or run.answers[-1].status != "ok"
