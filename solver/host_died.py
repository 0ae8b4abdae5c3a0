"""What is said where a process that ran an FMU died: neither the record nor the model is to blame."""

from __future__ import annotations

import os
import signal

from .exit_codes import ExitCode


class HostDied(RuntimeError):
    """A process that ran an FMU died; the message says which, how, and what to do."""

    exit_code = ExitCode.DOES_NOT_RUN

    def __init__(self, fmu: str | os.PathLike[str], code: int, said: str = "") -> None:
        last = f", its last words: {said.rstrip('.')}" if said else ""
        super().__init__(
            f"{os.fspath(fmu)}: the process that ran it {ended(code)}{last}; ask arterial-fmu doctor "
            f"{os.fspath(fmu)}, and report it with what that says."
        )


def ended(code: int) -> str:
    """How a process ended, from its exit code, which is negative after a signal: "died of signal 11 (SIGSEGV)"."""
    try:
        return f"died of signal {-code} ({signal.Signals(-code).name})"
    except ValueError:
        return f"ended with exit code {code}"
