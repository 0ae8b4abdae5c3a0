"""The notebooks of examples/: stored as they were executed, and each runs from its first cell to its last."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

nbformat = pytest.importorskip("nbformat", reason="nbclient is not installed")
NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "examples" / "notebooks").glob("*.ipynb"))

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
# two minutes: the real recording is calibrated and searched by the snippets of docs/tutorial-real.md
MINUTES = "mock-loop"


def code(book: Any) -> list[Any]:
    return [cell for cell in book.cells if cell.cell_type == "code"]


def kinds(book: Any) -> list[list[tuple[str, list[str]]]]:
    """Of every cell, the kinds of its outputs."""
    return [[(o.output_type, sorted(o.get("data", {}))) for o in cell.outputs] for cell in code(book)]


@every_notebook
def test_stored(path: Path) -> None:
    """Executed in order, without an error and without a path of the computer where it was; data say what they are."""
    book = nbformat.read(path, 4)
    assert [cell.execution_count for cell in code(book)] == list(range(1, len(code(book)) + 1))
    found = {o.output_type for cell in code(book) for o in cell.outputs}
    assert found == {"execute_result"}, "neither errors nor what was printed on the way"
    text = path.read_text(encoding="utf-8")
    texts = re.sub(r'"image/png": "[^"]*"', "", text)
    assert not re.search(r"/(home|root|work|tmp|Users|usr)/|[A-Z]:\\\\", texts)
    kind = "real" if path.stem == "mock-loop" else "synthetic"
    assert path.stem == "solve" or f"**The recording is {kind}**" in text
    assert path.stat().st_size < 250_000


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.endurance if p.stem == MINUTES else pytest.mark.slow) for p in NOTEBOOKS],
    ids=lambda path: path.stem,
)
def test_runs(path: Path, tmp_path: Path) -> None:
    """Every cell runs in an empty folder, and gives what is stored: tables, figures, and the same verdict."""
    from nbclient import NotebookClient

    stored, book = nbformat.read(path, 4), nbformat.read(path, 4)
    NotebookClient(book, timeout=1200, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert kinds(book) == kinds(stored)
    said = [[o.data["text/plain"] for cell in code(b) for o in cell.outputs] for b in (stored, book)]
    assert [text.partition(":")[0] for text in said[0]] == [text.partition(":")[0] for text in said[1]]
