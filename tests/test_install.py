"""What is published, as people install it: outside the checkout, from the wheel alone.

The wheel is built from the source distribution, without a network; ziglang compiles what it brings for all platforms,
a minute of CPU the first time. What the wheel depends on is that of the Python which runs the tests: its folder is
put on the path of the new environment.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import fmpy.validation
import numpy
import pytest
import pythonfmu
from snippets import SHORTER, snippets, text_of
from test_client_pythons import installed

from arterial_fmu.cli.commands import COMMANDS
from build_fmu import build, build_native
from fmu_src import compiler
from solver import load
from solver.network.files import bundled_names
from solver.tracing.native import PLATFORM

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("solver", "fmu_src", "fitting", "discrepancy", "arterial_fmu")
WORDS = ("README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff")
PARTS = ("pyproject.toml", "MANIFEST.in", *WORDS, "build_fmu.py", "native", "tests", *PACKAGES)
ENGINE = "solver/engine"


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the source distribution and the wheel made of it."""
    checkout, out = tmp_path_factory.mktemp("checkout"), tmp_path_factory.mktemp("dist")
    for name in PARTS:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, checkout / name, ignore=shutil.ignore_patterns("__pycache__", "engine"))
        else:
            shutil.copy(ROOT / name, checkout)
    line = [sys.executable, "-m", "build", "--no-isolation", "--outdir", os.fspath(out), os.fspath(checkout)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


@pytest.fixture(scope="module")
def home(dist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel, and a folder to work in; nothing of the checkout is on its path."""
    home = tmp_path_factory.mktemp("home")
    venv.create(home / "venv", with_pip=False, symlinks=True)
    python = home / "venv" / "bin" / "python"
    (wheel,) = dist.glob("*.whl")
    line = [sys.executable, "-m", "pip", "--python", os.fspath(python), "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*line, os.fspath(wheel)], check=True)
    # after the wheel, so that pip does not find this project's own entry there; its .pth files are not read
    paths = {sysconfig.get_path(kind) for kind in ("purelib", "platlib")}
    (site,) = (home / "venv").glob("lib/python3*/site-packages")
    (site / "dependencies.pth").write_text("\n".join(sorted(paths)) + "\n")
    # beside this project's, as pip puts them: FMUs once took files of theirs
    for package in (numpy, pythonfmu):
        there = Path(os.path.realpath(package.__file__)).parent
        (site / there.name).symlink_to(there, target_is_directory=True)
    (home / "work").mkdir()
    return home


def run(home: Path, *line: str) -> str:
    """The output of a command of the environment, run in the empty folder."""
    folder = home / "venv" / "bin"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["PATH"] = f"{folder}{os.pathsep}{environment['PATH']}"
    command, work = [os.fspath(folder / line[0]), *line[1:]], home / "work"
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.mark.slow
def test_what_is_in_them(dist: Path) -> None:
    """Every file of the packages is in the wheel and in the source; nothing of tests or benchmarks, and no recordings,
    in either."""
    (wheel,), (source,) = dist.glob("*.whl"), dist.glob("*.tar.gz")
    files = {path.relative_to(ROOT).as_posix() for name in PACKAGES for path in (ROOT / name).rglob("*")
             if path.is_file() and not {"__pycache__", "engine"} & {*path.parts}} | {"build_fmu.py"}  # fmt: skip
    native = {path.relative_to(ROOT / "native").as_posix() for path in (ROOT / "native").rglob("*.[ch]")}
    brought = {f"{ENGINE}/{name}" for name in (*(f"sources/{path}" for path in native), *libraries())}
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        (metadata,) = (archive.read(name).decode() for name in names if name.endswith(".dist-info/METADATA"))
    assert {name for name in names if ".dist-info/" not in name} == files | brought
    with tarfile.open(source) as archive:
        contents = {name.partition("/")[2] for name in archive.getnames()}
    assert files | {f"native/{path}" for path in native} | {*WORDS} <= contents
    assert not [name for name in contents if name.startswith(("tests", "benchmarks", "examples", "docs"))]
    assert "License-Expression: MIT" in metadata and "Requires-Python: >=3.11" in metadata


def libraries() -> dict[str, compiler.Platform]:
    """The names of the engine's libraries and of those of FMUs, for all platforms."""
    fmu = compiler.fmu_sources(ROOT / "native")
    return {f"arterial_engine-{p.fmi3}{p.suffix}": p for p in compiler.PLATFORMS.values()} | {
        compiler.fmu_library(name, fmu, p.target): p for name, p in compiler.PLATFORMS.items()
    }


HEADS = {  # of a library: its format and its processor
    "x86_64-linux": b"\x7fELF\x02\x01.{12}\x3e\x00",
    "aarch64-linux": b"\x7fELF\x02\x01.{12}\xb7\x00",
    "x86_64-windows": b"MZ.*?PE\x00\x00\x64\x86",
    "x86_64-darwin": b"\xcf\xfa\xed\xfe\x07\x00\x00\x01",
    "aarch64-darwin": b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01",
}


@pytest.mark.slow
def test_its_libraries(dist: Path) -> None:
    """For the processor and the system that their names say, glibc 2.17 or older ones suffice, below 220 kB each; the
    wheel has less than 2 MB, and it is for all platforms."""
    (wheel,) = dist.glob("*.whl")
    assert wheel.name.endswith("-py3-none-any.whl") and wheel.stat().st_size < 2_000_000
    with zipfile.ZipFile(wheel) as archive:
        for name, platform in libraries().items():
            content = archive.read(f"{ENGINE}/{name}")
            assert 20_000 < len(content) < 220_000, name  # the largest is that of Windows, 219 kB
            assert re.match(HEADS[platform.fmi3], content, flags=re.DOTALL), name
            assert all(int(minor) <= 17 for minor in re.findall(rb"GLIBC_2\.(\d+)", content)), name
            assert b"/tmp" not in content and os.fsencode(ROOT) not in content, name


@pytest.mark.slow
def test_it_needs_no_compiler(home: Path, dist: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine makes the steps; a native FMU for all platforms is built of the wheel's libraries, with nothing else
    on the path and nothing compiled, and has no fault; all but its binaries is what the checkout builds."""
    monkeypatch.setenv("XDG_CACHE_HOME", os.fspath(tmp_path / "cache"))
    monkeypatch.setenv("PATH", "/nonexistent")
    engine = next(name for name, p in libraries().items() if "engine" in name and p.fmi3 == PLATFORM)
    assert f"steps by NumPy and the compiled engine ({engine})" in run(home, "arterial-fmu", "--version")
    run(home, "arterial-fmu", "solve", "cca", "--dt", "5 ms", "--backend", "native")
    options = ["--native", "--fmi", "3", "--platforms", ",".join(compiler.PLATFORMS), "--out", "native"]
    run(home, "arterial-fmu", "build", "cca", *options)
    fmu = home / "work" / "native" / "cca.fmu"
    assert not (tmp_path / "cache" / "arterial-fmu").exists()
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(fmu) as made, zipfile.ZipFile(wheel) as archive:
        for name, p in libraries().items():
            if "engine" not in name:
                assert made.read(f"binaries/{p.fmi3}/cca{p.suffix}") == archive.read(f"{ENGINE}/{name}")
    assert fmpy.validation.validate_fmu(os.fspath(fmu)) == []
    found = json.loads(run(home, "arterial-fmu", "doctor", "native/cca.fmu", "--json"))["findings"]
    assert found[-1]["found"] == "loaded, initialized, stepped, read, freed"
    here = build_native(load("cca"), tmp_path, fmi=3)
    guids = {fmpy.read_model_description(os.fspath(f)).guid for f in (here, fmu)}
    assert len(guids) == 1


@pytest.mark.slow
def test_a_library_of_other_sources(home: Path) -> None:
    """Where the sources beside it are other ones, the engine is not used, and --version says why."""
    (source,) = (home / "venv").glob(f"lib/python3*/site-packages/{ENGINE}/sources/steps.c")
    whole = source.read_bytes()
    source.write_bytes(whole + b"\n")
    try:
        assert "NumPy; the compiled engine is of other sources" in run(home, "arterial-fmu", "--version")
    finally:
        source.write_bytes(whole)


@pytest.mark.slow
def test_without_its_libraries(home: Path) -> None:
    """As built without ziglang: NumPy makes the steps, and FMUs are built; --version says so."""
    (engine,) = (home / "venv").glob(f"lib/python3*/site-packages/{ENGINE}")
    away = engine.rename(engine.with_name("away"))
    shutil.copytree(away / "sources", engine / "sources")
    try:
        assert "steps by NumPy; the compiled engine is not built; published wheels have it" in run(
            home, "arterial-fmu", "--version"
        )
        run(home, "arterial-fmu", "solve", "cca", "--dt", "5 ms")
        run(home, "arterial-fmu", "build", "cca", "--out", "numpy")
    finally:
        shutil.rmtree(engine)
        away.rename(engine)


@pytest.mark.slow
def test_readme(home: Path) -> None:
    """Its snippets run outside the checkout, from Python, from the command line and of FMPy, after the line that it
    gives for this."""
    readme = " ".join(text_of("README.md").split())
    assert "Without a checkout, `arterial-fmu build sheep --out dist` makes both" in readme
    run(home, "arterial-fmu", "build", "sheep", "--out", "dist")
    for kind, text in snippets("README.md")[:5]:
        for written, shorter in SHORTER["README.md"].items():
            text = text.replace(written, shorter)
        shell = f"import subprocess; subprocess.run(['bash', '-euc', {text!r}], check=True)"
        run(home, "python", "-c", text if kind == "python" else shell)


@pytest.mark.slow
def test_it_is_the_installed_one(home: Path) -> None:
    """Every package, and the function of every command, come from the environment; all networks come along."""
    code = (
        "import sys; from arterial_fmu.cli.commands import COMMANDS, load; print(*map(load, COMMANDS)); "
        f"print(*(sys.modules[name].__file__ for name in {PACKAGES}))"
    )
    loaded, places = run(home, "python", "-c", code).splitlines()
    assert loaded.count("Command") + loaded.count("Group") >= len(COMMANDS)
    assert all(place.startswith(os.fspath(home / "venv")) for place in places.split())
    found = json.loads(run(home, "arterial-fmu", "list", "--json"))["networks"]
    assert [each["name"] for each in found] == bundled_names()


@pytest.mark.slow
def test_from_python(home: Path) -> None:
    """The public names, their packages under both names, and that they are typed; a file that hides one is named."""
    code = """
import arterial_fmu as af
from importlib.resources import files
from arterial_fmu.fitting.wall.site_fit import fit
from arterial_fmu.solver.network.description import Network
assert fit is af.fit and isinstance(af.load("cca"), Network) and all(hasattr(af, name) for name in af.__all__)
print(af.__version__, all((files(p) / "py.typed").is_file() for p in PACKAGES))
"""
    version = run(home, "arterial-fmu", "--version").split()[1]
    said = run(home, "python", "-c", code.replace("PACKAGES", repr(PACKAGES)))
    assert said == f"{version} True\n"
    (home / "own").mkdir()
    (home / "own" / "solver.py").write_text("")
    command = [os.fspath(home / "venv" / "bin" / "python"), "-c", "import arterial_fmu"]
    done = subprocess.run(command, cwd=home / "own", capture_output=True, text=True, check=False)
    assert f"{home / 'own' / 'solver.py'} hides the package solver of arterial-fmu" in done.stderr


@pytest.mark.slow
def test_network_to_fmu(home: Path) -> None:
    """solve, export, import, build of the arteries and of heart, arteries and body, doctor, run."""
    assert "sheep" in run(home, "arterial-fmu", "solve", "sheep", "--dt", "5 ms", "--out", "beat.csv")
    run(home, "arterial-fmu", "export", "sheep")
    run(home, "arterial-fmu", "import", "csv", "sheep.csv", "--out", "again.toml")
    run(home, "arterial-fmu", "build", "again.toml", "--out", "again")
    run(home, "arterial-fmu", "build", "system", "human")
    (fmu,) = (home / "work" / "again").glob("*.fmu")
    assert (home / "work" / "dist" / "human.ssp").is_file()
    done = run(home, "arterial-fmu", "doctor", f"again/{fmu.name}", "--json")
    assert json.loads(done)["findings"][-1]["found"] == "loaded, initialized, stepped, read, freed"
    run(home, "arterial-fmu", "run", f"again/{fmu.name}", "--stop-time", "0.05 s", "--out", "run.csv")
    assert (home / "work" / "run.csv").read_text().startswith("time [s],inlet.P [Pa]")


@pytest.mark.slow
def test_the_same_fmu(home: Path, tmp_path: Path) -> None:
    """Byte for byte the FMU that the checkout builds."""
    run(home, "arterial-fmu", "build", "cca", "--out", "same")
    here = build(load("cca"), tmp_path)
    assert (home / "work" / "same" / "cca.fmu").read_bytes() == here.read_bytes()


@pytest.mark.slow
def test_record_to_verdict(home: Path) -> None:
    """virtual, fit, check with its FMU, cohort, discover with its report and an FMU."""
    run(home, "arterial-fmu", "virtual", "--animals", "2", "--out", "virtual", "--quiet")
    record = "virtual/virtual-S01_AA.csv"
    fit = ["fit", record, "--site", "AA", "--h", "0.38 mm", "--model", "linear", "--bootstrap", "0"]
    run(home, "arterial-fmu", *fit, "--out", "AA.json", "--figure", "AA.png", "--bench", "AA.toml")
    run(home, "arterial-fmu", "build", "AA.toml", "--out", "bench")
    (fmu,) = (home / "work" / "bench").iterdir()
    checked = json.loads(run(home, "arterial-fmu", "check", "AA.json", f"bench/{fmu.name}", record, "--json"))
    assert "AA.R" in checked["channels"]
    cohort = json.loads(run(home, "arterial-fmu", "cohort", "virtual/cohort.csv", "--out", "cohort", "--json"))
    assert cohort["claims"]
    study = run(home, "arterial-fmu", "discover", record, "--model", "AA.toml", "--out", "study", "--json")
    assert json.loads(study)["verdict"] == "effect"
    assert {"report.html", "model.fmu"} <= {path.name for path in (home / "work" / "study").iterdir()}


@pytest.mark.slow
def test_before_measuring(home: Path) -> None:
    """isolability: what a pressure can tell; study: a sample that is as large as it must be, with its page."""
    plan = run(home, "arterial-fmu", "isolability", "cca", "--channels", "common_carotid_artery.P", "--json")
    assert "wall_viscosity" in {effect["name"] for effect in json.loads(plan)["effects"]}
    varied = ["study", "cca", "--vary", "all.E=0.9..1.1x", "--samples", "6", "--out", "varied", "--json"]
    assert json.loads(run(home, "arterial-fmu", *varied))
    assert (home / "work" / "varied" / "study.html").is_file()


@pytest.mark.slow
def test_calibrate(home: Path) -> None:
    """A record of the network's own beat: E is found again to 1e-4, a parameter set on the output."""
    code = """
import numpy as np
from fitting.records.read.record import write_record
from solver import load, simulate_periodic
beat = simulate_periodic(load("sheep"))
channels = {name: np.append(np.tile(beat[name][:-1], 3), beat[name][-1]) for name in ("inlet.Q", "AA.P", "CA.P")}
write_record("net.csv", np.arange(1501) * 1e-3, channels)
"""
    run(home, "python", "-c", code)
    found = json.loads(run(home, "arterial-fmu", "calibrate", "net.csv", "sheep", "--free", "all.E", "--json"))
    assert found["values"]["CA.E"]["value"] == pytest.approx(load("sheep").segment("CA").E, rel=1e-4)


@pytest.mark.endurance  # by hand: it takes from the package index what the wheel depends on
@pytest.mark.parametrize("version", [(3, 11), (3, 12), (3, 13), (3, 14)])
def test_other_pythons(version: tuple[int, int], dist: Path, tmp_path: Path) -> None:
    """With each Python that this machine has: solve, build, doctor, run, virtual, fit, isolability."""
    subprocess.run([installed(version).command, "-m", "venv", os.fspath(tmp_path / "venv")], check=True)
    (tmp_path / "work").mkdir()
    (wheel,) = dist.glob("*.whl")
    run(tmp_path, "python", "-m", "pip", "install", "--quiet", os.fspath(wheel))
    for line in (
        'solve sheep --dt "5 ms"',
        "build sheep",
        "doctor dist/sheep.fmu",
        'run dist/sheep.fmu --stop-time "0.05 s"',
        "virtual --animals 1 --out v",
        'fit v/virtual-S01_AA.csv --site AA --h "0.38 mm" --bootstrap 0 --out AA.json --figure AA.png',
        "isolability sheep --channels AA.P",
    ):
        run(tmp_path, "arterial-fmu", *shlex.split(line))
