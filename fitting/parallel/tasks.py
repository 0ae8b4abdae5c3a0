"""Independent tasks on the processes of this computer, or on a cluster: each result once, as its task ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from solver.errors import InputError

from .workers import Workers, cores

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def done(
    function: Callable[[Task], Answer], tasks: Sequence[Task], jobs: int | None = None, scheduler: str | None = None
) -> Iterator[tuple[int, Answer]]:
    """(i, function(task i)) of every task, as they end.

    function : of a module, found by its name in other processes, or a partial of one; tasks and answers are pickled.
    jobs : number of processes on this computer, including this one; None: one per core. This process does the
    unfinished tasks of a worker that dies. scheduler : the address of a scheduler of dask.distributed, whose workers do
    the tasks instead (:mod:`.cluster`). Raises ValueError for an invalid number of jobs, or a scheduler that does not
    answer. Exceptions of the function are raised, too.
    """
    if scheduler is not None:
        from .cluster import stream

        yield from stream(function, tasks, scheduler)
        return
    if jobs is not None and jobs < 1:
        raise InputError(f"jobs {jobs!r}: must be a whole number of processes, at least 1.")
    with Workers(cores() if jobs is None else jobs) as workers:
        yield from workers.stream(tasks, function)
