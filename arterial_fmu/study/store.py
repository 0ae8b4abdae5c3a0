"""Run a study in its folder: its plan, a file for every finished batch, and finally the results.

plan.json defines the study; parts/00012.parquet contains the results of batch 12, written whole or not at all. When all
parts exist, they are merged into sets.parquet and waveforms.parquet, and removed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from fitting.parallel.tasks import done
from fitting.results.result_files import check_unmixed, json_text
from solver.errors import InputError
from solver.io.writing import make_folder, write_folder, write_whole

from .batch import FAILED, SET, Batch, parquet, run_batch
from .plan import Array, Plan

Progress = Callable[[float, str], None]

CHECK = "check"  # the part with the sets that were run with finer steps
GROUP = "group"
# what the keys of a plan are on the command line
_OPTIONS = {
    "model": "network, inflow or step", "varied": "--vary", "base": "--samples", "sites": "--sites", "seed": "--seed"
}  # fmt: skip


class Store:
    """A study's folder, created if it is missing. Raises ValueError if it contains another study."""

    def __init__(self, folder: str | os.PathLike[str], plan: Plan) -> None:
        self.folder, self.plan = Path(folder), plan
        path = self.folder / "plan.json"
        check_unmixed(self.folder, "study")
        text = json_text(plan.manifest)
        if path.is_file():
            different = _difference(_read(path), json.loads(text))
            if different:
                raise InputError(
                    f"{self.folder}: it contains another study ({different}); give another folder, or the same options."
                )
        write_folder(self.folder, {path.name: text})

    @property
    def whole(self) -> bool:
        """True if the results exist."""
        return (self.folder / "sets.parquet").is_file()

    def part(self, name: int | str) -> Path:
        """The file of a batch."""
        return self.folder / "parts" / (f"{name:05d}.parquet" if isinstance(name, int) else f"{name}.parquet")

    def has(self, name: int | str) -> bool:
        """True if a batch is finished."""
        return self.part(name).is_file()

    def keep(self, name: int | str, content: bytes) -> None:
        """Write the result of a batch."""
        make_folder(self.folder / "parts")
        write_whole(self.part(name), content)

    def finish(self) -> None:
        """Merge the parts, which must all exist, into waveforms.parquet and, last, sets.parquet."""
        plan = self.plan
        parts = [self.part(i) for i in range(len(plan.batches))]
        frame = pl.concat([_table(path) for path in parts])
        numbers = pl.DataFrame({each.name: plan.x[:, i] for i, each in enumerate(plan.varied)})
        groups = pl.DataFrame({GROUP: pl.Series([i // plan.group for i in range(plan.size)], dtype=pl.Int64)})
        results = pl.concat(
            [frame.select(SET), groups, numbers, frame.select(*plan.measures, FAILED)], how="horizontal"
        )
        finer = {"finer.parquet": parquet(_table(self.part(CHECK)))} if plan.checked.size else {}
        waveforms = parquet(frame.select(SET, *plan.waves))
        write_folder(self.folder, finer | {"waveforms.parquet": waveforms, "sets.parquet": parquet(results)})
        for path in (self.folder / "parts").glob("*.parquet"):
            path.unlink()
        (self.folder / "parts").rmdir()

    def read(self, name: str) -> pl.DataFrame:
        """A result: sets, waveforms, or finer."""
        return _table(self.folder / f"{name}.parquet")


def _table(path: Path) -> pl.DataFrame:
    try:
        return pl.read_parquet(path.read_bytes())
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(f"{path}: cannot be read ({str(error).splitlines()[0]}); remove it, and go on.") from None


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(f"{path}: not the plan of a study; give another folder.") from None


def _difference(there: Any, asked: Mapping[str, Any]) -> str:
    """The options in which the stored study differs from the requested one, in words; "" if there is none."""
    if not isinstance(there, Mapping):
        return "its plan is not readable"
    keys = [key for key in asked if asked[key] != there.get(key)]
    if "sites" in keys:  # a model reports these sites alone, and so differs with them
        keys = [key for key in keys if key != "model"]
    found = []
    for key in keys:
        mine, its = asked[key], there.get(key)
        short = isinstance(mine, int | str) and isinstance(its, int | str) and key != "base"
        option = _OPTIONS.get(key, key)
        found.append(f"{option} {its}, not {mine}" if short else f"another {option}")
    return ", ".join(found)


def run(
    plan: Plan,
    store: Store,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
    meanwhile: Callable[[], None] | None = None,
) -> int:
    """Simulate the missing batches, and write the results; return the number of parameter sets simulated now.

    jobs, scheduler : as in :func:`fitting.parallel.tasks.done`. Every finished batch is saved, so that an interrupted
    study resumes. meanwhile : called once, after the first batch, while other processes simulate the next ones.
    Raises ValueError for a folder that cannot be written, or if no parameter set could be simulated.
    """
    if store.whole:
        return 0
    names = [*([CHECK] if plan.checked.size else []), *range(len(plan.batches))]
    missing = [name for name in names if not store.has(name)]
    sets, simulated = plan.size - sum(_sets(plan, name) for name in missing), 0
    if progress:
        progress(sets / plan.size, f"{sets} of {plan.size} parameter sets")
    for i, content in done(run_batch, [_batch(plan, name) for name in missing], jobs, scheduler):
        store.keep(missing[i], content)
        if meanwhile:
            meanwhile()
            meanwhile = None
        simulated += _sets(plan, missing[i])
        if progress:
            progress((sets + simulated) / plan.size, f"{sets + simulated} of {plan.size} parameter sets")
    store.finish()
    return simulated


def _sets(plan: Plan, name: int | str) -> int:
    """The number of the plan's sets in a batch."""
    return len(plan.batches[name]) if isinstance(name, int) else 0


def _batch(plan: Plan, name: int | str) -> Batch:
    if isinstance(name, int):
        sets = plan.batches[name]
        return Batch(plan.model, sets, plan.parameters(sets), tuple(plan.measures), plan.waves)
    model = plan.model.finer()
    assert model is not None  # otherwise no sets are checked
    return Batch(model, plan.checked, plan.parameters(plan.checked), (), plan.waves)


def finer_differences(store: Store) -> dict[str, Array]:
    """The difference of beats (n,), by channel, from those with half the step and half the element length.

    Relative L2 difference, of a pressure to its norm without the mean; empty without a comparison.
    """
    if not store.plan.checked.size:
        return {}
    fine = store.read("finer")
    coarse = store.read("waveforms")[store.plan.checked.tolist()]
    both = (fine[FAILED].is_null() & ~coarse[store.plan.waves[0]].is_null()).to_numpy()
    found = {}
    for name in store.plan.waves if both.any() else ():
        x, y = (np.array(frame.filter(both)[name].to_list(), float) for frame in (coarse, fine))
        size = y - y.mean(axis=1, keepdims=True) if name.endswith(".P") else y
        found[name] = np.linalg.norm(x - y, axis=1) / np.linalg.norm(size, axis=1)
    return found
