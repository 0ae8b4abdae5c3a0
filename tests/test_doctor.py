"""The doctor: what it finds in whole, damaged and foreign files, and in a Python or a folder that lacks something."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from c_host import CHost, unpack
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from fmu_src.importer import doctor
from fmu_src.importer.doctor import EXIT, FATAL, NOTE, OK, PROBLEM, Finding, examine, state


def found(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.what: finding for finding in findings}


def rewritten(fmu: Path, target: Path, change: Callable[[str, bytes], bytes | None]) -> Path:
    """A copy of an FMU with each file changed; None leaves one out."""
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as copy:
        for name in source.namelist():
            content = change(name, source.read(name))
            if content is not None:
                copy.writestr(name, content)
    return target


@pytest.fixture(scope="module")
def whole(fmus: dict[str, Path]) -> list[Finding]:
    """What is found of a whole FMU."""
    return examine(fmus["sheep"])


def test_healthy(fmus: dict[str, Path], whole: list[Finding]) -> None:
    """A whole FMU in the Python of this project: no problem, exit code 0, and every line of the table says ok."""
    done = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["doctor", os.fspath(fmus["sheep"])])
    assert done.exit_code == 0, done.output
    assert "PROBLEM" not in done.output.upper()
    findings = found(whole)
    assert {finding.state for finding in findings.values()} <= {OK, NOTE}
    assert findings["one step"].found == "loaded, initialized, stepped, read, freed"
    assert sys.executable in findings["Python"].found


@pytest.mark.parametrize("columns", ["40"])
def test_the_command_line_can_be_copied(fmus: dict[str, Path], whole: list[Finding], columns: str) -> None:
    """In a narrow terminal the command stands below the table on one line, as it is in the findings."""
    command = found(whole)["hosts in C, C++, …"].remedy.removeprefix("start them with: ")
    done = CliRunner(env={"COLUMNS": columns}).invoke(app, ["doctor", os.fspath(fmus["sheep"])])
    assert f"Start hosts in C, C++, … with: {command}" in done.output.splitlines()


def test_as_json(fmus: dict[str, Path], tmp_path: Path) -> None:
    """--json gives the same findings to programs."""
    done = CliRunner().invoke(app, ["doctor", os.fspath(tmp_path / "nothing.fmu"), "--json"])
    assert done.exit_code == EXIT[FATAL] == 2
    (finding,) = json.loads(done.stdout)["findings"]
    assert finding["found"] == "there is no such file"
    assert json.loads(done.stdout)["state"] == FATAL


def test_the_command_line_works(fmus: dict[str, Path], c_host: CHost, tmp_path: Path) -> None:
    """What the doctor prints for hosts that are not Python starts one in an empty environment."""
    findings = examine(fmus["coarse sheep"])
    if state(findings) == PROBLEM:
        pytest.skip("no FMU runs on this machine")
    line = found(findings)["hosts in C, C++, …"].remedy.removeprefix("start them with: ")
    fmu = unpack(fmus["coarse sheep"], tmp_path)
    commands = [f"library 0 {fmu.library}", fmu.instantiate(0), "setup 0 0 1", "enter 0", "exit 0", "step 0 0 0.01"]
    done = subprocess.run(
        ["sh", "-c", line.replace("HOST", os.fspath(c_host.program))],
        input="\n".join([*commands, "free 0", ""]),
        capture_output=True,
        text=True,
        env={"PATH": "/usr/bin:/bin"},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert [answer.split()[0] for answer in done.stdout.splitlines()] == ["ok"] * 7


# --- files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "what", "said"),
    [
        (lambda name, text: None if name.endswith("scheme/stage.py") else text, "contents", "stage.py is missing"),
        (
            lambda name, text: None if name.endswith("slavemodule.txt") else text,
            "contents",
            "is not an FMU of this project",
        ),
        (lambda name, text: text.replace(b"0.00038", b"0.00039"), "contents", "changed after the FMU was built"),
        (lambda name, text: None if name.endswith("network.json") else text, "contents", "changed after the FMU was"),
        (
            lambda name, text: b"1 +" if name.endswith("base.py") else text,
            "contents",
            "changed after the FMU was built",
        ),
        (lambda name, text: None if name == "modelDescription.xml" else text, "file", "no modelDescription.xml"),
        (lambda name, text: text[:-9] if name == "modelDescription.xml" else text, "file", "xml is damaged"),
        (lambda name, text: text.replace(b'guid="{', b'guid="{0'), "contents", "changed after the FMU was built"),
        (lambda name, text: text.replace(b'"UTF-8"', b'"bTF-8"'), "file", "unknown encoding"),
        (
            lambda name, text: text.replace(b'Version="2.0"', b'Version="1.0"'),
            "file",
            "is not an FMU for co-simulation",
        ),
        (lambda name, text: text.replace(b"arterial_", b"venous_"), "contents", "is not an FMU of this project"),
        (lambda name, text: None if name.startswith("binaries") else text, "binary", "is missing (there is none)"),
        (lambda name, text: b"" if name.endswith("sheep.so") else text, "one step", "failed"),
    ],
)
def test_incomplete(
    fmus: dict[str, Path], tmp_path: Path, change: Callable[[str, bytes], bytes | None], what: str, said: str
) -> None:
    """A file that is missing or damaged is named; nothing is run of an archive that is not whole."""
    findings = examine(rewritten(fmus["sheep"], tmp_path / "sheep.fmu", change))
    assert said in found(findings)[what].found
    # of an FMU of another program, which needs no Python, nothing else is told
    assert said != "is not an FMU of this project" or [f.what for f in findings] == ["file", "contents"]
    assert state(findings) == (FATAL if what in ("file", "contents") else PROBLEM)
    assert ("one step" in found(findings)) == (state(findings) == PROBLEM)


def test_folder_and_outsiders(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A folder, an archive that would write elsewhere, and one that would fill the disk are refused."""
    assert state(examine(tmp_path)) == FATAL
    assert examine(tmp_path)[0].found == "is a folder"
    for i, (name, size) in enumerate([("../outside.txt", 1), ("/outside.txt", 1), ("large.bin", 201_000_000)]):
        archive = rewritten(fmus["sheep"], tmp_path / f"{i}.fmu", lambda _, content: content)
        with zipfile.ZipFile(archive, "a", zipfile.ZIP_DEFLATED) as file:
            file.writestr(name, b"0" * size)
        (finding,) = examine(archive)
        assert finding.state == FATAL


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(data=st.data())
def test_any_file(fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: st.DataObject) -> None:
    """Cut off, with bytes changed, or nothing but noise: a finding, never an exception."""
    monkeypatch.setattr(doctor, "_trial", lambda *_: Finding("one step", OK, "not run"))
    content = bytearray(fmus["sheep"].read_bytes())
    kind = data.draw(st.sampled_from(["cut", "bytes", "tail", "noise"]))
    if kind == "cut":
        del content[data.draw(st.integers(0, len(content))) :]
    elif kind == "noise":
        content = bytearray(data.draw(st.binary(max_size=200)))
    else:  # the archive's list of files is at its end
        first = len(content) - 6000 if kind == "tail" else 0
        for _ in range(data.draw(st.integers(1, 5))):
            content[data.draw(st.integers(first, len(content) - 1))] = data.draw(st.integers(0, 255))
    file = tmp_path / "any.fmu"
    file.write_bytes(content)
    findings = examine(file)
    assert state(findings) in EXIT
    assert all(finding.what and finding.found for finding in findings)


