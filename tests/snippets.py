"""Snippets of README.md, CONTRIBUTING.md and docs/, which run in order, in a fresh directory for each document.

CI sees to installation.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import re
import shlex
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from native_fmus import can_build
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from solver.io.writing import write_whole

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
    "docs/python.md": (4, 0),
    "docs/studies.md": (1, 1),
    "docs/fitting.md": (3, 3),
    "docs/first-model.md": (1, 1),
    "docs/lab-files.md": (2, 2),
    "docs/discrepancy.md": (3, 3),
    "docs/tutorial-fmu.md": (1, 2),
    "docs/tutorial-lab.md": (0, 3),
    "docs/tutorial-real.md": (0, 7),
    "docs/tutorial-effect.md": (4, 1),
}
# documents whose snippets take long have a file, and so a process, of their own
ELSEWHERE = {
    "docs/fitting.md": "test_snippets_of_fitting",
    "docs/first-model.md": "test_snippets_of_fitting",
    "docs/lab-files.md": "test_snippets_of_fitting",
    "docs/discrepancy.md": "test_snippets_of_discrepancy",
    "docs/tutorial-lab.md": "test_snippets_of_discrepancy",
    "docs/tutorial-real.md": "test_snippets_of_recordings",
}
_NATIVE = " --native" if can_build() else ""  # the same numbers in a tenth of the time
# less of the same: what comes out is in tests of their own
SHORTER = {
    "README.md": {"=2.5": "=0.5", "0.0, 2.5, 2501": "0.0, 0.5, 501", "[-1], 2.5)": "[-1], 0.5)"},
    "docs/fitting.md": {f"build {name}": f"build {name}{_NATIVE}" for name in ("dist/bench_AA.toml", "sheep")},
    "docs/simulators.md": {'"steps": 900': '"steps": 100'},
    "docs/studies.md": {"--samples 64": "--samples 16"},
    "docs/tutorial-effect.md": {"sheep --channels AA.P,CA.P,FA.P": "cca --channels common_carotid_artery.P"},
}
# Python that changes the catalogue of its process
APART = ("effects.ALL +=", "outlets.OUTLETS +=", "_LAWS[")
# these install things or run the whole test suite
NOT_HERE = ("make ", "-m venv")


def text_of(document: str) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


def snippets(document: str) -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", text_of(document), flags=re.DOTALL)
    return [(kind, dedent(text)) for kind, text in found if not any(word in text for word in NOT_HERE)]


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


def documents(file: str) -> list[str]:
    """Those whose snippets run in a test file."""
    return [document for document in DOCUMENTS if ELSEWHERE.get(document, "test_readme") == Path(file).stem]


def cases(file: str) -> list[Any]:
    """The snippets of a test file: document and number."""
    return [
        pytest.param(document, i, marks=_mark(document, text))
        for document in documents(file)
        for i, (_, text) in enumerate(snippets(document))
    ]


class Lines:
    """Lines of shell, each run once on the same files by all processes: many documents begin with the same ones.

    folder : of all processes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(exist_ok=True)

    def run(self, line: str, folder: Path) -> None:
        """Exit code 0. What the line reads are the files and folders that it names."""
        if not line.startswith("arterial-fmu ") or ">" in line:
            _succeeds(["bash", "-euc", _here(line)], folder)
            return
        words = [word for word in shlex.split(line, comments=True) if (folder / word).exists()]
        given = pickle.dumps((line, *(sorted(_files(folder, folder / word).items()) for word in words)))
        kept = self._folder / hashlib.sha256(given).hexdigest()
        if not kept.is_file():
            before = _files(folder, folder)
            _command(shlex.split(_here(line), comments=True)[3:], folder)
            after = _files(folder, folder)
            write_whole(kept, pickle.dumps({name: after[name] for name in after if before.get(name) != after[name]}))
        for name, content in pickle.loads(kept.read_bytes()).items():
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


@contextlib.contextmanager
def _in(folder: Path) -> Iterator[None]:
    """As in a process of its own: in a folder, and a warning is no error."""
    with contextlib.chdir(folder), warnings.catch_warnings():
        warnings.simplefilter("default")
        yield


def _python(text: str, folder: Path) -> None:
    """A script, in this process but with names of its own."""
    if any(words in text for words in APART):
        _succeeds([sys.executable, "-W", "error::DeprecationWarning:__main__", "-c", text], folder)
        return
    with _in(folder):
        warnings.filterwarnings("error", category=DeprecationWarning, module="__main__")
        exec(compile(text, "snippet", "exec"), {"__name__": "__main__"})


def _command(words: list[str], folder: Path) -> None:
    """A command of the package, in this process but for ``run``, which has its own."""
    if words[0] == "run":
        _succeeds([sys.executable, "-m", "arterial_fmu", *words], folder)
        return
    with _in(folder):
        done = CliRunner().invoke(app, words, prog_name="arterial-fmu")
    assert done.exit_code == 0, f"{words}\n{done.output}\n{done.stderr}\n{done.exception!r}"


def _succeeds(command: list[str], folder: Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"


def run_snippet(folder: Path, lines: Lines, document: str, number: int) -> None:
    """Exit code 0, after all snippets before it in the document; Python without a deprecated name."""
    kind, text = snippets(document)[number]
    for written, shorter in SHORTER.get(document, {}).items():
        text = text.replace(written, shorter)
    if kind == "python":
        _python(text, folder)
    else:
        for line in text.replace("\\\n", "").splitlines():
            lines.run(line, folder)
