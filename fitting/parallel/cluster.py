"""Tasks on an existing cluster of dask.distributed, which is imported on first use."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar
from urllib.parse import urlsplit

from solver.errors import InputError

from ..results.provenance import software
from .threads import single_threaded

Task = TypeVar("Task")
Answer = TypeVar("Answer")

CONNECT = 10.0  # s, timeout of a scheduler
APPEAR = 60.0  # s, timeout for its first worker


def stream(function: Callable[[Task], Answer], tasks: Sequence[Task], scheduler: str) -> Iterator[tuple[int, Answer]]:
    """(i, function(task i)) of every task as they end, each once.

    If a worker dies, the scheduler gives its tasks to others, including finished ones whose result was not yet
    returned; returned results are not computed again. Linear algebra uses one thread: start one worker per core. Raises
    ValueError if distributed is not installed, no scheduler answers, it has no workers, or they have another version of
    this package; and what the function raises.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise InputError("--scheduler: distributed is not installed; run pip install 'arterial-fmu[scale]'.") from None
    if not tasks:
        return
    with _client(Client, scheduler) as client:
        _await_worker(client, scheduler)
        mine = software()
        pending = {client.submit(_done, function, task, mine, pure=False): i for i, task in enumerate(tasks)}
        for future in as_completed(list(pending), loop=client.loop):
            i = pending.pop(future)
            answer = _answer(future, scheduler)
            future.release()
            yield i, answer


def _client(make: Callable[..., Any], scheduler: str) -> Any:
    """A client of the scheduler. Raises ValueError if it does not answer."""
    try:
        address = urlsplit(scheduler)
        host, port = address.hostname, address.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise InputError(f"--scheduler {scheduler}: not an address; write it like tcp://192.168.0.1:8786.")
    try:
        socket.create_connection((host, port), CONNECT).close()  # a failing client would keep trying for a while
        return make(scheduler, timeout=CONNECT, set_as_default=False)
    except OSError as error:  # a timeout is an OSError
        raise InputError(
            f"--scheduler {scheduler}: no scheduler answers there ({error.strerror or error}); start one with "
            "dask scheduler, or check the address."
        ) from None


def _await_worker(client: Any, scheduler: str) -> None:
    try:
        client.wait_for_workers(1, timeout=APPEAR)
    except TimeoutError:
        raise InputError(
            f"--scheduler {scheduler}: it has no workers after {APPEAR:g} s; start some with dask worker {scheduler}."
        ) from None


def _answer(future: Any, scheduler: str) -> Any:
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise InputError(
            f"--scheduler {scheduler}: several workers died with the same task ({str(error).splitlines()[0]}); look at "
            "their logs, and give them more memory."
        ) from None


@single_threaded
def _done(function: Callable[[Task], Answer], task: Task, software_there: str) -> Answer:
    """A task in a worker."""
    if software() != software_there:
        raise InputError(
            f"a worker of the cluster has {software()}, this process {software_there}; install the same version there."
        )
    return function(task)
