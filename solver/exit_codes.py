"""What every command of this project ends with, in one table."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """How a command ended."""

    DONE = 0
    DOES_NOT_RUN = 1
    BAD_INPUT = 2
    UNUSABLE = 3
    FAULT = 70
    INTERRUPTED = 130
    NOT_READ = 141


MEANING = {
    ExitCode.DONE: "done, whatever was found: a fit, a check that disagrees, a verdict",
    ExitCode.DOES_NOT_RUN: "an FMU does not run here, or ended the process that ran it",
    ExitCode.BAD_INPUT: "something given is wrong; one sentence on the error stream says what, and what to do",
    ExitCode.UNUSABLE: "`discover`: the record cannot be used; the report says why",
    ExitCode.FAULT: "a fault of the program: a traceback on the error stream; please report it",
    ExitCode.INTERRUPTED: "interrupted by Ctrl-C",
    ExitCode.NOT_READ: "what was to read the output, such as `head`, closed it before its end",
}


def markdown() -> str:
    """The table of docs/command-line.md."""
    return "\n".join(["| Code | Meaning |", "|---|---|", *(f"| {code:d} | {MEANING[code]} |" for code in ExitCode)])
