"""The folder of a study: what may be in its way, and its files, written all together."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from fitting.result_files import check_unmixed, json_text
from solver.errors import InputError
from solver.files import dumps
from solver.writing import check_destinations, make_folder, write_folder

from .learned_text import FILES, learned_files
from .outcome import Outcome, verdict_json

Progress = Callable[[float, str], None]

_STATE = ".state"  # the journal's folder
_FILES = ("model.toml", "model.fmu", *FILES, "report.html", "verdict.json")  # of a study, as they are written


def check_folder(folder: Path, given: Iterable[str | os.PathLike[str] | None]) -> None:
    """Make the folder of a study; raise ValueError now, not after all work, if something there is in its way.

    given : the files that the study is of, which it neither replaces nor removes.
    """
    check_unmixed(folder, "discover")
    for path in (folder / _STATE, folder / "figures"):
        if path.exists() and not path.is_dir():
            raise InputError(f"{path}: is a file where a study has a folder; move it, or give another --out.")
    for path in (folder / file for file in _FILES):
        if path.is_dir():
            raise InputError(f"{path}: is a folder where a study has a file; move it, or give another --out.")
    check_destinations(*(folder / file for file in _FILES), given=given, folders=True)
    make_folder(folder)


def write_study(outcome: Outcome, fmu: bytes | None, folder: Path, progress: Progress) -> None:
    """All files of a study, the verdict last; those of an earlier one that this verdict does not have are removed.

    A folder with a verdict.json always holds the files that belong to it.
    """
    from . import report  # matplotlib takes a second

    progress(0.94, "writing the report")
    files: dict[str, str | bytes] = {}
    if outcome.network_after is not None and fmu is not None:
        files = {"model.toml": dumps(outcome.network_after), "model.fmu": fmu}
    files |= learned_files(outcome.learned, outcome.map if outcome.verdict in ("unknown", "partial") else None)
    files |= report.report_files(outcome) | {"verdict.json": json_text(verdict_json(outcome))}
    write_folder(folder, files, gone={*report.figure_files(), *_FILES} - set(files))
    progress(1.0, "done")


def holds_study(folder: Path) -> bool:
    """Whether a study is in a folder whose record could be used."""
    try:
        return bool(json.loads((folder / "verdict.json").read_text(encoding="utf-8"))["verdict"] != "unusable")
    except (OSError, ValueError, LookupError, TypeError):
        return (folder / "model.toml").exists()
