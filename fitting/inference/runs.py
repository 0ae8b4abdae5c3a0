"""The resources of simulations: a counter, a deadline and worker processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..parallel.workers import Workers

TIME_IS_OVER = "the time limit is over before the search was complete; allow more time."


@dataclass
class Meter:
    """Counts simulations. tell : called with the number of parameter sets after every batch."""

    tell: Callable[[int], None] = lambda _: None
    simulations: int = 0

    def add(self, members: int) -> None:
        self.simulations += members
        self.tell(self.simulations)


class OutOfTime(Exception):
    """The deadline of the simulations has passed; earlier results remain valid."""


@dataclass(frozen=True)
class Runs:
    """The resources of simulations: a counter, a deadline and worker processes.

    deadline : of ``clock`` [s]; no batch runs beyond it. None: no limit.
    """

    meter: Meter = field(default_factory=Meter)
    deadline: float | None = None
    clock: Callable[[], float] = time.monotonic
    workers: Workers = field(default_factory=lambda: Workers(1))

    @property
    def left(self) -> float:
        """The time [s] until the deadline."""
        return np.inf if self.deadline is None else self.deadline - self.clock()

    def part(self, share: float) -> Runs:
        """The same with a share of the time that is left."""
        if self.deadline is None:
            return self
        now = self.clock()
        return replace(self, deadline=now + share * max(self.deadline - now, 0.0))

    def check(self) -> None:
        """Raise OutOfTime after the deadline."""
        if self.deadline is not None and self.clock() > self.deadline:
            raise OutOfTime(TIME_IS_OVER)
