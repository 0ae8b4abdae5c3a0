"""The numerical settings of the finite volumes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
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

    dt: float = 1e-3
    cell: float = 5e-3
    cfl: float = 0.45
    ends: str = "coupled"
    slopes: str = "van Albada"

    def __post_init__(self) -> None:
        for name, unit, low, high in (("dt", "s", 1e-7, 0.1), ("cell", "m", 1e-5, 1.0), ("cfl", "", 1e-3, 0.45)):
            value = getattr(self, name)
            if not isinstance(value, (int, float, np.number)) or not low <= value <= high:
                allowed = f"[{low:g}, {high:g}] {unit}".rstrip()
                raise InputError(f"muscl settings: {name} = {value!r} must be a number in {allowed}.")
        for name, choices in (("ends", ENDS), ("slopes", tuple(SLOPES))):
            value = getattr(self, name)
            if value not in choices:
                raise InputError(f"muscl settings: {name} = {value!r} must be {' or '.join(map(repr, choices))}.")
