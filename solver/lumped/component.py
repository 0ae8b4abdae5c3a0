"""What an FMU computes, without FMI: a component."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from ..errors import InputError
from ..io.saved import Kind

_SLACK = 2e-9  # s, by which the communication points of a master may differ from ours by round-off


def check_time(t: float, h: float, stands: float, slack: float = _SLACK) -> None:
    """Raise ValueError unless a step from t of length h [s] begins where the component stands."""
    if not (math.isfinite(h) and h > 0.0):
        raise InputError(f"communication step of {h:g} s: must be positive.")
    if not abs(t - stands) <= slack + 1e-12 * abs(t):
        raise InputError(
            f"step from t = {t:.9g} s, but the component stands at {stands:.9g} s; step on from there or reset."
        )


class Component(ABC):
    """What an FMU computes. Values come and go by variable name: numbers in SI, of an Enumeration the name of its item.

    A component changes no object in place: a step or a new parameter puts new objects into its attributes. So a copy
    of ``vars(component)`` is its state, saved and restored in microseconds. For a state in bytes the attributes but
    those in ``remade`` are plain values (numbers, texts, truth values, None; lists, tuples and dicts of such), NumPy
    arrays of numbers, or objects of ``kinds()``.
    """

    remade: ClassVar[frozenset[str]] = frozenset()  # attributes that the constructor or ``resumed`` makes
    remark: str = ""  # what is to be known of the last step, a sentence for the log

    @abstractmethod
    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Begin at t0 [s] with the values of all inputs and parameters; ValueError if they do not fit together.

        May come more than once, in initialization mode.
        """

    @abstractmethod
    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Advance from t to t + h [s] with the values of the inputs; ValueError or NonPhysicalState where it cannot.

        The slave then restores the attributes.
        """

    @abstractmethod
    def outputs(self) -> Sequence[float]:
        """The outputs at the present time, in the order of the variable table, but for those that are ``late``."""

    def ports(self) -> Mapping[str, float]:
        """The ``late`` outputs by name; asked for when one of them is read, once after each step."""
        return {}

    def retune(self, changed: Mapping[str, Any]) -> None:  # noqa: B027 - not every component has such parameters
        """Take over tunable parameters that were set since the last step, with the inputs' values; or ValueError."""

    def kinds(self) -> Mapping[type, Kind]:
        """The kinds of objects among the attributes, by type."""
        return {}

    def resumed(self) -> None:  # noqa: B027
        """Make the attributes that a state does not contain; the others are there, if there were any when it was
        saved."""


class Arithmetic(Component):
    """A component whose step is arithmetic (:mod:`~solver.lumped.arithmetic`), for the compiled engine, too.

    ``kept`` are the attributes that hold its numbers beside its parameters; one is ``state``, with its time t [s].
    """

    kept: ClassVar[tuple[str, ...]]
    state: Any

    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Advance from t to t + h [s]."""
        check_time(t, h, self.state.t)
        self.advance(t, h, values)

    @abstractmethod
    def advance(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """The step from the time t at which the component stands, of a length h > 0 [s]."""
