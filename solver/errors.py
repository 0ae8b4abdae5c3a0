"""Errors of an input, and of a solution. Any other exception is a bug of the program, which no code may catch."""

from __future__ import annotations


class InputError(ValueError):
    """An unusable input; the message is the sentence for the user: quantity, value, remedy."""


class NonPhysicalState(ArithmeticError):
    """The solution left the validity of the equations at ``segment``, ``x`` [m] and time ``t`` [s]."""

    def __init__(self, reason: str, segment: str, x: float, t: float, remedy: str) -> None:
        self.reason, self.segment, self.x, self.t = reason, segment, x, t
        super().__init__(f"segment {segment} at x = {100 * x:.3g} cm, t = {t:.6g} s: {reason}; {remedy}.")


class NotConverged(NonPhysicalState):
    """The iterations of a step found no solution; a shorter step may have one."""
