"""The snippets of docs/fitting.md and docs/lab-files.md, in order."""

from __future__ import annotations

from pathlib import Path

import pytest
from snippets import Lines, cases, documents, run_snippet


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A directory a document."""
    return {document: tmp_path_factory.mktemp("snippets") for document in documents(__file__)}


@pytest.mark.parametrize(("document", "number"), cases(__file__))
def test_snippet(folders: dict[str, Path], lines: Lines, document: str, number: int) -> None:
    run_snippet(folders[document], lines, document, number)
