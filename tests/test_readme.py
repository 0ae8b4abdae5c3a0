"""Every snippet of README.md, CONTRIBUTING.md and docs/ runs, in order, in a fresh directory for each document.

CI sees to installation.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import subprocess
import sys
import warnings
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, Settings, read_network
from solver.laws import catalogue
from solver.laws.outlets import OUTLETS
from solver.network.description import Fluid, Inlet, Junction, Segment
from solver.network.files import loads
from solver.quantities.quantity import quantities

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(["README.md", "CONTRIBUTING.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))])
# Python and shell snippets at least: the test of snippets cannot pass by finding none
DOCUMENTS = {
    "README.md": (2, 2),
    "CONTRIBUTING.md": (1, 0),
    "docs/command-line.md": (0, 3),
    "docs/fmu.md": (2, 1),
    "docs/coupling.md": (1, 0),
    "docs/closed-loop.md": (0, 1),
    "docs/simulators.md": (0, 4),
    "docs/effects.md": (1, 0),
    "docs/schemes.md": (1, 1),
    "docs/python.md": (3, 0),
    "docs/studies.md": (1, 1),
    "docs/fitting.md": (3, 3),
    "docs/lab-files.md": (2, 2),
    "docs/discrepancy.md": (3, 3),
    "docs/tutorial-fmu.md": (1, 2),
    "docs/tutorial-lab.md": (0, 3),
    "docs/tutorial-real.md": (0, 7),
    "docs/tutorial-effect.md": (2, 1),
}
# these install things or run the whole test suite
NOT_HERE = ("make ", "-m venv")


def _text(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


def _snippets(document: str) -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", _text(document), flags=re.DOTALL)
    return [(kind, dedent(text)) for kind, text in found if not any(word in text for word in NOT_HERE)]


@pytest.mark.parametrize("document", PAGES)
def test_there_are_snippets(document: str) -> None:
    """A document with snippets is in the list above, and has as many as it says, or more."""
    kinds = [kind for kind, _ in _snippets(document)]
    python, shell = DOCUMENTS.get(document, (0, 0))
    assert kinds.count("python") >= python and kinds.count("sh") >= shell
    assert document in DOCUMENTS or not kinds


def _slow(document: str, text: str) -> bool:
    """All but the first page: each of its subjects has a test file of its own. Fits with a bootstrap take long."""
    return document.startswith("docs/") or "arterial-fmu fit" in text


# two studies of the sheep network with individual walls, two minutes: one of a stenosis, and one of a fork with a
# calibration as prior, are in test_discrepancy_walls.py
MINUTES = ("discover dist/virtual_friday.csv",)


def _mark(document: str, text: str) -> list[pytest.MarkDecorator]:
    if any(words in text for words in MINUTES):
        return [pytest.mark.endurance]
    return [pytest.mark.slow] if _slow(document, text) else []


CASES = [
    pytest.param(document, i, marks=_mark(document, text))
    for document in DOCUMENTS
    for i, (_, text) in enumerate(_snippets(document))
]


class Lines:
    """Lines of shell, each run once on the same files: many documents begin with the same ones."""

    def __init__(self) -> None:
        self._made: dict[tuple[Any, ...], dict[str, bytes]] = {}

    def run(self, line: str, folder: Path) -> None:
        """Exit code 0. What the line reads are the files and folders that it names."""
        if not line.startswith("arterial-fmu ") or ">" in line:
            _succeeds(["bash", "-euc", _here(line)], folder)
            return
        words = [word for word in shlex.split(line, comments=True) if (folder / word).exists()]
        key = (line, *(tuple(_files(folder, folder / word).items()) for word in words))
        if key not in self._made:
            before = _files(folder, folder)
            _command(shlex.split(_here(line), comments=True)[3:], folder)
            after = _files(folder, folder)
            self._made[key] = {name: after[name] for name in after if before.get(name) != after[name]}
        for name, content in self._made[key].items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)


def _files(folder: Path, path: Path) -> dict[str, bytes]:
    """A file, or all files of a folder, by their names from ``folder``."""
    paths = [path] if path.is_file() else sorted(file for file in path.rglob("*") if file.is_file())
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in paths}


def _here(text: str) -> str:
    """Shell that runs this checkout by this Python."""
    text = re.sub("^arterial-fmu ", "python -m arterial_fmu ", text, flags=re.MULTILINE)
    lines = [line.replace("python ", f'"{sys.executable}" ', 1) for line in text.splitlines()]
    text = "\n".join(lines).replace("build_fmu.py", f'"{ROOT / "build_fmu.py"}"')
    for folder in ("solver/networks/", "tests/clients/", "examples/", "benchmarks/"):
        text = text.replace(f" {folder}", f" {ROOT}/{folder}")
    return text


def _command(words: list[str], folder: Path) -> None:
    """A command of the package, in this process but for ``run``, which has its own."""
    if words[0] == "run":
        _succeeds([sys.executable, "-m", "arterial_fmu", *words], folder)
        return
    with contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("default")
        done = CliRunner().invoke(app, words, prog_name="arterial-fmu")
    assert done.exit_code == 0, f"{words}\n{done.output}\n{done.stderr}\n{done.exception!r}"


def _succeeds(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"


@pytest.fixture(scope="module")
def lines() -> Lines:
    return Lines()


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory, lines: Lines) -> dict[str, Path]:
    """A directory a document; that of README.md with what ``make demo`` has built."""
    paths = {document: tmp_path_factory.mktemp("snippets") for document in DOCUMENTS}
    lines.run("arterial-fmu build sheep --out dist", paths["README.md"])
    return paths


@pytest.mark.parametrize(("document", "number"), CASES)
def test_snippet(folders: dict[str, Path], lines: Lines, document: str, number: int) -> None:
    """Exit code 0, after all snippets before it in the document."""
    kind, text = _snippets(document)[number]
    if kind == "python":
        _succeeds([sys.executable, "-c", text], folders[document])
    else:
        for line in text.replace("\\\n", "").splitlines():
            lines.run(line, folders[document])


def _anchors(document: str) -> set[str]:
    """The anchors of a page's titles, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", _text(document), flags=re.DOTALL), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("document", PAGES)
