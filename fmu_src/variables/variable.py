"""A variable of an FMU, and the variables of components whose parameters are dataclasses of quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from solver.errors import InputError
from solver.quantities.quantity import Quantity, quantities


@dataclass(frozen=True)
class Variable:
    """One FMU variable. causality: input, output, parameter. variability: continuous, fixed, tunable.

    ``quantity`` for a number; ``choices`` for an Enumeration, whose values are texts here and 1, 2, … for FMI.
    ``start`` is None for outputs. sources : the parameters on which an output depends at the start. late : an output
    that costs something and is computed only when it is read.
    """

    name: str
    causality: str
    variability: str
    description: str
    start: float | str | None
    quantity: Quantity | None = None
    choices: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    late: bool = False

    def check(self, value: float | str) -> None:
        """Raise ValueError, one sentence, unless the value is allowed."""
        if self.quantity is not None:
            self.quantity.check(self.name, value)  # type: ignore[arg-type]
        elif value not in self.choices:
            raise InputError(f"{self.name} = {value!r}: must be one of {', '.join(self.choices)}.")

    def choice(self, number: int) -> str:
        """The choice with a number of the Enumeration; ValueError, one sentence, if there is none."""
        if not 1 <= number <= len(self.choices):
            known = " or ".join(f"{i} ({choice})" for i, choice in enumerate(self.choices, start=1))
            raise InputError(f"{self.name} = {number}: must be {known}.")
        return self.choices[number - 1]

    def number(self, choice: str) -> int:
        """The number of a choice."""
        return self.choices.index(choice) + 1


def with_starts(table: tuple[Variable, ...], starts: Mapping[str, float | str]) -> tuple[Variable, ...]:
    """The table with other start values of inputs and parameters. Raises ValueError for one that is not allowed."""
    known = {variable.name for variable in table if variable.causality != "output"}
    for name in starts:
        if name not in known:
            raise InputError(f"{name}: not an input or parameter; the FMU's modelDescription.xml has the names.")
    changed = {variable.name: replace(variable, start=starts.get(variable.name, variable.start)) for variable in table}
    for name, value in starts.items():
        changed[name].check(value)
    return tuple(changed.values())


# --- of a heart or a body -------------------------------------------------------------------------------------------

Groups = Mapping[str, Any]  # dataclass of quantities by the first word of its variables' names

ANY = (float("-inf"), float("inf"))  # range of an output
PRESSURE = Quantity("Pa", "pressure", *ANY, nominal=1e4, display="mmHg")
# P_0 of a port: P - Z Q, where short steps at viscous walls make Z large
INTERCEPT = replace(PRESSURE, low=-1e9, high=1e9)
FLOW = Quantity("m^3/s", "flow", *ANY, nominal=1e-4, display="mL/s")
VOLUME = Quantity("m^3", "volume", *ANY, nominal=1e-4, display="mL")
IMPEDANCE = Quantity("Pa.s/m^3", "impedance", 0.0, 1e15, nominal=1e7, display="mmHg.s/mL")
FRACTION = Quantity("1", "fraction", 0.0, 1.0)
MEMORY = replace(IMPEDANCE, low=-1e15)  # effect of the flow at the start of a step on the pressure at its end
_GIVEN = {PRESSURE.unit: (-1e5, 1e6), VOLUME.unit: (-1e6, 1e6)}  # ranges of inputs without their own


def input_variable(name: str, quantity: Quantity, description: str, start: float) -> Variable:
    """An input."""
    low, high = (quantity.low, quantity.high) if isfinite(quantity.low) else _GIVEN.get(quantity.unit, ANY)
    quantity = replace(quantity, description=description, low=low, high=high)
    return Variable(name, "input", "continuous", description, start, quantity)


def output_variable(name: str, quantity: Quantity, description: str, sources: Iterable[str] = ()) -> Variable:
    """An output; sources : the parameters and inputs on which it depends at the start."""
    described = replace(quantity, description=description)
    return Variable(name, "output", "continuous", description, None, described, sources=tuple(sources))


def parameters(groups: Groups) -> list[Variable]:
    """One parameter for each quantity: ``<group>.<field>``."""
    return [
        Variable(
            f"{group}.{key}",
            "parameter",
            "tunable" if q.tunable else "fixed",
            f"{q.description} ({group.replace('_', ' ')})",
            getattr(owner, key),
            q,
        )
        for group, owner in groups.items()
        for key, q in quantities(owner).items()
    ]
