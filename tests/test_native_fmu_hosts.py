"""The FMU that needs no Python in hosts that have none, and every bad input to it: a status, a sentence, no crash."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from ctypes import CDLL
from pathlib import Path

import native_fuzz
import numpy as np
import pytest
from c_host import CHost, Unpacked, unpack
from fmpy import simulate_fmu
from fmpy.fmi2 import fmi2Discard, fmi2Error
from fmus import COARSE, Store
from native_fmus import needs_compiler
from test_fmu_bad_input import BAD, HOST, sentence_of_the_solver

from build_fmu import build_native, build_native_model
from fmu_src.contents.models import FMUContents, body_model, heart_model
from solver import Network, load

pytestmark = needs_compiler
BARE = {"PATH": "/nonexistent", "LD_PRELOAD": ""}  # no Python anywhere


@pytest.fixture(scope="module")
def native(stored: Store) -> Path:
    return stored(build_native, load("sheep"), fmi=2)


@pytest.fixture(scope="module")
def coarse(stored: Store, tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(stored(build_native, load("sheep"), settings=COARSE), tmp_path_factory.mktemp("coarse"))


@pytest.fixture(scope="module")
def body(stored: Store, tmp_path_factory: pytest.TempPathFactory) -> Unpacked:
    return unpack(stored.lumped(body_model, fmi=2), tmp_path_factory.mktemp("body") / "fmu")


def run(fmu: Unpacked, uri: str | None = None, h: float = 2e-3) -> list[str]:
    """The commands of a few steps."""
    Q = fmu.references["inlet.Q"]
    steps = [c for k in range(20) for c in (f"setReal 0 {Q} {(k + 1) * 1e-6!r}", f"step 0 {k * h!r} {h!r}")]
    read = "getReal 0 " + " ".join(str(fmu.references[name]) for name in fmu.outputs)
    begun = [f"library 0 {fmu.library}", fmu.instantiate(0, uri=uri), "setup 0 0 10", "enter 0", "exit 0"]
    return [*begun, *steps, read, "free 0"]


def test_a_host_without_python(c_host: CHost, coarse: Unpacked) -> None:
    """A host in C with no Python on its path: every step done, nothing logged, all outputs read."""
    done = c_host.run(run(coarse), BARE)
    assert (done.code, done.errors) == (0, "")
    assert [(a.status, a.log) for a in done.answers] == [("ok", ())] * len(done.answers)
    assert len(done[-2].values) == len(coarse.outputs) and abs(done[-2].values[0]) > 1.0


FOLDERS = ["plain", "with blanks", "(parentheses)+", "Ärterie 動脈", "100%", "a%41b"]


@pytest.mark.parametrize("name", FOLDERS)
def test_paths(c_host: CHost, coarse: Unpacked, tmp_path: Path, name: str) -> None:
    """Resources in folders of any name, by URI with one or three slashes, by plain path: the same numbers."""
    folder = Path(shutil.copytree(coarse.folder / "resources", tmp_path / name))
    expected = c_host.run(run(coarse), BARE)[-2].values
    uri = folder.as_uri()
    spellings = [uri, uri.replace("file:///", "file:/"), uri.replace("file://", "file://localhost")]
    for spelling in [*spellings, *([] if " " in name else [os.fspath(folder), f"{folder}/"])]:
        done = c_host.run(run(coarse, spelling), BARE)
        assert done.code == 0, spelling
        assert done[-2].values == expected, spelling


DAMAGED = "error logStatusError checked: arterial.bin: damaged, or of another version of this FMU; build the FMU anew."


def test_wrong_resources(c_host: CHost, coarse: Unpacked, tmp_path: Path) -> None:
    """None, cut and changed ones, and another GUID: no instance, and one line that says why."""
    whole = (coarse.folder / "resources" / "arterial.bin").read_bytes()
    cases = {f"cut to {n}": whole[:n] for n in (0, 1, 7, 8, 100, 1000, len(whole) // 2, len(whole) - 8, len(whole) - 1)}
    cases |= {
        f"changed at {n}": whole[:n] + bytes([whole[n] ^ 1]) + whole[n + 1 :] for n in (0, 9, 20, 40, 900, 300000)
    }
    for name, content in cases.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "arterial.bin").write_bytes(content)
        done = c_host.run([f"library 0 {coarse.library}", coarse.instantiate(0, uri=(tmp_path / name).as_uri())], BARE)
        assert (done.code, done[1].status) == (0, "null"), name
        assert done[1].log == (DAMAGED,), name
    none = c_host.run([f"library 0 {coarse.library}", coarse.instantiate(0, uri="file:///none")], BARE)
    assert none[1].status == "null" and "/none/arterial.bin: cannot be read" in none[1].log[0]
    another = f"instantiate 0 0 1 {{0}} {coarse.folder.as_uri()}/resources"
    other = c_host.run([f"library 0 {coarse.library}", another], BARE)
    assert other[1].status == "null" and "the GUID {0} is not that of this FMU" in other[1].log[0]


def test_states_that_are_none(c_host: CHost, coarse: Unpacked, tmp_path: Path) -> None:
    """A null state, one that was freed, one of another instance: refused, and the host lives; so are functions that
    are not supported."""
    Q = coarse.references["inlet.Q"]
    done = c_host.run(
        [f"library 0 {coarse.library}", coarse.instantiate(0), coarse.instantiate(1), "save 0 5", "restoreNothing 0",
         "restore 1 5", f"write 1 5 {tmp_path / 'none'}", "forget 1 5",
         f"directional 0 {Q} {Q}", f"derivatives 0 {Q} 1 1",
         f"write 0 5 {tmp_path / 'bytes'}", f"read 1 6 {tmp_path / 'bytes'}",
         "restore 1 6", "forget 0 5", "free 0", "free 1"],
        BARE,
    )  # fmt: skip
    assert (done.code, done.errors) == (0, "")
    assert [a.status for a in done.answers[3:]] == ["ok", *["error"] * 6, *["ok"] * 6]
    for k in (4, 5, 6, 7):
        assert "the state is not one of this instance" in done[k].log[0]
    assert "directional derivatives are those of the last step" in done[8].log[0]
    assert "FMI function not supported" in done[9].log[0]


# --- what pythonfmu's wrapper does wrong (tests/test_wrapper_faults.py), and these FMUs do not ------------------------


@pytest.mark.parametrize("end", ["", "free 0,free 1", "free 1,free 0", "free 0", "free 0,free 1,close 1,close 0"])
def test_two_fmus_end_well(c_host: CHost, coarse: Unpacked, body: Unpacked, end: str) -> None:
    """A host that ran two FMUs ends with code 0, in whichever order it frees them, or not at all."""
    commands = []
    for i, fmu in enumerate((coarse, body)):
        commands += [f"library {i} {fmu.library}", fmu.instantiate(i, i)]
    for i in (0, 1):
        commands += [f"setup {i} 0 1", f"enter {i}", f"exit {i}", f"step {i} 0 0.002"]
    done = c_host.run([*commands, *filter(None, end.split(","))], BARE)
    assert (done.code, done.errors) == (0, "")
    assert {answer.status for answer in done.answers} == {"ok"}


def test_interrupt_ends_the_host(c_host: CHost, coarse: Unpacked) -> None:
    """Ctrl-C ends a host that does not treat it."""
    lines = [f"library 0 {coarse.library}", coarse.instantiate(0), "wait 60", ""]
    with subprocess.Popen([c_host.program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=BARE) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write("\n".join(lines).encode())
        process.stdin.flush()
        assert [process.stdout.readline()[:2] for _ in range(2)] == [b"ok", b"ok"]
        process.send_signal(signal.SIGINT)
    assert process.returncode == -signal.SIGINT


FAULTS = {
    "text that is not UTF-8": ("setString 0 {E} \udcff\udcfe", "CA.E is a Real variable; read and set it as such."),
    "a category that is not UTF-8": ("logging 0 1 \udcff", "there is none of this name."),
    "null state, written": ("write 0 7 state.bin", "the state is not one of this instance"),
    "null state, restored": ("restoreNothing 0", "the state is not one of this instance"),
    "reason of a failure with categories": ("getReal 0 9999", "value reference 9999: there is no such variable."),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_calls_that_kill_other_hosts(c_host: CHost, coarse: Unpacked, tmp_path: Path, fault: str) -> None:
    """An error with its reason, also where the host has chosen categories; the next call is right."""
    call, reason = FAULTS[fault]
    E = coarse.references["CA.E"]
    begun = [f"library 0 {coarse.library}", coarse.instantiate(0), "logging 0 1 logStatusError"]
    done = c_host.run([*begun, call.format(E=E), f"getReal 0 {E}", "free 0"], BARE, cwd=tmp_path)
    assert (done.code, done.errors) == (0, "")
    assert [answer.status for answer in done.answers[2:]] == ["ok", "error", "ok", "ok"]
    assert len(done[3].log) == 1 and reason in done[3].log[0]


def test_a_logger_that_calls_back(c_host: CHost, coarse: Unpacked) -> None:
    """FMI forbids it; the value is the right one, and the instance continues."""
    E = coarse.references["CA.E"]
    begun = [f"library 0 {coarse.library}", coarse.instantiate(0), f"getReal 0 {E}", f"ask 0 {E}"]
    done = c_host.run([*begun, "getReal 0 9999", f"getReal 0 {E}", "free 0"], BARE)
    assert (done.code, done.errors) == (0, "")
    assert [answer.status for answer in done.answers] == ["ok", "ok", "ok", "ok", "error", "ok", "ok"]
    assert "value reference 9999" in done[4].log[0]
    assert done[4].log[1] == f"ok asked {done[2].rest}"
    assert done[5].rest == done[2].rest


@pytest.mark.parametrize("fmi", [2, 3])
def test_every_function_is_exported(coarse: Unpacked, fmi: int) -> None:
    """All functions that the headers of the standard declare, as FMPy brings them; those of model exchange, too."""
    names, library = native_fuzz.functions(fmi), CDLL(os.fspath(coarse.library))
    assert len(names) > 40 and [name for name in sorted(names) if not hasattr(library, name)] == []


def test_logging(c_host: CHost, coarse: Unpacked) -> None:
    """Without logging a refusal is a status alone; categories choose; an unknown one is refused; % is no format."""
    E = coarse.references["CA.E"]
    lines = [f"library 0 {coarse.library}", coarse.instantiate(0).replace("instantiate 0 0 1", "instantiate 0 0 0"),
             f"setReal 0 {E} -1", "logging 0 1 logStatusWarning", f"setReal 0 {E} -1", "logging 0 1 logStatusError",
             f"setReal 0 {E} -1", "logging 0 1 no%such"]  # fmt: skip
    done = c_host.run(lines, BARE)
    assert [len(a.log) for a in done.answers] == [0, 0, 0, 0, 0, 0, 1, 1]
    assert done[7].log[0].endswith("log category no%such: there is none of this name.")


@pytest.mark.parametrize("case", BAD)
def test_bad_input(answers: dict[str, dict[str, object]], sheep: Network, case: str) -> None:
    """The sentences of the other FMU, as an error instead of fatal; the instance and the next one are as ever. A step
    in the wrong phase is an error, too: nothing of it may be tried again."""
    report = answers[case]
    sentence = BAD[case][2]
    stepping = BAD[case][1][-1][0] == "step" and "in phase" not in sentence
    assert report["early"] == []
    assert report["status"] == (fmi2Discard if stepping else fmi2Error)
    expected = sentence if sentence.endswith(".") else sentence_of_the_solver(case, sheep)
    assert report["log"] == [f"sheep: {expected}"]
    assert report["reset"] == report["next"] == answers["without logging"]["reset"]


def test_fmpy_ends_at_a_step_that_fails(native: Path) -> None:
    """FMPy asks, after a discarded step, whether the FMU ends there: a shortened result, as of the other FMU. It would
    repeat the step for ever if the answer were no."""
    t = np.linspace(0.0, 0.2, 201)
    inflow = np.zeros(len(t), dtype=[("time", float), ("inlet.Q", float)])
    inflow["time"], inflow["inlet.Q"] = t, 5e-3 * np.sin(4 * np.pi * t)  # supercritical from 0.055 s on
    left = iter(range(500))
    result = simulate_fmu(
        os.fspath(native), stop_time=0.2, output_interval=1e-3, input=inflow,
        step_finished=lambda time, recorder: next(left, None) is not None,
    )  # fmt: skip
    assert next(left, None) is not None, "the host was stopped, not the simulation"
    assert 0.03 < result["time"][-1] < 0.1


@pytest.fixture(scope="module")
def answers(native: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, object]]:
    """What each bad input gave, in one process that goes through all."""
    folder = tmp_path_factory.mktemp("host")
    (folder / "host.py").write_text(HOST)
    cases = [[name, moment, actions] for name, (moment, actions, _) in BAD.items()]
    cases.append(["without logging", *BAD["out of range"][:2]])
    line = [sys.executable, "host.py", os.fspath(native), os.fspath(folder)]
    done = subprocess.run(line, input=json.dumps(cases), capture_output=True, text=True, cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    return {report["case"]: report for report in map(json.loads, done.stdout.splitlines())}


# --- sanitizers ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="module", params=[2, 3])
def fuzz(request: pytest.FixtureRequest, hosts: Path) -> tuple[int, Path]:
    """A version of FMI, and its fuzzing host with the FMU's sources in it."""
    try:
        return request.param, native_fuzz.compiled(request.param, hosts)
    except native_fuzz.NoSanitizers as reason:
        pytest.skip(str(reason))


