"""Building an FMU: the archive, its names and hashes, the documents in it, and every way in which it can fail."""

from __future__ import annotations

import builtins
import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from commands import without_progress
from drawn import TUBE
from fmpy.validation import validate_fmu
from typer.testing import CliRunner

from arterial_fmu.cli.build import app
from build_fmu import build
from fmu_src.documents import drawing
from solver import Network, Settings
from solver.network.files import loads

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def fmu(fmus: dict[str, Path]) -> Path:
    return fmus["sheep"]


def read(fmu: Path, file: str) -> str:
    with zipfile.ZipFile(fmu) as archive:
        return archive.read(file).decode()


def guid(fmu: Path) -> str:
    return ElementTree.fromstring(read(fmu, "modelDescription.xml")).attrib["guid"]


# --- the archive --------------------------------------------------------------------------------------------------


def test_same_input_same_bytes(fmu: Path, sheep: Network, tmp_path: Path) -> None:
    """Two builds of one network are one file, byte for byte, in this process and in another one."""
    assert build(sheep, tmp_path / "again").read_bytes() == fmu.read_bytes()
    code = "import sys, build_fmu, solver; build_fmu.build(solver.load('sheep'), sys.argv[1])"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo"}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "other")], check=True, env=environment, cwd=tmp_path)
    assert (tmp_path / "other" / "sheep.fmu").read_bytes() == fmu.read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        lambda n, to: build(n.with_parameters({"CA.E": np.nextafter(n.segment("CA").E, np.inf)}), to),
        lambda n, to: build(replace(n, elastic_law="regression"), to),
        lambda n, to: build(n, to, Settings(dt=2e-3)),
        lambda n, to: build(n, to, Settings(tolerance=1e-5)),
        lambda n, to: build(n, to, execution_tool=False),
    ],
    ids=["value", "law", "dt", "tolerance", "flag"],
)
def test_any_change_gives_other_names(
    fmu: Path, sheep: Network, tmp_path: Path, change: Callable[[Network, Path], Path]
) -> None:
    """The last bit of one value or one setting changes the GUID and the names of all code that a host imports."""

    def code(fmu: Path) -> set[str]:
        names = zipfile.ZipFile(fmu).namelist()
        return {n.split("/")[1] for n in names if re.match(r"resources/_?arterial_", n)}

    other = change(sheep, tmp_path)
    assert guid(other) != guid(fmu)
    assert len(code(fmu)) == len(code(other)) == 2
    assert not code(fmu) & code(other)


def test_contents(fmu: Path, sheep: Network) -> None:
    """What an FMU holds, the code under hashed names; it is small: below 400 kB, most of it the wrapper's binaries."""
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
    name = read(fmu, "resources/slavemodule.txt")
    assert re.fullmatch(r"arterial_[0-9a-f]{8}", name)
    assert guid(fmu).startswith(f"{{{name.removeprefix('arterial_')}")
    code = {n.removeprefix(f"resources/_{name}/") for n in names if n.startswith(f"resources/_{name}/")}
    modules = "__init__ host wrapper slaves/arteries_slave slaves/base slaves/saving".split()
    modules += [f"cosimulation/{module}" for module in ("arteries", "drive", "ports", "communication_step")]
    modules += [f"variables/{module}" for module in ("arteries_variables", "model_description", "variable")]
    modules += [f"{folder}/__init__" for folder in ("slaves", "cosimulation", "variables")]
    assert {n for n in code if n.startswith("fmu_src/")} == {f"fmu_src/{module}.py" for module in modules}
    # the physics, and nothing of files, terminals, runs or drawings
    others = ["files", "simulate", "linear", "loop", "layout", "waveforms", "displays", "former_names"]
    assert {"solver/laws/effects.py", "solver/laws/wall.py", "solver/lumped/component.py"} <= code
    assert not [n for n in code if n.endswith(tuple(f"/{module}.py" for module in others)) or "/muscl/" in n]
    expected = {f"resources/_{name}/{n}" for n in code}
    expected |= {f"resources/{name}.py", f"resources/_{name}/__init__.py", "resources/network.toml"}
    expected |= {
        "modelDescription.xml",
        "model.png",
        "documentation/index.html",
        "documentation/licenses/license.txt",
        "documentation/licenses/pythonfmu.txt",
        "resources/network.json",
    }
    expected |= {"binaries/linux64/sheep.so", "binaries/win64/sheep.dll", "resources/slavemodule.txt"}
    assert {n for n in names if not n.startswith("resources/pythonfmu/")} == expected
    assert fmu.stat().st_size < 400_000


