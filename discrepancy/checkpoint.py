"""Checkpoints of a study on disk: an interrupted study continues where it stopped, and gives the same answer.

Every stage is one file in ``<folder>/.state``, written whole and bit for bit as computed. It contains only numbers,
texts and arrays, so that reading a foreign folder runs no code. A stage is valid only if its file is complete and was
made from the same inputs (record, network, thresholds and software, whose hash is the journal's key).
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import Term
from fitting.inference.places import Place
from fitting.inference.source_maps.source_evidence import Law
from fitting.inference.source_maps.source_map import Rival, Signal, SourceMap
from fitting.inference.unknown import Unknown
from solver.errors import InputError
from solver.io.saved import dataclasses, from_bytes, to_bytes
from solver.mesh import sources
from solver.network.files import write_whole

from .add.learning import Learnt
from .name.scoring import Named
from .name.verdict import Naming
from .show.fmu_validation import Gap, Run

Result = TypeVar("Result")

# classes that stages contain
_KINDS = dataclasses(
    Naming, Named, Fit, Term, Unknown, Run, Gap,
    SourceMap, Signal, Law, Rival, Place, Learnt, *sources.ALL,
)  # fmt: skip


class Journal:
    """The stages of one study in ``folder``; stages of another study there are ignored."""

    def __init__(self, folder: Path, inputs: Any) -> None:
        self.folder = folder / ".state"
        self.key = hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
        self.folder.mkdir(parents=True, exist_ok=True)

    def stage(self, name: str, compute: Callable[[], Result]) -> Result:
        """The result of a stage: read from its file, or computed and written."""
        path = self.folder / f"{name}.stage"
        with suppress(OSError, InputError):
            found: Result = from_bytes(path.read_bytes(), self.key, _KINDS)
            return found
        result = compute()
        write_whole(path, to_bytes(self.key, result, _KINDS))
        return result

    def naming(self, problem: Forward, compute: Callable[[], Naming], name: str = "naming") -> Naming:
        """A naming stage. It is stored without its problem, which is rebuilt with the stored weights."""
        kept, individual, weights = self.stage(name, lambda: parted(compute()))
        own = problem.individual() if individual else problem
        return replace(kept, problem=own.restored(weights))

    def close(self) -> None:
        """End the study: delete its state."""
        shutil.rmtree(self.folder, ignore_errors=True)


def parted(naming: Naming) -> tuple[Naming, bool, Any]:
    """A naming without its problem; whether the problem has individual walls; and the last weights of the problem."""
    problem = naming.problem
    return replace(naming, problem=None), bool(problem.deviations), problem.weights  # type: ignore[arg-type]
