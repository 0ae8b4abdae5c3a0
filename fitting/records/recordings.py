"""Several recordings of one animal: their files, their names, and sentences about them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path

from solver.errors import InputError


def check_readable(*paths: str | os.PathLike[str]) -> None:
    """Raise InputError if one of these files of a recording cannot be opened."""
    for path in paths:
        if Path(path).exists() and not Path(path).is_file():
            raise InputError(f"{path}: cannot be read (not a regular file); give the name of a CSV file.")
        try:
            open(path, "rb").close()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror or error}); check the path.") from None


def labels_of(sources: Sequence[str | os.PathLike[str]]) -> list[str]:
    """Names of recordings: those of their files without folder and suffix, with a number where two are the same."""
    labels: list[str] = []
    for source in sources:
        stem = Path(source).stem
        numbered = (f"{stem}-{i}" for i in count(2))
        labels.append(next(label for label in chain([stem], numbered) if label not in labels))
    return labels


def check_one(beside: Sequence[object] | None, recordings: int) -> None:
    """Raise InputError if further files of one recording are given with several recordings."""
    if beside and recordings > 1:
        raise InputError("--with: adds files to one recording, and there are several; join its files before.")


def not_judged(path: str | os.PathLike[str], error: Exception) -> str:
    """The sentence for a held-out recording that cannot be used; the result stands without it."""
    source = os.fspath(path)
    return f"{source}: it was held out and cannot be compared: {str(error).removeprefix(f'{source}: ')}"
