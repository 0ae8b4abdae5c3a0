"""A command in a process of its own, so that its death can be told."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

_APART = "ARTERIAL_FMU_APART"  # in the environment of that process
_ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_PR_SET_PDEATHSIG = 1  # of linux/prctl.h


def is_apart() -> bool:
    """Whether this is that process."""
    return _APART in os.environ


def end_with_parent() -> None:
    """Take the end of the process that started this one for Ctrl-C, even one that could not tell; on Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


def run_apart(words: Sequence[str]) -> int:
    """Run ``arterial-fmu WORDS`` in a process of its own; its exit code, after a sentence if it died.

    It has a session of its own, so that Ctrl-C reaches it once: from here. Whatever ends this process is Ctrl-C to it.
    """
    line = [sys.executable, "-m", "arterial_fmu", *words]
    process = subprocess.Popen(line, env={**os.environ, _APART: "1"}, start_new_session=True)
    came: list[int] = []

    def pass_on(number: int, _frame: Any) -> None:
        came.append(number)
        process.send_signal(signal.SIGINT)

    for number in _ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # as nohup has it
            signal.signal(number, pass_on)
    code = process.wait()
    if came and code in (128 + signal.SIGINT, -signal.SIGINT):
        return 128 + came[0]
    if code >= 0:
        return code
    from solver.console import complain
    from solver.host_died import HostDied

    died = HostDied(next((word for word in words if word.lower().endswith(".fmu")), "the FMU"), code)
    complain(f"Error: {died}")
    return int(died.exit_code)
