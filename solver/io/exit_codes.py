"""The exit codes of all commands of this project, in one table."""

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


MEANING = {
    ExitCode.DONE: "the command finished, whatever its result: a fit, a check that disagrees, a verdict",
    ExitCode.DOES_NOT_RUN: "an FMU does not run on this machine, or ended the process that ran it",
    ExitCode.BAD_INPUT: "an input is wrong; one sentence on the error stream names the error and the remedy",
    ExitCode.UNUSABLE: "`discover`: the record is unusable; the report gives the reason",
    ExitCode.FAULT: "a bug in the program, with a traceback on the error stream; please report it",
    ExitCode.INTERRUPTED: "interrupted by Ctrl-C",
    ExitCode.NOT_READ: "the reader of the output, such as `head`, closed it early",
}


def markdown() -> str:
    """The table of docs/command-line.md."""
    return "\n".join(["| Code | Meaning |", "|---|---|", *(f"| {code:d} | {MEANING[code]} |" for code in ExitCode)])
