"""Ctrl-C, where an exception in between would be lost or leave half of the work."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def interrupts_later() -> Iterator[Callable[[], None]]:
    """Ctrl-C is answered at the end of the block, or when the function that it gives is called, not in between."""
    answer = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(answer):
        yield lambda: None  # no signal comes here
        return
    came: list[tuple[int, Any]] = []

    def due() -> None:
        if came:
            answer(*came.pop())

    signal.signal(signal.SIGINT, lambda *signalled: came.append(signalled))
    try:
        yield due
    finally:
        signal.signal(signal.SIGINT, answer)
    due()
