"""Every snippet of README.md runs, in order, in one fresh directory; make targets and installation are left to CI."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from solver import read_network

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# these install things or run the whole test suite
NOT_HERE = ("make demo", "-m venv")


def _snippets() -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", README, flags=re.DOTALL)
    return [(kind, text) for kind, text in found if not any(word in text for word in NOT_HERE)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with what the snippets take from the repository."""
    path = tmp_path_factory.mktemp("readme")
    subprocess.run([sys.executable, str(ROOT / "build_fmu.py"), "--out", str(path / "dist")], check=True, timeout=60)
    return path


def test_there_are_snippets() -> None:
    """Two Python and two shell snippets at least: the test below cannot pass by finding none."""
    kinds = [kind for kind, _ in _snippets()]
    assert kinds.count("python") >= 2
    assert kinds.count("sh") >= 2


@pytest.mark.parametrize("number", range(len(_snippets())))
def test_snippet(folder: Path, number: int) -> None:
    """Exit code 0."""
    kind, text = _snippets()[number]
    if kind == "python":
        command = [sys.executable, "-c", text]
    else:
        lines = [line.replace("python ", f'"{sys.executable}" ', 1) for line in text.splitlines()]
        text = "\n".join(lines).replace("build_fmu.py", f'"{ROOT / "build_fmu.py"}"')
        text = text.replace(" solver/networks/", f" {ROOT}/solver/networks/")
        command = ["bash", "-euc", text]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=100, check=False)
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
