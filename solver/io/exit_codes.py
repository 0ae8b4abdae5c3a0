"""The exit codes of all commands, which docs/command-line.md explains, and the error for a process that died."""

from __future__ import annotations

import os
import signal
from enum import IntEnum


class ExitCode(IntEnum):
    """The exit code of a command."""

    DONE = 0
    DOES_NOT_RUN = 1
    BAD_INPUT = 2
    UNUSABLE = 3
    FAULT = 70
    INTERRUPTED = 130
    NOT_READ = 141


class HostDied(RuntimeError):
    """A process that ran an FMU died: neither the record nor the model is the cause. The message gives the FMU, the
    reason and the remedy."""

    exit_code = ExitCode.DOES_NOT_RUN

    def __init__(self, fmu: str | os.PathLike[str], code: int, message: str = "") -> None:
        last = f", its last words: {message.rstrip('.')}" if message else ""
        super().__init__(
            f"{os.fspath(fmu)}: the process that ran it {ended(code)}{last}; ask arterial-fmu doctor "
            f"{os.fspath(fmu)}, and report it with what that says."
        )


def ended(code: int) -> str:
    """The end of a process in words, from its exit code, negative after a signal: "died of signal 11 (SIGSEGV)"."""
    try:
        return f"died of signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"ended with exit code {code}"