def test_network_can_be_read_back(fmu: Path, sheep: Network) -> None:
    """resources/network.toml is the network, equal bit for bit."""
    assert loads(read(fmu, "resources/network.toml"), "sheep.fmu") == sheep


def test_start_values_are_an_option(sheep: Network, tmp_path: Path) -> None:
    """Another start value of a parameter stands in the description, by the number of an Enumeration, and acts."""
    starts = ["--set", "inlet.interpolation=linear", "--set", "CA.phi0=2 kPa*s"]
    done = CliRunner().invoke(app, ["sheep", "--out", os.fspath(tmp_path), *starts])
    assert done.exit_code == 0, done.output
    root = ElementTree.fromstring(read(tmp_path / "sheep.fmu", "modelDescription.xml"))
    found = {v.attrib["name"]: v[0].get("start") for v in root.iter("ScalarVariable")}
    assert (found["inlet.interpolation"], found["CA.phi0"]) == ("2", "2000.0")
    for text, said in (
        ("CA.phi0", "must look like NAME=VALUE"),
        ("CA.P=1 Pa", "not an input or"),
        ("CA.E=-1 Pa", "must lie"),
    ):
        done = CliRunner().invoke(app, ["sheep", "--out", os.fspath(tmp_path), "--set", text])
        assert done.exit_code == 2
        assert said in done.stderr


def test_a_thick_start_value_is_doubtful(tmp_path: Path) -> None:
    """The note on thick walls is on the walls that the FMU has, not on those of the file."""
    done = CliRunner().invoke(app, ["sheep", "--out", os.fspath(tmp_path), "--set", "CA.h=2 mm"])
    assert done.exit_code == 0, done.output
    assert "Note: segment CA: h/R0 = " in done.output


def test_execution_tool_is_an_option(fmu: Path, sheep: Network, tmp_path: Path) -> None:
    """needsExecutionTool is true by default and false on demand; the state flags are true."""
    for file, flag in ((fmu, "true"), (build(sheep, tmp_path, execution_tool=False), "false")):
        node = ElementTree.fromstring(read(file, "modelDescription.xml")).find("CoSimulation")
        assert node is not None
        assert node.attrib["needsExecutionTool"] == flag
        assert node.attrib["canGetAndSetFMUstate"] == node.attrib["canSerializeFMUstate"] == "true"
        assert node.attrib["canHandleVariableCommunicationStepSize"] == "true"


def test_reference_with_any_characters(tmp_path: Path) -> None:
    """Control characters and markup in the reference of a network reach neither the XML nor the page unescaped."""
    network = replace(TUBE, reference="tab\tvertical\x0btab, <b>&\"', Womersley\u2019s α, {braces}")
    fmu = build(network, tmp_path)
    assert validate_fmu(os.fspath(fmu)) == []
    text = ElementTree.fromstring(read(fmu, "modelDescription.xml")).attrib["description"]
    assert text.endswith("tube. tab vertical tab, <b>&\"', Womersley\u2019s α, {braces}")
    assert "&lt;b&gt;&amp;&quot;" in read(fmu, "documentation/index.html")
    assert loads(read(fmu, "resources/network.toml"), "tube.fmu") == network


