"""The snippets of docs/fitting.md, docs/first-model.md and docs/lab-files.md, in order."""

from __future__ import annotations

from pathlib import Path

import pytest
from snippets import Lines, cases, run_snippet


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize(("document", "number"), cases(__file__))
def test_snippet(folders: dict[str, Path], lines: Lines, document: str, number: int) -> None:
    run_snippet(folders[document], lines, document, number)
