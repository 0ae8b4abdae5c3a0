"""The variables of the FMU, derived from a network: one row each, in the order of their value references."""

from __future__ import annotations

from dataclasses import dataclass

from solver import effects
from solver.network import Network
from solver.quantity import Quantity
from solver.scheme.model import Settings
from solver.wall import ELASTIC_LAWS, VISCOUS_LAWS

INTERPOLATIONS = ("hold", "linear")
INLET_FLOW = Quantity("m^3/s", "flow into the network", -1.0, 1.0, nominal=1e-5, display="mL/s", input=True)
# ranges of the numerical settings, as solver.scheme.model.Settings has them
SETTINGS = {
    "solver.dt": Quantity("s", "internal time step", 1e-7, 0.1, nominal=1e-3, display="ms", tunable=False),
    "solver.element_length": Quantity("m", "longest element", 1e-4, 10.0, nominal=0.1, display="cm", tunable=False),
}
_OUTPUTS = {
    "P": Quantity("Pa", "pressure", float("-inf"), float("inf"), nominal=1e4, display="mmHg"),
    "Q": Quantity("m^3/s", "flow", float("-inf"), float("inf"), nominal=1e-5, display="mL/s"),
    "R": Quantity("m", "radius", 0.0, float("inf"), nominal=1e-2, display="mm"),
}


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
            raise ValueError(f"{self.name} = {value!r}: must be one of {', '.join(self.choices)}.")

    def choice(self, number: int) -> str:
        """The choice with a number of the Enumeration; ValueError, one sentence, if there is none."""
        if not 1 <= number <= len(self.choices):
            known = " or ".join(f"{i} ({choice})" for i, choice in enumerate(self.choices, start=1))
            raise ValueError(f"{self.name} = {number}: must be {known}.")
        return self.choices[number - 1]

    def number(self, choice: str) -> int:
        """The number of a choice."""
        return self.choices.index(choice) + 1


def variable_table(network: Network, settings: Settings) -> tuple[Variable, ...]:
    """Inputs, then parameters, then outputs of the FMU of a network."""
    inputs = [Variable("inlet.Q", "input", "continuous", INLET_FLOW.description, 0.0, INLET_FLOW)]
    parameters = []
    values = network.parameters()
    for name, quantity in network.parameter_quantities().items():
        if quantity.input:
            inputs.append(Variable(name, "input", "continuous", quantity.description, values[name], quantity))
        else:
            kind = "tunable" if quantity.tunable else "fixed"
            parameters.append(Variable(name, "parameter", kind, quantity.description, values[name], quantity))
    starts = {"solver.dt": settings.dt, "solver.element_length": settings.element_length}
    for name, quantity in SETTINGS.items():
        parameters.append(Variable(name, "parameter", "fixed", quantity.description, starts[name], quantity))
    texts = (
        ("network.elastic_law", "elastic law of the walls", network.elastic_law, tuple(ELASTIC_LAWS)),
        (
            "network.viscous_law",
            "viscous law of the walls where phiNL is not 0",
            network.viscous_law,
            tuple(VISCOUS_LAWS),
        ),
        (
            "inlet.interpolation",
            "inlet.Q during a step: held, or linear from the value of the step before",
            "hold",
            INTERPOLATIONS,
        ),
    )
    for name, description, start, choices in texts:
        parameters.append(
            Variable(name, "parameter", "fixed", f"{description}: {' or '.join(choices)}", start, None, choices)
        )
    outputs = []
    for name in network.output_units():
        place, kind = name.rsplit(".", 1)
        quantity = _OUTPUTS[kind]
        sources = _initial_sources(kind, parameters)
        text = f"{quantity.description} at {place}"
        outputs.append(Variable(name, "output", "continuous", text, None, quantity, sources=sources))
    return (*inputs, *parameters, *outputs)


def _initial_sources(kind: str, parameters: list[Variable]) -> tuple[str, ...]:
    """The parameters on which P, Q or R depends at the start: rest under P_0."""
    if kind == "Q":
        return ()
    # P is P_0 up to round-off through the wall law and back; R follows from it by the wall of the site's segment,
    # which the table does not name: all walls are listed
    names = {"network.P_0"}
    if kind == "R":
        names |= {"network.P_ref", "network.eta", "network.elastic_law"}
        walls = ("R0", "h", "E", *(key for effect in effects.ALL if effect.at_rest for key in effect.terms))
        names |= {v.name for v in parameters if v.name.rsplit(".", 1)[-1] in walls}
    return tuple(v.name for v in parameters if v.name in names)
