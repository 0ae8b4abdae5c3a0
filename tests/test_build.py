"""Building an FMU: the archive, its names and hashes, the documents in it, and every way in which it can fail."""

from __future__ import annotations

import builtins
import io
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from build_fmu import build
from fmu_src import drawing
from fmu_src.document import index_html
from fmu_src.variables import variable_table
from solver import (
    Inlet,
    Network,
    Pressure,
    Reflection,
    Resistance,
    Segment,
    Settings,
    Site,
    Windkessel,
)
from solver.files import loads
from solver.network import Junction

ROOT = Path(__file__).resolve().parent.parent


def segment(name: str, R0: float) -> Segment:
    return Segment(name, L=0.1, R0=R0, h=0.1 * R0, E=1e6, phi0=1e4)


# one tube; three kinds of outlets at one junction; a loop; a circle of flow
TUBE = Network("tube", (segment("tube", 0.01),), Inlet("tube"), outlets=(Resistance("tube", R=1e8),))
FORK = Network(
    "fork",
    (segment("aorta", 0.01), segment("left_carotid", 0.004), segment("vertebral", 0.002), segment("descending", 0.009)),
    Inlet("aorta"),
    (Junction(("aorta",), ("left_carotid", "vertebral", "descending")),),
    (Windkessel("left_carotid", 1e8, 1e-9, 1e9), Resistance("vertebral", 1e9), Pressure("descending")),
    (Site("root", "aorta", 0.0), Site("end", "vertebral", 1.0)),
)
LOOP = Network(
    "loop",
    (segment("A", 0.01), segment("B", 0.008), segment("C", 0.005), segment("D", 0.004), segment("E", 0.009)),
    Inlet("A"),
    (Junction(("A",), ("B", "C")), Junction(("B",), ("D",)), Junction(("C", "D"), ("E",))),
    (Reflection("E", R_t=0.1),),
    (Site("middle", "C"),),
)
CIRCLE = Network(
    "circle",
    (segment("A", 0.01), segment("B", 0.008), segment("C", 0.005), segment("D", 0.004)),
    Inlet("A"),
    (Junction(("A", "C"), ("B",)), Junction(("B",), ("C", "D"))),
    (Reflection("D", R_t=0.1),),
)
DRAWN = [TUBE, FORK, LOOP, CIRCLE]


