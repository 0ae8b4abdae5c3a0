"""Ctrl-C where an immediate exception would be lost or leave half of the work."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def interrupts_later() -> Iterator[Callable[[], None]]:
    """Delay Ctrl-C to the end of the block, or to a call of the function that it yields."""
    answer = _answer()
    if answer is None:
        yield lambda: None
        return
    with _noted(answer, at_once=False) as due:
        yield due
    due()


@contextmanager
def interrupts_again() -> Iterator[Callable[[], None]]:
    """Answer Ctrl-C at once, and where its exception was lost once more at a call of the function that it yields.

    Libraries clear errors that are none to them, as of a failed import or of a missing attribute looked up in C;
    KeyboardInterrupt goes with these.
    """
    answer = _answer()
    if answer is not signal.default_int_handler:  # a host's own answer need raise nothing
        yield lambda: None
        return
    with _noted(answer, at_once=True) as due:
        yield due


@contextmanager
def _noted(answer: Callable[..., Any], at_once: bool) -> Iterator[Callable[[], None]]:
    """Note Ctrl-C, answered at once or not; the function that it yields answers what is noted."""
    came: list[tuple[int, Any]] = []

    def note(*signalled: Any) -> None:
        came.append(signalled)
        if at_once:
            answer(*signalled)

    def due() -> None:
        if came:
            answer(*came.pop())

    signal.signal(signal.SIGINT, note)
    try:
        yield due
    finally:
        signal.signal(signal.SIGINT, answer)


def _answer() -> Callable[..., Any] | None:
    """What answers Ctrl-C; None where nothing in Python does, or in another thread than the main one, which gets it."""
    answer = signal.getsignal(signal.SIGINT)
    return answer if threading.current_thread() is threading.main_thread() and callable(answer) else None
