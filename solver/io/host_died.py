"""The error for a process that died while it ran an FMU: neither the record nor the model is the cause."""

from __future__ import annotations

import os
import signal

from .exit_codes import ExitCode


class HostDied(RuntimeError):
    """A process that ran an FMU died; the message gives the FMU, the reason and the remedy."""

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