@pytest.fixture(scope="module")
def fmu(sheep: Network, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(sheep, tmp_path_factory.mktemp("build"))


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
    """What an FMU holds, the code under hashed names; it is small: below 320 kB, 90 % of it the wrapper's binaries."""
    with zipfile.ZipFile(fmu) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
    name = read(fmu, "resources/slavemodule.txt")
    assert re.fullmatch(r"arterial_[0-9a-f]{8}", name)
    assert guid(fmu).startswith(f"{{{name.removeprefix('arterial_')}")
    code = {n.removeprefix(f"resources/_{name}/") for n in names if n.startswith(f"resources/_{name}/")}
    assert {n for n in code if n.startswith("fmu_src/")} == {
        f"fmu_src/{module}.py" for module in ("__init__", "cosimulation", "description", "slave", "variables")
    }
    # the physics, and nothing of files, terminals, runs or drawings
    others = ("__main__", "branching", "console", "files", "layout", "linear", "loop", "simulate")
    assert {"solver/effects.py", "solver/wall.py"} <= code and not {f"solver/{module}.py" for module in others} & code
    expected = {f"resources/_{name}/{n}" for n in code}
    expected |= {f"resources/{name}.py", f"resources/_{name}/__init__.py", "resources/network.toml"}
    expected |= {
        "modelDescription.xml",
        "model.png",
        "documentation/index.html",
        "documentation/licenses/pythonfmu.txt",
        "resources/network.json",
    }
    expected |= {"binaries/linux64/sheep.so", "binaries/win64/sheep.dll", "resources/slavemodule.txt"}
    assert {n for n in names if not n.startswith("resources/pythonfmu/")} == expected
    assert fmu.stat().st_size < 320_000


def test_network_can_be_read_back(fmu: Path, sheep: Network) -> None:
    """resources/network.toml is the network, equal bit for bit."""
    assert loads(read(fmu, "resources/network.toml"), "sheep.fmu") == sheep


def test_execution_tool_is_an_option(fmu: Path, sheep: Network, tmp_path: Path) -> None:
    """needsExecutionTool is true by default and false on demand; the state flags are false."""
    for file, flag in ((fmu, "true"), (build(sheep, tmp_path, execution_tool=False), "false")):
        node = ElementTree.fromstring(read(file, "modelDescription.xml")).find("CoSimulation")
        assert node is not None
        assert node.attrib["needsExecutionTool"] == flag
        assert node.attrib["canGetAndSetFMUstate"] == node.attrib["canSerializeFMUstate"] == "false"
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


def test_build_leaves_nothing_behind(sheep: Network, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Module path and modules, the directory of the FMU, the temporary folder and the terminal are as before."""
    build(TUBE, tmp_path / "first")  # what a first build imports for good: pythonfmu, matplotlib
    temporary = Path(os.environ.get("TMPDIR", "/tmp"))
    before = list(sys.path), set(sys.modules), sys.dont_write_bytecode, set(temporary.glob("arterial_*"))
    build(replace(sheep, name="other"), tmp_path / "second")
    assert before == (list(sys.path), set(sys.modules), sys.dont_write_bytecode, set(temporary.glob("arterial_*")))
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
    assert re.fullmatch(sentence + "\n", done.stderr)
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["BAD.toml"]


def test_command_line(tmp_path: Path) -> None:
    """A good file gives the FMU and its size; an unknown name and an unwritable --out give one sentence, code 2."""
    done = run_build("sheep", "--out", "dist", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.fullmatch(r"wrote dist/sheep\.fmu \(\d+ kB\)\n", done.stdout)
    for arguments, sentence in (
        (["shep"], r"Error: shep: neither a file nor a bundled network; .*"),
        (
            ["sheep", "--out", "dist/sheep.fmu"],
            r"Error: dist/sheep\.fmu/sheep\.fmu: cannot be written \(.*\); check .*",
        ),
    ):
        done = run_build(*arguments, cwd=tmp_path)
        assert done.returncode == 2
        assert re.fullmatch(sentence + "\n", done.stderr)


# --- documents ----------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Checks that tags are closed in order, and collects the text and every address."""

    VOID = ("meta", "br", "circle", "path", "polyline")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[list[str]] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for key, value in attributes if key in ("src", "href", "xlink:href")]
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag != "circle":
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and {"td", "th"} & set(self.open):
            self.cells[-1][-1] += data


@pytest.mark.parametrize("network", DRAWN, ids=lambda n: n.name)
def test_page(network: Network) -> None:
    """The page is well formed and self-contained, and lists every variable with unit, start and range."""
    table = variable_table(network, Settings())
    text = index_html(network, table, "1.2.3")
    page = Page(text)
    assert all(address.startswith("https://doi.org/") for address in page.addresses)
    assert not re.search(r"@import|url\(|<script", text)
    rows = {cells[0]: cells for cells in page.cells}
    for v in table:
        name, kind, unit, start, allowed, meaning = rows[v.name]
        assert (name, kind, meaning) == (v.name, v.variability, v.description)
        if v.quantity is None:
            assert (start, allowed) == (v.start, ", ".join(v.choices))
        else:
            assert unit.startswith("–" if v.quantity.unit == "1" else v.quantity.unit)
            assert (start == "") == (v.causality == "output")
            assert v.start is None or float(start.split()[0]) == pytest.approx(v.start, rel=1e-5)
    for word in ("hold", "linear", "logging", "numpy", "libpython", "network.toml"):
        assert word in text


@pytest.mark.parametrize("network", DRAWN, ids=lambda n: n.name)
def test_drawing(network: Network) -> None:
    """One line per segment, from its start to its end, inside the picture; wider for wider arteries; marks beside."""
    lanes = drawing.lanes(network)
    nodes: dict[tuple[float, float], list[str]] = {}
    for lane in lanes:
        for at in (lane.path[0], lane.path[-1]):
            nodes.setdefault(tuple(np.round(at, 9).tolist()), []).append(lane.segment.name)
    # segments meet where their junction is, and nowhere else
    joined = sorted(sorted(names) for names in nodes.values() if len(names) > 1)
    assert joined == sorted(sorted((*j.inflow, *j.outflow)) for j in network.junctions)
    svg = drawing.network_svg(network)
    root = ElementTree.fromstring(svg)
    width, height = (float(root.attrib[key]) for key in ("width", "height"))
    lines = [node for node in root if node.tag.endswith("polyline")]
    widths = [float(node.attrib["stroke-width"]) for node in lines]
    by_radius = [w for _, w in sorted(zip((s.R0 for s in network.segments), widths, strict=True))]
    assert by_radius == sorted(widths)
    assert len(lines) == len(network.segments)
    for node in lines:
        points = np.array([[float(x) for x in point.split(",")] for point in node.attrib["points"].split()])
        assert (points > 0).all() and (points < [width, height]).all()
    texts = {node.text for node in root if node.tag.endswith("text")}
    assert {s.name for s in network.segments} <= texts
    assert sum(node.tag.endswith("circle") for node in root) == len(network.sites)


def test_long_chain_is_drawn() -> None:
    """1200 segments in a row: no depth of recursion is reached, and the lanes follow each other at one height."""
    names = [f"S{i}" for i in range(1200)]
    chain = Network(
        "chain",
        tuple(segment(name, 0.01) for name in names),
        Inlet("S0"),
        tuple(Junction((a,), (b,)) for a, b in pairwise(names)),
        (Reflection(names[-1], R_t=0.0),),
    )
    assert [(lane.x0, lane.x1, lane.y) for lane in drawing.lanes(chain)] == [(i, i + 1, 0.0) for i in range(1200)]


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
