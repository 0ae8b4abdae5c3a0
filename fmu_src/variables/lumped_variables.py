"""Tables of variables for components whose parameters are dataclasses of quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import isfinite
from typing import Any

from solver.quantities.quantity import Quantity, quantities

from .variable import Variable

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
