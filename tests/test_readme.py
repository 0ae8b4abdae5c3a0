"""Every snippet of README.md, docs/fitting.md and docs/discrepancy.md runs, in order, in a fresh directory each.

CI sees to installation.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from solver import read_network

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = ("README.md", "docs/fitting.md", "docs/discrepancy.md")
SLOW = ("docs/fitting.md", "docs/discrepancy.md")
# these install things or run the whole test suite
NOT_HERE = ("make demo", "-m venv")


def _snippets(document: str) -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", (ROOT / document).read_text(encoding="utf-8"), flags=re.DOTALL)
    return [(kind, text) for kind, text in found if not any(word in text for word in NOT_HERE)]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A directory a document; that of README.md with what ``make demo`` has built."""
    paths = {document: tmp_path_factory.mktemp("snippets") for document in DOCUMENTS}
    out = str(paths["README.md"] / "dist")
    subprocess.run([sys.executable, str(ROOT / "build_fmu.py"), "--out", out], check=True)
    return paths


@pytest.mark.parametrize("document", DOCUMENTS)
def test_there_are_snippets(document: str) -> None:
    """Two Python and two shell snippets at least: the test below cannot pass by finding none."""
    kinds = [kind for kind, _ in _snippets(document)]
    assert kinds.count("python") >= 2
    assert kinds.count("sh") >= 2


# those that fit take more than 10 s; in the other documents all need them
CASES = [
    pytest.param(document, i, marks=[pytest.mark.slow] if "-m fitting" in text or document in SLOW else [])
    for document in DOCUMENTS
    for i, (_, text) in enumerate(_snippets(document))
]


@pytest.mark.parametrize(("document", "number"), CASES)
def test_snippet(folders: dict[str, Path], document: str, number: int) -> None:
    """Exit code 0, after all snippets before it in the document."""
    kind, text = _snippets(document)[number]
    if kind == "python":
        command = [sys.executable, "-c", text]
    else:
        lines = [line.replace("python ", f'"{sys.executable}" ', 1) for line in text.splitlines()]
        text = "\n".join(lines).replace("build_fmu.py", f'"{ROOT / "build_fmu.py"}"')
        text = text.replace(" solver/networks/", f" {ROOT}/solver/networks/")
        command = ["bash", "-euc", text]
    done = subprocess.run(command, cwd=folders[document], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{text}\n{done.stdout}\n{done.stderr}"


def test_network_file_examples() -> None:
    """The complete TOML example of docs/network-file.md is a network."""
    text = (ROOT / "docs" / "network-file.md").read_text(encoding="utf-8")
    blocks = [block for block in re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL) if "[inlet]" in block]
    assert blocks
    from solver.files import loads

    for block in blocks:
        assert loads(block, "docs/network-file.md").segments
    assert read_network(ROOT / "solver" / "networks" / "sheep.toml").name == "sheep"