def test_build_leaves_nothing_behind(
    sheep: Network, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Module path and modules, the directory of the FMU, the temporary folder and the terminal are as before."""
    build(TUBE, tmp_path / "first")  # what a first build imports for good: pythonfmu, matplotlib
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", os.fspath(temporary))
    before = list(sys.path), set(sys.modules), sys.dont_write_bytecode
    build(replace(sheep, name="other"), tmp_path / "second")
    assert before == (list(sys.path), set(sys.modules), sys.dont_write_bytecode)
    assert list(temporary.iterdir()) == []
    assert [path.name for path in (tmp_path / "second").iterdir()] == ["other.fmu"]
    assert capfd.readouterr() == ("", "")


# --- failures -----------------------------------------------------------------------------------------------------


def test_failed_write_leaves_the_old_fmu(sheep: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the last move fails, the file from before stays and nothing lies beside it; without one, no file."""
    target = tmp_path / "sheep.fmu"

    def fail(source: object, destination: object) -> None:
        raise OSError(28, "No space left on device")

    for content in (None, b"the FMU from before"):
        if content:
            target.write_bytes(content)
        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", fail)
            with pytest.raises(ValueError, match=r"sheep\.fmu: cannot be written \(No space left on device\); check"):
                build(sheep, tmp_path)
        assert [path.read_bytes() for path in tmp_path.iterdir()] == ([content] if content else [])


def test_failed_build_leaves_the_old_fmu(sheep: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A build that breaks off before it writes, here by Ctrl-C in pythonfmu, leaves the file from before."""
    from pythonfmu.builder import FmuBuilder

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    target = tmp_path / "sheep.fmu"
    target.write_bytes(b"the FMU from before")
    monkeypatch.setattr(FmuBuilder, "build_FMU", interrupt)
    path, stdout = list(sys.path), sys.stdout
    with pytest.raises(KeyboardInterrupt):
        build(sheep, tmp_path)
    assert target.read_bytes() == b"the FMU from before"
    assert list(tmp_path.iterdir()) == [target]
    assert (sys.path, sys.stdout) == (path, stdout)


def test_full_disk_while_staging(sheep: Network, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temporary folder that cannot be written ends in one sentence too."""
    real_open = io.open

    def full(file: object, mode: str = "r", *rest: object, **more: object) -> object:
        if "w" in mode and "arterial_build_" in str(file):
            raise OSError(28, "No space left on device")
        return real_open(file, mode, *rest, **more)  # type: ignore[call-overload]

    monkeypatch.setattr(io, "open", full)
    monkeypatch.setattr(builtins, "open", full)
    with pytest.raises(ValueError, match=r"sheep\.fmu: cannot be written \(No space left on device\)"):
        build(sheep, tmp_path)
    assert not list(tmp_path.iterdir())


def run_build(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONUTF8": "1", "COLUMNS": "80"}
    command = [sys.executable, str(ROOT / "build_fmu.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("name = ", r"Error: BAD\.toml: not valid TOML: .*"),
        (
            'name = "x"\n[inlet]\nsegment = "A"\n[segments.A]\nL = "-4 cm"\nR0 = "1 cm"\nh = "1 mm"\nE = "1 MPa"\n'
            "[outlets.A]\nR_t = 0\n",
            r"Error: BAD\.toml: A\.L = -0\.04 m is not allowed: length L must lie in \[0\.0001, 10\] m; check .*",
        ),
    ],
)
def test_bad_network_file(tmp_path: Path, text: str, sentence: str) -> None:
    """The command ends with exit code 2 and one sentence on stderr; no traceback, no file, no directory."""
    (tmp_path / "BAD.toml").write_text(text)
    done = run_build("BAD.toml", "--out", "dist", cwd=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(sentence + "\n", without_progress(done.stderr))
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["BAD.toml"]


@pytest.mark.slow
def test_command_line(tmp_path: Path) -> None:
    """A good file gives the FMU and its size; an unknown name and an unwritable --out give one sentence, code 2."""
    done = run_build("sheep", "--out", "dist", cwd=tmp_path)
    assert (done.returncode, without_progress(done.stderr)) == (0, "")
    assert re.fullmatch(r"wrote dist/sheep\.fmu \(\d+ kB\)\n", done.stdout)
    for arguments, sentence in (
        (["shep"], r"Error: shep: neither a file nor a bundled network; .*"),
        (
            ["sheep", "--out", "dist/sheep.fmu"],
            r"Error: dist/sheep\.fmu: is a file, not a folder; give another folder\.",
        ),
        (["sheep", "--inlet", "foo"], r"Error: --inlet foo: must be flow or pressure\."),
    ):
        done = run_build(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert re.fullmatch(sentence + "\n", without_progress(done.stderr))


def test_picture(fmu: Path, sheep: Network) -> None:
    """model.png has 400 x 250 pixels, no date or program name in it, and the same bytes whatever the user's style."""
    import matplotlib

    with zipfile.ZipFile(fmu) as archive:
        png = archive.read("model.png")
    assert png[:8] == b"\x89PNG\r\n\x1a\n"
    assert (int.from_bytes(png[16:20]), int.from_bytes(png[20:24])) == (400, 250)
    assert b"Software" not in png and b"tIME" not in png and b"date" not in png
    with matplotlib.rc_context({"font.size": 20.0, "lines.linewidth": 9.0, "savefig.dpi": 300.0, "axes.grid": True}):
        assert drawing.model_png(sheep) == png
