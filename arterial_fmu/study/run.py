"""Run a study: the unfinished batches of its plan, then its results."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fitting.parallel.tasks import done

from .batch import FAILED, Batch, run_batch
from .plan import Array, Plan
from .store import CHECK, Store

Progress = Callable[[float, str], None]


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

    jobs, scheduler : as in :func:`fitting.parallel.tasks.done`. Every finished batch is saved, so an interrupted study
    resumes.
    meanwhile : called once, after the first batch, while other processes simulate the next ones.
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
