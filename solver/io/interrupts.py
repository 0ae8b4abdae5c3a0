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
    answer = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(answer):
        yield lambda: None  # signals arrive in the main thread only
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
