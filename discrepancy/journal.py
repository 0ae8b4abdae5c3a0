"""What a study has done so far, on disk: an interrupted one goes on where it was, and gives the same answer.

Every stage is one pickle in ``<folder>/.state``, written whole, bit for bit what was computed. A stage counts only if
it was made from the same inputs (record, network, thresholds and software, whose hash is the journal's key) and if the
file is whole. A pickle runs code when it is read: a study goes on in a folder of one's own, not in one from elsewhere.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fitting.inference.forward import Forward
from solver.files import write_whole

from .verdict import Naming

Result = TypeVar("Result")


class Journal:
    """The stages of one study in ``folder``; those of another study there do not count."""

    def __init__(self, folder: Path, inputs: Any) -> None:
        self.folder = folder / ".state"
        self.key = json.dumps(inputs, sort_keys=True).encode()
        self.folder.mkdir(parents=True, exist_ok=True)

    def stage(self, name: str, compute: Callable[[], Result]) -> Result:
        """The result of a stage: read if it is there, else computed and written."""
        path = self.folder / f"{name}.pickle"
        try:
            seal, content = path.read_bytes().split(b"\n", 1)
        except (OSError, ValueError):
            seal = content = b""
        if seal and seal == self._seal(content):
            found: Result = pickle.loads(content)
            return found
        result = compute()
        content = pickle.dumps(result)
        write_whole(path, self._seal(content) + b"\n" + content)
        return result

    def naming(self, problem: Forward, compute: Callable[[], Naming]) -> Naming:
        """The stage "naming", which is kept without its problem: that is made anew, weighted as it was."""
        kept, individual, weights = self.stage("naming", lambda: parted(compute()))
        own = problem.individual() if individual else problem
        return replace(kept, problem=own.restored(weights))

    def close(self) -> None:
        """The study is done: its state is no longer needed."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _seal(self, content: bytes) -> bytes:
        """A hash of the inputs and of a stage."""
        return hashlib.sha256(self.key + b"\n" + content).hexdigest().encode()


def parted(naming: Naming) -> tuple[Naming, bool, Any]:
    """A naming without its problem; whether that has deviations of every artery; what it was weighted with at last."""
    problem = naming.problem
    return replace(naming, problem=None), bool(problem.deviations), problem.weights  # type: ignore[arg-type]
