"""Worker processes on this computer that share a computation: ``python -m fitting.parallel.workers``.

A worker reads tasks from a pipe and writes their results to another. It does not import the script that started it,
which therefore needs no ``if __name__ == "__main__"``; and it ends when its pipe closes, however the other process
ends.
"""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from operator import itemgetter
from threading import Lock, local
from typing import Any, BinaryIO, TypeVar

from .threads import ENVIRONMENT

Task = TypeVar("Task")
Answer = TypeVar("Answer")
Result = TypeVar("Result")

_READY = b"!"  # a worker's first word


def cores() -> int:
    """The number of cores available to this process."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on this system
        return os.cpu_count() or 1


class Workers:
    """``jobs`` processes, including this one; the others start with the first shared work.

    This process never waits for a starting worker, and repeats the tasks that a worker failed to do: it then raises an
    error as if there were no other process. After the first failure this process does all tasks.
    """

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool: ThreadPoolExecutor | None = None  # a thread for each process, which waits for its answers
        self._processes: list[subprocess.Popen[bytes]] = []
        self._lock, self._mine = Lock(), local()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def share(
        self, tasks: Sequence[Task], there: Callable[[Task], Answer], taken: Callable[[Answer], Result],
        here: Callable[[Task], Result],
    ) -> list[Result]:  # fmt: skip
        """The result of every task: by ``here`` in this process, or by ``there`` in another and ``taken`` in this one.

        there : a function of a module, which the worker finds by its name, or a partial of one; tasks and answers are
        pickled.
        """
        return [result for _, result in sorted(self._each(tasks, there, taken, here), key=itemgetter(0))]

    def stream(self, tasks: Sequence[Task], function: Callable[[Task], Answer]) -> Iterator[tuple[int, Answer]]:
        """(i, function(task i)) as they end, each once: those of other processes, and those that this one does.

        function : of a module, as in :meth:`share`.
        """
        return self._each(tasks, function, lambda answer: answer, function)

    def _each(
        self, tasks: Sequence[Task], there: Callable[[Task], Answer], taken: Callable[[Answer], Result],
        here: Callable[[Task], Result],
    ) -> Iterator[tuple[int, Result]]:  # fmt: skip
        """(i, result of task i) as they end."""
        if self.jobs < 2 or len(tasks) < 2:
            yield from ((i, here(task)) for i, task in enumerate(tasks))
            return
        pending = {answer: i for i, answer in enumerate(self._submitted(tasks, there))}
        try:
            while pending:
                mine = next((answer for answer in reversed(pending) if answer.cancel()), None)  # nobody has begun it
                if mine is None:
                    wait(pending, return_when=FIRST_COMPLETED)
                else:
                    i = pending.pop(mine)
                    yield i, here(tasks[i])
                for answer in [each for each in pending if each.done() and not each.cancelled()]:
                    i = pending.pop(answer)
                    yield i, taken(answer.result()) if self._answered(answer) else here(tasks[i])
        finally:
            for answer in pending:
                answer.cancel()

    def close(self) -> None:
        """End the other processes, whatever they do; this process does later tasks."""
        with self._lock:
            self.jobs, processes, self._processes = 1, self._processes, []
        for process in processes:
            _kill(process)
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        for process in processes:
            with suppress(OSError), process:  # waits for it, and closes its pipes
                pass

    def _submitted(self, tasks: Sequence[Task], there: Callable[[Task], Answer]) -> list[Future[Answer]]:
        """The future answers of other processes to all tasks that are not cancelled before they start."""
        module = getattr(there, "func", there).__module__  # of a partial, that of its function
        self._pool = self._pool or ThreadPoolExecutor(self.jobs - 1, "worker", self._begin, (module,))
        return [self._pool.submit(self._ask, there, task) for task in tasks]

    def _answered(self, answer: Future[Any]) -> bool:
        if answer.exception() is None:
            return True
        self.close()
        return False

    # --- in the thread of a process ---------------------------------------------------------------------------------

    def _begin(self, module: str) -> None:
        """Start a process that has imported a module; if it does not start, its tasks fail."""
        self._mine.process = None
        paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
        command = [sys.executable, "-P", "-m", __name__, module]
        with self._lock:
            if self.jobs < 2:
                return
            try:
                process = subprocess.Popen(
                    command,
                    env={**os.environ, **ENVIRONMENT, "PYTHONPATH": paths},
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,  # this process reports errors there
                    process_group=0,  # so that Ctrl-C comes here alone, and all that it starts can be ended with it
                )
            except OSError:
                return
            self._processes.append(process)
        if process.stdout is not None and process.stdout.read(len(_READY)) == _READY:
            self._mine.process = process

    def _ask(self, there: Callable[[Task], Answer], task: Task) -> Answer:
        process = self._mine.process
        if process is None:
            raise EOFError("no process")
        process.stdin.write(pickle.dumps((there, task)))
        process.stdin.flush()
        answer: Answer = pickle.load(process.stdout)
        return answer


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it started, such as FMUs that run."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (AttributeError, OSError):  # not on this system, or gone
        process.kill()


def serve(tasks: BinaryIO, answers: BinaryIO) -> None:
    """Do the tasks of a pipe until it ends."""
    answers.write(_READY)
    answers.flush()
    while tasks.peek(1):  # type: ignore[attr-defined]
        function, task = pickle.load(tasks)
        answers.write(pickle.dumps(function(task)))
        answers.flush()


if __name__ == "__main__":
    pipe = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # printed text must not mix with results
    importlib.import_module(sys.argv[1])
    serve(sys.stdin.buffer, pipe)
