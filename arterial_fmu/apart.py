"""A command in a process of its own, so that its death can be told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence

_APART = "ARTERIAL_FMU_APART"  # in the environment of that process


def is_apart() -> bool:
    """Whether this is that process."""
    return _APART in os.environ


def run_apart(words: Sequence[str]) -> int:
    """Run ``arterial-fmu WORDS`` in a process of its own; its exit code, after a sentence if it died.

    It has a session of its own, so that Ctrl-C reaches it once: from here.
    """
    line = [sys.executable, "-m", "arterial_fmu", *words]
    process = subprocess.Popen(line, env={**os.environ, _APART: "1"}, start_new_session=True)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: process.send_signal(number))
    code = process.wait()
    if code >= 0 or -code in (signal.SIGINT, signal.SIGTERM):
        return code if code >= 0 else 128 - code
    from solver.console import complain
    from solver.host_died import HostDied

    died = HostDied(next((word for word in words if word.lower().endswith(".fmu")), "the FMU"), code)
    complain(f"Error: {died}")
    return int(died.exit_code)
