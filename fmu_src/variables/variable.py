"""What an FMU variable is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from solver.errors import InputError
from solver.quantities.quantity import Quantity


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
