"""Walls of the stretches of a first model, and the Windkessels at their ends.

Arteries narrow on their way: R0(x) = R0 (1 + s (x/L - 1/2)) with s = TAPER. With h and E constant, c ∝ R^(-1/2) and
Z ∝ R^(-5/2) along a tube.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.laws.effects import Taper
from solver.laws.outlets import Windkessel
from solver.network.description import Fluid

from .species import Typical
from .stretches import Stretch

Array = np.ndarray

# s, and its standard deviation: radii of the bundled aortas fall by 0.14 (sheep, AA to DD) to 0.75 (human, to its
# bifurcation) of their mean, and a tube of a laboratory by nothing
TAPER, TAPER_ERROR = -0.4, 0.3
TAPERED = Taper.at_ends["R0"]  # the key of s
KEYS = tuple(Windkessel.__annotations__)[:3]  # of what windkessel() gives
_ETA = 0.5  # of a network file without eta
_PROXIMAL = 0.5  # of the resistance of an end: upper limit of R1
_LEAST = 0.1  # of the same: lower limit of R2


def keyed(**values: Any) -> dict[str, Any]:
    """Values by the keys of walls and Windkessels."""
    return values


@dataclass(frozen=True)
class Tube:
    """A stretch with its wall [SI]; R0, Z : radius and impedance at its middle."""

    stretch: Stretch
    L: float
    R0: float
    h: float
    E: float
    phi0: float
    Z: float
    taper: float = TAPER

    @property
    def R_end(self) -> float:
        """The radius at its end [m]."""
        return self.R0 * (1.0 + 0.5 * self.taper)

    @property
    def Z_end(self) -> float:
        """The impedance at its end [Pa·s/m³]."""
        return self.Z * (self.R0 / self.R_end) ** 2.5


def narrowed(s: Array | float, depth: int) -> Array:
    """R0 of a tube with a taper s over the radius of the root, for all of the flow; depth : tubes before it.

    Impedances match at junctions, Z ∝ c/A: tubes begin with the area of the end of the one before them, in proportion
    to the flow and to the wave speed there. With q = (1 + s/2)/(1 - s/2), the ratio of its radii, each multiplies R0
    by q^(5/4).
    """
    start, end = 1.0 - 0.5 * s, 1.0 + 0.5 * s
    return np.asarray((end / start) ** (1.25 * depth) / start)


def mean_speed(start: float) -> float:
    """The wave speed at the middle of a tube from that at its start."""
    return start * (1.0 - 0.5 * TAPER) ** 0.5


def depths(stretches: Sequence[Stretch]) -> dict[str, int]:
    """How many tubes are before each."""
    found: dict[str, int] = {"": -1}
    for each in stretches:
        found[each.name] = found[each.parent] + 1
    return found


def made(stretches: Sequence[Stretch], c: float, area: float, usual: Typical) -> list[Tube]:
    """The tubes, with the wave speed c [m/s] at their middles and the area [m²] at the root, for all of the flow:
    Z = ρ c/(π R0²), and c² = E h/(2 ρ (1 - η²) R0)."""
    rho, depth, found = Fluid().rho, depths(stretches), []
    for each in stretches:
        R0 = float(np.sqrt(area * each.share / np.pi) * narrowed(TAPER, depth[each.name]))
        E = 2.0 * rho * c**2 * (1.0 - _ETA**2) / usual.h_R
        Z = rho * c / (np.pi * R0**2)
        found.append(Tube(each, c * each.time, R0, usual.h_R * R0, E, usual.relaxation * E, Z))
    return found


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
    R1 = min(end.Z_end, _PROXIMAL * R / share)
    return R1, C * share, float(max(R / share - R1 - way, _LEAST * R / share))
