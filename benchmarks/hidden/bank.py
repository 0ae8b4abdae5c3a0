"""A file of diagnosed records, one JSON line each, appended as they finish, so that a killed run can be resumed."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import track

from fitting.parallel.tasks import done
from tests.truth.plan import whole

from .row import Line, row

ROOT = Path(__file__).resolve().parents[2]
JUDGED_BY = ("discrepancy", "fitting", "solver", "tests/truth")


class NotThisBank(ValueError):
    """The file contains records of another plan or of other sources; the message gives the remedy."""


@dataclass(frozen=True)
class Bank:
    """Records of the plan of ``group``, ``kind`` and ``seed`` in a file, judged by sources of one hash."""

    path: Path
    kind: str
    seed: int
    sources: str
    group: str = "standard"

    def lines(self) -> list[Line]:
        """The whole lines of the file; a half-written last one is cut off.

        Raises NotThisBank if they are of another plan, or of other sources.
        """
        found = read(self.path)
        foreign = [x for x in found if (x["kind"], x["seed"]) != (self.kind, self.seed)]
        if foreign:
            x = foreign[0]
            raise NotThisBank(
                f"{self.path} holds {x['kind']} records of seed {x['seed']}, not {self.kind} records of seed "
                f"{self.seed}; give another file by --out."
            )
        other = sum(x["sources"] != self.sources for x in found)
        if other:
            raise NotThisBank(
                f"{self.path}: {other} of {len(found)} records were judged by other sources ({', '.join(JUDGED_BY)}) "
                "than these; give another file by --out, or remove it."
            )
        return found

    def run(self, limit: int | None, jobs: int, least: float = 0.0, first: int = 0) -> None:
        """Judge the first ``limit`` records of the plan that are not yet in the file. least : of d', below which a
        record is not judged. first : index of the plan to begin at."""
        judged = {x["index"] for x in self.lines()}
        cases = whole(self.kind, self.group, self.seed)[:limit]
        todo = [i for i in range(first, len(cases)) if i not in judged]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        tasks = [(self.kind, self.seed, i, cases[i], self.group, least) for i in todo]
        lines, said = done(_row, tasks, jobs), f"{self.group} {self.kind} records, {len(todo)} to judge"
        with self.path.open("a", encoding="utf-8") as file:
            for _, line in track(lines, said, total=len(todo), console=Console(stderr=True)):
                file.write(json.dumps(line | {"sources": self.sources}) + "\n")
                file.flush()


def _row(arguments: tuple[Any, ...]) -> Line:
    return row(*arguments)


def read(path: Path) -> list[Line]:
    """The lines of a file, in the order of the plan; none if there is no file. What a killed run left half-written is
    cut off."""
    if not path.exists():
        return []
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) < len(text):
        path.write_bytes(whole)
    return sorted((json.loads(line) for line in whole.splitlines()), key=lambda x: x["index"])


def sources_hash(root: Path = ROOT) -> str:
    """Hash of all code that makes or diagnoses a record."""
    digest = hashlib.sha256()
    for folder in JUDGED_BY:
        place = root / folder
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
