"""Heart, arteries and body as one system: SSP and SSV that others read, and the same answers in three masters."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from commands import without_progress
from fmpy.ssp.ssd import read_ssd, read_ssv
from fmpy.validation import validate_fmu
from fmus import Store
from loops import loop
from pyssp_standard.ssp import SSP
from pyssp_standard.ssv import SSV
from test_clients import run_script
from typer.testing import CliRunner

import build_fmu
from arterial_fmu.cli.build import app as build_command
from build_fmu import build_system
from fmu_src.contents.models import body_model, heart_model
from fmu_src.contents.system import first_port, start_values
from solver import load
from solver.lumped.species import HUMAN_BODY, HUMAN_HEART

STEP, STEPS = 5e-3, 80
OUTPUTS = (
    "arteries.inlet.P",
    "arteries.AB2.P",
    "arteries.venous.V",
    "heart.aorta.Q",
    "heart.left_ventricle.V",
    "body.P",
)


@pytest.fixture(scope="module")
def ssp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The system of the human network."""
    return build_system(load("human"), "human", tmp_path_factory.mktemp("system"))


def read(ssp: Path, file: str) -> bytes:
    with zipfile.ZipFile(ssp) as archive:
        return archive.read(file)


# --- the archive --------------------------------------------------------------------------------------------------


def test_contents(ssp: Path, tmp_path: Path) -> None:
    """The structure, three FMUs and their parameters; the same bytes again, and all FMUs valid."""
    assert build_system(load("human"), "human", tmp_path / "again").read_bytes() == ssp.read_bytes()
    with zipfile.ZipFile(ssp) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path)
    fmus = {"resources/human.fmu", "resources/human_heart.fmu", "resources/human_body.fmu"}
    parameters = {f"resources/{name}.ssv" for name in ("heart", "arteries", "body")}
    assert names == {"SystemStructure.ssd", *fmus, *parameters}
    for fmu in fmus:
        assert validate_fmu(str(tmp_path / fmu)) == []


def test_follows_the_standard(ssp: Path, tmp_path: Path) -> None:
    """SSD and SSV are valid SSP 1.0 by the schemas of pyssp_standard and by FMPy's, and say what was meant."""
    with SSP(ssp, mode="r") as package, package.system_structure as structure:
        structure.__check_compliance__()
        assert {component.name for component in structure.system.elements} == {"heart", "arteries", "body"}
    starts = start_values(load("human"), HUMAN_HEART, HUMAN_BODY)
    starts["heart"] |= first_port(load("human"), starts["arteries"])
    for name in ("heart", "arteries", "body"):
        file = tmp_path / f"{name}.ssv"
        file.write_bytes(read(ssp, f"resources/{name}.ssv"))
        with SSV(file, mode="r") as parameters:
            parameters.__check_compliance__()
            assert parameters.version == "1.0"
        expected = starts[name]
        found = {p.name: float(p.value) for p in read_ssv(str(file)).parameters}
        assert found == {key: value for key, value in expected.items() if not isinstance(value, str)}
    assert read_ssd(str(ssp)).version == "1.0"
    experiment = ElementTree.fromstring(read(ssp, "SystemStructure.ssd")).find("{*}DefaultExperiment")
    assert experiment is not None and float(experiment.attrib["stopTime"]) == 10 * load("human").inlet.T


def test_connections(ssp: Path) -> None:
    """Every input of every component is connected once, to an output of the same unit."""
    units = {}
    inputs = set()
    with zipfile.ZipFile(ssp) as archive:
        for name, fmu in {"heart": "human_heart", "arteries": "human", "body": "human_body"}.items():
            description = fmpy.read_model_description(io.BytesIO(archive.read(f"resources/{fmu}.fmu")))
            units |= {(name, v.name): (v.causality, v.unit) for v in description.modelVariables}
            inputs |= {(name, v.name) for v in description.modelVariables if v.causality == "input"}
    ends = []
    for wire in read_ssd(str(ssp)).system.connections:
        start, end = (wire.startElement, wire.startConnector), (wire.endElement, wire.endConnector)
        assert units[start] == ("output", units[end][1])
        ends.append(end)
    assert sorted(ends) == sorted(inputs)


def test_start_values_are_inside_the_fmus(ssp: Path) -> None:
    """What libcosim cannot set, as it is an Enumeration, is what the FMU starts with."""
    for fmu, name, item in (("human", "inlet.interpolation", "smooth"), ("human_body", "body.exchange", "start")):
        with zipfile.ZipFile(io.BytesIO(read(ssp, f"resources/{fmu}.fmu"))) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        variable = next(v for v in root.iter("ScalarVariable") if v.attrib["name"] == name)
        kind = next(t for t in root.iter("SimpleType") if t.attrib["name"] == variable[0].attrib["declaredType"])
        items = {i.attrib["value"]: i.attrib["name"] for i in kind.iter("Item")}
        assert items[variable[0].attrib["start"]] == item


