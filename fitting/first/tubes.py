"""Walls of the stretches of a first model, and the Windkessels at their ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.laws.outlets import Windkessel
from solver.network.description import Fluid

from .species import Typical
from .stretches import Stretch

KEYS = tuple(Windkessel.__annotations__)[:3]  # of what windkessel() gives
_ETA = 0.5  # of a network file without eta
_PROXIMAL = 0.5  # of the resistance of an end: upper limit of R1
_LEAST = 0.1  # of the same: lower limit of R2


def keyed(**values: Any) -> dict[str, Any]:
    """Values by the keys of walls and Windkessels."""
    return values


@dataclass(frozen=True)
class Tube:
    """A stretch with its wall [SI]; Z : its impedance."""

    stretch: Stretch
    L: float
    R0: float
    h: float
    E: float
    phi0: float
    Z: float


def made(stretch: Stretch, c: float, area: float, usual: Typical) -> Tube:
    """The tube of a stretch: A = its share of the area [m²], Z = ρ c/A, and c² = E h/(2 ρ (1 - η²) R0) [m²/s²]."""
    rho, area = Fluid().rho, stretch.share * area
    R0 = float(np.sqrt(area / np.pi))
    E = 2.0 * rho * c**2 * (1.0 - _ETA**2) / usual.h_R
    return Tube(stretch, c * stretch.time, R0, usual.h_R * R0, E, usual.relaxation * E, rho * c / area)


def windkessel(end: Tube, tubes: Sequence[Tube], R: float, C: float) -> tuple[float, float, float]:
    """R1 [Pa·s/m³], C [m³/Pa] and R2 at the end of a tube, for a network of resistance R with C at all ends together.

    Including the friction along its path, ρ C_f L/A² of each tube with C_f = friction π ν, a share s has the resistance
    R/s.
    """
    fluid, share, by_name = Fluid(), end.stretch.share, {each.stretch.name: each for each in tubes}
    way, at = 0.0, end.stretch.name
    while at:
        tube = by_name[at]
        friction = fluid.rho * fluid.friction * np.pi * fluid.nu * tube.L / (np.pi * tube.R0**2) ** 2
        way += friction * tube.stretch.share / share  # it also carries the flow of other tubes
        at = tube.stretch.parent
    R1 = min(end.Z, _PROXIMAL * R / share)
    return R1, C * share, float(max(R / share - R1 - way, _LEAST * R / share))
