"""The exit codes of all commands of this project; docs/command-line.md says what each means."""

from __future__ import annotations

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
