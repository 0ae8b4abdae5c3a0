"""Sentences about several recordings of one animal."""

from __future__ import annotations

import os
from collections.abc import Sequence

from solver.errors import InputError


def check_one(beside: Sequence[object] | None, recordings: int) -> None:
    """Raise InputError if further files of one recording are given with several recordings."""
    if beside and recordings > 1:
        raise InputError("--with: adds files to one recording, and there are several; join its files before.")


def not_judged(path: str | os.PathLike[str], error: Exception) -> str:
    """The sentence for a held-out recording that cannot be used; the result stands without it."""
    source = os.fspath(path)
    return f"{source}: it was held out and cannot be compared: {str(error).removeprefix(f'{source}: ')}"
