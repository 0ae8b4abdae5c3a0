"""What a study has done so far, on disk: an interrupted one goes on where it was, and gives the same answer.

Every stage is one file in ``<folder>/.state``, written whole: the journal's key, and the pickled result. A stage counts
only if it was made from the same inputs: record, network, thresholds and software, whose hash is the key. A pickle runs
code when it is read: a study goes on in a folder of one's own, not in one from elsewhere.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fitting.inference.forward import Forward
from solver.files import write_whole

from .name import Naming

Result = TypeVar("Result")


class Journal:
    """The stages of one study in ``folder``; those of another study there are thrown away."""

    def __init__(self, folder: Path, inputs: Any) -> None:
        self.folder = folder / ".state"
        self.key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
        self.folder.mkdir(parents=True, exist_ok=True)

    def stage(self, name: str, compute: Callable[[], Result]) -> Result:
        """The result of a stage: read if it is there, else computed and written."""
        path = self.folder / f"{name}.pickle"
        head = self.key.encode()
        if path.is_file():
            data = path.read_bytes()
            if data.startswith(head):  # of this study: nothing else is unpickled
                with suppress(pickle.UnpicklingError, EOFError):  # cut off
                    found: Result = pickle.loads(data[len(head) :])
                    return found
        result = compute()
        write_whole(path, head + pickle.dumps(result))
        return result

    def naming(self, problem: Forward, compute: Callable[[], Naming]) -> Naming:
        """The stage "naming", which is kept without its problem: that is made anew, weighted as it was."""
        kept, weights = self.stage("naming", lambda: parted(compute()))
        return replace(kept, problem=problem.restored(weights))

    def close(self) -> None:
        """The study is done: its state is no longer needed."""
        shutil.rmtree(self.folder, ignore_errors=True)


def parted(naming: Naming) -> tuple[Naming, Any]:
    """A naming without its problem, and what that was weighted with at last."""
    return replace(naming, problem=None), naming.problem.weights  # type: ignore[arg-type]
