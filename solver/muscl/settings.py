"""The numerical settings of the finite volumes."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import InputError
from ..quantities.quantity import quantities, quantity
from .slopes import SLOPES

ENDS = ("coupled", "neumann")


@dataclass(frozen=True)
class MusclSettings:
    """dt : output interval [s]; cfl makes steps shorter. cell : longest cell [m]. cfl : limit of (|U| + c) dt/dx.

    ends : condition at the ends of segments, "coupled": the total pressure is common; "neumann": ∂Q/∂x = 0, as
    published, so only the elastic pressure is common. slopes : those of the linear reconstruction of pressure and flow
    (:mod:`~solver.muscl.slopes`). A batch takes the steps of its fastest member, so a member's result depends on the
    other members, within the error of a step. Raises ValueError for values that are not allowed.
    """

    dt: float = quantity(1e-3, "s", "output interval", 1e-7, 0.1)
    cell: float = quantity(5e-3, "m", "longest cell", 1e-5, 1.0)
    cfl: float = quantity(0.45, "1", "CFL number", 1e-3, 0.45)
    ends: str = "coupled"
    slopes: str = "van Albada"

    def __post_init__(self) -> None:
        for name, allowed in quantities(MusclSettings).items():
            allowed.check(f"muscl settings: {name}", getattr(self, name))
        for name, choices in (("ends", ENDS), ("slopes", tuple(SLOPES))):
            value = getattr(self, name)
            if value not in choices:
                raise InputError(f"muscl settings: {name} = {value!r} must be {' or '.join(map(repr, choices))}.")
