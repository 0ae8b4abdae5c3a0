"""A command in its own process, so that its death can be reported."""

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
    """Treat the end of the parent process as Ctrl-C, even if it was killed; on Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT)


def run_apart(words: Sequence[str]) -> int:
    """Run ``arterial-fmu WORDS`` in its own process; return its exit code, after a sentence if it died.

    The process has its own session, so that it receives Ctrl-C once, from here. Any end of this process is Ctrl-C to
    it.
    """
    line = [sys.executable, "-m", "arterial_fmu", *words]
    process = subprocess.Popen(line, env={**os.environ, _APART: "1"}, start_new_session=True)
    came: list[int] = []

    def pass_on(number: int, _frame: Any) -> None:
        came.append(number)
        process.send_signal(signal.SIGINT)

    for number in _ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
            signal.signal(number, pass_on)
    code = process.wait()
    if came and code in (128 + signal.SIGINT, -signal.SIGINT):
        return 128 + came[0]
    if code >= 0:
        return code
    from arterial_fmu.cli.terminal.console import complain
    from solver.io.exit_codes import HostDied

    died = HostDied(next((word for word in words if word.lower().endswith(".fmu")), "the FMU"), code)
    complain(f"Error: {died}")
    return int(died.exit_code)