def test_links(document: str) -> None:
    """Every link of a page leads to a file or folder that is there, and to a title that is in it."""
    for target in re.findall(r"\]\(([^)\s]+)\)", _text(document)):
        if target.startswith("https://"):
            continue
        file, _, anchor = target.partition("#")
        path = (ROOT / document).parent / file if file else ROOT / document
        assert path.exists(), target
        assert not anchor or anchor in _anchors(path.resolve().relative_to(ROOT).as_posix()), target


def test_network_file_examples() -> None:
    """The complete TOML example of docs/network-file.md is a network."""
    blocks = re.findall(r"```toml\n(.*?)```", _text("docs/network-file.md"), flags=re.DOTALL)
    blocks = [block for block in blocks if "[inlet]" in block]
    assert blocks
    for block in blocks:
        assert loads(block, "docs/network-file.md").segments
    assert read_network(ROOT / "solver" / "networks" / "sheep.toml").name == "sheep"


def test_network_file_keys() -> None:
    """docs/network-file.md has a row for every key that carries a number."""
    kinds = (Segment, Fluid, Inlet, Junction, *OUTLETS)
    keys = {key for kind in kinds for key in quantities(kind)}
    keys |= {key for owner in ("segment", "fluid", "channel") for key in catalogue.terms_of(owner)}
    rows = re.findall(r"^\|.*\|$", _text("docs/network-file.md"), flags=re.MULTILINE)
    assert keys <= set(re.findall(r"`(\w+)`", "\n".join(rows)))


def test_fmu_variables(sheep: Network) -> None:
    """The table of docs/fmu.md has every variable of the FMU, and in the kind of its row."""
    known = {}
    for names, kind in re.findall(r"^\| (`.*?) \| ([\w ]+) \|", _text("docs/fmu.md"), flags=re.MULTILINE):
        first, *others = re.findall(r"`([^`]+)`", names)
        stem = first.rpartition(".")[0]
        known |= dict.fromkeys((first, *(stem + other for other in others)), kind)
    patterns = {re.sub(r"<\w+>", r"\\w+", name.replace(".", r"\.")): kind for name, kind in known.items()}
    for v in variable_table(sheep, Settings()):
        kinds = [kind for pattern, kind in patterns.items() if re.fullmatch(pattern, v.name)]
        expected = f"{v.variability} parameter" if v.causality == "parameter" else v.causality
        assert [known.get(v.name)] == [expected] or kinds == [expected], v.name
