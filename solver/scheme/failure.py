"""The errors of a solution that is not physical, or not found."""

from __future__ import annotations


class NonPhysicalState(ArithmeticError):
    """The solution left what the equations describe. ``segment``, ``x`` [m] and ``t`` [s] say where and when."""

    def __init__(self, reason: str, segment: str, x: float, t: float, remedy: str) -> None:
        self.reason, self.segment, self.x, self.t = reason, segment, x, t
        super().__init__(f"segment {segment} at x = {100 * x:.3g} cm, t = {t:.6g} s: {reason}; {remedy}.")


class NotConverged(NonPhysicalState):
    """The iterations of a step found no solution: a shorter one may have one."""