# --- the masters --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_same_as_in_python(ssp: Path, tmp_path: Path) -> None:
    """0.4 s with an ejection, in steps of 5 ms, in FMPy: as the components in Python, to 1e-11 of the range.

    FMPy sets every input to 0 before the first step; heart and arteries take that for nothing received.
    """
    expected = loop(load("human"), STEP, STEP * STEPS, parallel=True)
    job = {"ssp": os.fspath(ssp), "step": STEP, "steps": STEPS, "outputs": OUTPUTS}
    found = run_script("ssp_with_fmpy", json.dumps(job), tmp_path)
    assert found.shape == (STEPS, len(OUTPUTS))
    for i, name in enumerate(OUTPUTS):
        assert np.abs(found[:, i] - expected[name]).max() < 1e-11 * np.ptp(expected[name])


# --- the command and its failures ---------------------------------------------------------------------------------


def command(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, build_fmu.__file__, *arguments]
    return subprocess.run(line, capture_output=True, text=True, cwd=cwd, env={**os.environ, "COLUMNS": "80"})


@pytest.mark.slow
def test_commands(tmp_path: Path) -> None:
    """heart, body and system write their files and say so; --species sheep as well."""
    for arguments, file in (
        (["heart"], "human_heart.fmu"),
        (["body", "--species", "sheep"], "sheep_body.fmu"),
        (["system", "sheep", "--out", "dist"], "sheep.ssp"),
    ):
        done = command(*arguments, cwd=tmp_path)
        assert (done.returncode, without_progress(done.stderr)) == (0, "")
        assert re.fullmatch(rf"wrote dist/{re.escape(file)} \(\d+ kB\)\n", done.stdout)
    with zipfile.ZipFile(tmp_path / "dist" / "sheep.ssp") as archive:
        assert {"resources/sheep_heart.fmu", "resources/sheep_body.fmu"} <= set(archive.namelist())


def test_start_values_of_heart_and_body(tmp_path: Path) -> None:
    """--set with a unit, and an Enumeration by its name, stand in the description of a heart and a body."""
    for kind, text, name, start in (
        ("heart", "heart.rate=1.3 Hz", "heart.rate", "1.3"),
        ("body", "body.exchange=start", "body.exchange", "2"),
    ):
        done = CliRunner().invoke(build_command, [kind, "--set", text, "--out", os.fspath(tmp_path)])
        assert done.exit_code == 0, done.output
        with zipfile.ZipFile(tmp_path / f"human_{kind}.fmu") as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
        found = {v.attrib["name"]: v[0].get("start") for v in root.iter("ScalarVariable")}
        assert found[name] == start


def test_outlets_of_another_human() -> None:
    """The outlets are tuned to the heart in the bundled network human; another one of this name keeps its own."""
    human = load("human")
    other = replace(human, reference="measured by us")
    for network, changed in ((human, True), (other, False)):
        starts = start_values(network, HUMAN_HEART, HUMAN_BODY)["arteries"]
        assert any(name.endswith((".C", ".R2")) for name in starts) == changed


def test_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An unknown species or network and a directory that is a file give one sentence and exit code 2, and no file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("")
    for arguments, sentence in (
        (["heart", "--species", "cow"], r"species 'cow': there is none of this name; use one of human, sheep\."),
        (["system", "humn"], r"humn: neither a file nor a bundled network; .*"),
        (["body", "--out", "taken"], r"taken: is a file, not a folder; give another folder\."),
        (["heart", "--set", "heart.rate"], r"--set heart\.rate: must look like NAME=VALUE, .*"),
        (["system", "sheep_nonlinear"], r"network sheep_nonlinear: whose heart and body\? Say --species human or .*"),
    ):
        done = CliRunner().invoke(build_command, arguments)
        assert done.exit_code == 2
        assert re.fullmatch(f"Error: {sentence}\n", without_progress(done.stderr))
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_full_disk_leaves_the_old_system(ssp: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the last move fails, the file from before stays and nothing lies beside it."""
    old = tmp_path / "human.ssp"
    old.write_bytes(b"the system from before")
    real = os.replace

    def full(source: object, target: object) -> None:
        if str(target).endswith(".ssp"):
            raise OSError(28, "No space left on device")
        real(source, target)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(ValueError, match=r"human\.ssp: cannot be written \(No space left on device\); check"):
        build_system(load("human"), "human", tmp_path)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the system from before"]


def test_fmus_of_heart_and_body(stored: Store) -> None:
    """Both species are valid FMUs without the arteries' code, below 300 kB."""
    for species in ("human", "sheep"):
        for make in (heart_model, body_model):
            model, fmu = make(species), stored.lumped(make, species)
            assert validate_fmu(str(fmu)) == []
            assert fmu.stat().st_size < 300_000
            with zipfile.ZipFile(fmu) as archive:
                assert not [name for name in archive.namelist() if name.endswith(("network.py", "mesh.py"))]
                page = archive.read("documentation/index.html").decode()
            assert model.name in page and "Korakianitis" in page