def survives(fuzz: tuple[int, Path], fmu: Path, folder: Path, seed: int) -> None:
    """20 000 random calls to three instances: no report of the sanitizers, and steps and derivatives among what
    succeeded."""
    counts, report = native_fuzz.run(fuzz[1], unpack(fmu, folder).folder, seed, 20_000)
    assert counts is not None and report == ""
    assert counts.fine > 4_000 and counts.steps > 400 and counts.derived > 20 and counts.lines > 4_000


@pytest.mark.parametrize("fmi", [2, 3])
def test_every_function_is_called(fmi: int) -> None:
    """The fuzzing hosts call all functions of the standard."""
    assert native_fuzz.called(fmi) == native_fuzz.functions(fmi)


@pytest.mark.slow
@pytest.mark.parametrize("make", [heart_model, body_model])
def test_random_calls_of_hearts_and_bodies(
    fuzz: tuple[int, Path], tmp_path: Path, make: Callable[..., FMUContents]
) -> None:
    fmu = build_native_model(make("human", None, fuzz[0]), tmp_path)
    survives(fuzz, fmu, tmp_path / "fmu", 1)


def survives_random_calls(fuzz: tuple[int, Path], stored: Store, folder: Path, seed: int) -> None:
    survives(fuzz, stored(build_native, load("sheep"), settings=COARSE, fmi=fuzz[0]), folder, seed)


@pytest.mark.slow
def test_random_calls(fuzz: tuple[int, Path], stored: Store, tmp_path: Path) -> None:
    survives_random_calls(fuzz, stored, tmp_path, 1)


@pytest.mark.endurance
def test_further_random_calls(fuzz: tuple[int, Path], stored: Store, tmp_path: Path, further_seed: int) -> None:
    survives_random_calls(fuzz, stored, tmp_path, further_seed)