# --- the machine ----------------------------------------------------------------------------------------------------


def test_no_numpy(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A Python without numpy: the doctor says so, and how to install it; exit code 1."""
    bare = tmp_path / "bare"
    bare.write_text(f'#!/bin/sh\nexec "{sys.executable}" -S "$@"\n')  # -S: without the installed packages
    bare.chmod(0o755)
    done = CliRunner(env={"COLUMNS": "300"}).invoke(app, ["doctor", os.fspath(fmus["sheep"]), "--python", str(bare)])
    assert done.exit_code == EXIT[PROBLEM] == 1
    assert "No module named 'numpy'" in done.output
    assert "-m pip install numpy" in done.output
    assert "numpy" in found(examine(fmus["sheep"], str(bare)))["one step"].found


@pytest.mark.parametrize("python", ["nothing-like-python", "ls"])
def test_no_python(fmus: dict[str, Path], python: str) -> None:
    """What is no Python is refused with one sentence."""
    finding = found(examine(fmus["sheep"], python))["Python"]
    assert finding.state == PROBLEM
    assert python in finding.found


def test_unfit_temporary_folder(fmus: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hosts unpack into the temporary folder; the wrapper crashes where its path must be encoded. Ours do not."""
    strange = tmp_path / "a (b)"
    strange.mkdir()
    monkeypatch.setenv("TMPDIR", os.fspath(strange))
    monkeypatch.setattr(tempfile, "tempdir", None)
    findings = found(examine(fmus["sheep"]))
    assert "holds (): hosts crash" in findings["temporary folder"].found
    assert findings["one step"].state == OK
    monkeypatch.setenv("TMPDIR", os.fspath(tmp_path / "nowhere"))
    assert "nowhere cannot be written" in found(examine(fmus["sheep"]))["temporary folder"].found
