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
from pathlib import Path
from typing import Any, TypeVar

from fitting.inference.fit import Fit
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.bench import Bench
from fitting.inference.models.loop import Loop
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.simulator import Forced, Simulator
from fitting.inference.places import Place
from fitting.inference.source_maps.source_evidence import Law
from fitting.inference.source_maps.source_map import Rival, Signal, SourceMap
from fitting.inference.unknown import Unknown
from fitting.records.alignment.beats import Beats
from fitting.records.alignment.variable_beats import VariableBeats
from fitting.records.channels.inflow import Inflow
from fitting.records.channels.noise import Target
from fitting.records.channels.variability import BeatVariation
from solver import Settings
from solver.errors import InputError
from solver.io.saved import Kind, dataclasses, from_bytes, to_bytes
from solver.mesh import sources
from solver.network.description import Network, from_dict, to_dict
from solver.network.files import write_whole

from .add.learning import Learnt
from .name.scoring import Named
from .name.verdict import Naming
from .show.fmu_validation import Gap, Run

Result = TypeVar("Result")

_FORMAT = 5  # of the stages: another one makes those of an earlier program invalid

# classes that stages contain
_KINDS = dataclasses(
    Naming, Named, Fit, PlacedEffect, Unknown, Run, Gap,
    SourceMap, Signal, Law, Rival, Place, Learnt, *sources.ALL,
    NetworkProblem, Bench, Several, Simulator, Forced, Settings, Inflow, Loop, Beats, VariableBeats, Target,
    BeatVariation,
)  # fmt: skip
_KINDS[Network] = Kind(lambda it: {"text": json.dumps(to_dict(it))}, lambda text: from_dict(json.loads(text)))


class Journal:
    """The stages of one study in ``folder``; stages of another study there are ignored."""

    def __init__(self, folder: Path, inputs: Any) -> None:
        self.folder = folder / ".state"
        self.key = hashlib.sha256(json.dumps([_FORMAT, inputs], sort_keys=True).encode()).hexdigest()
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

    def close(self) -> None:
        """End the study: delete its state."""
        shutil.rmtree(self.folder, ignore_errors=True)
