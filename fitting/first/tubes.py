"""Walls of the sections of a first model, and the Windkessels at their ends.

Arteries narrow on their way: R0(x) = R0 (1 + s (x/L - 1/2)), with s = TAPER for the whole way to the farthest site.
With h and E constant, c ∝ R^(-1/2) and Z ∝ R^(-5/2) along a tube.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.laws.effects import Taper
from solver.laws.outlets import Windkessel
from solver.network.description import Fluid

from .sections import Array, Section, arrivals
from .species import Typical

# s of a whole way, and its standard deviation: radii of the bundled aortas fall by 0.14 (sheep, AA to DD) to 0.75
# (human, to its bifurcation) of their mean, and a tube of a laboratory by nothing
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
    """A tube: a section with its wall [SI]; R0, Z : radius and impedance at its middle."""

    section: Section
    L: float
    R0: float
    h: float
    E: float
    phi0: float
    Z: float
    taper: float

    @property
    def R_end(self) -> float:
        """The radius at its end [m]."""
        return self.R0 * (1.0 + 0.5 * self.taper)

    @property
    def Z_end(self) -> float:
        """The impedance at its end [Pa·s/m³]."""
        return self.Z * (self.R0 / self.R_end) ** 2.5


def narrowed(sections: Sequence[Section], s: Array | float) -> dict[str, tuple[Array, Array]]:
    """The taper of each tube and its R0 over the radius of the root, for all of the flow, if the way to the farthest
    site narrows by s.

    A tube narrows by its part of the time of that way. Impedances match at junctions, Z ∝ c/A, so that a tube b behind
    a tube a has R0_b/R0_a = ((1 + s_a/2)/(1 - s_b/2))^(5/4) with all of the flow.
    """
    until = arrivals(sections)
    found: dict[str, tuple[Array, Array]] = {}
    for each in sections:
        taper = np.asarray(s * each.time / max(until.values()))
        start = 1.0 - 0.5 * taper
        if each.parent:
            before, R0 = found[each.parent]
            found[each.name] = taper, R0 * ((1.0 + 0.5 * before) / start) ** 1.25
        else:
            found[each.name] = taper, 1.0 / start
    return found


def on_the_way(sections: Sequence[Section], values: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
    """The resistance of the way to the end of each tube for the flow there, by friction along it, with C_f = friction π
    ν: in a tube ρ C_f L/A² at its middle times the mean of (R0/R)⁴, (1 + a²/3)/(1 - a²)³ for a = s/2. A way also
    carries the flow of other tubes. values : L, R0 and taper of each tube, and the share of the flow.
    """
    fluid, found = Fluid(), dict[str, Array]()
    for each in sections:
        L, R0, taper, share = (values[each.name][key] for key in ("L", "R0", TAPERED, "share"))
        a2 = 0.25 * taper**2
        own = fluid.rho * fluid.friction * np.pi * fluid.nu * L / (np.pi * R0**2) ** 2
        own = own * (1.0 + a2 / 3.0) / (1.0 - a2) ** 3
        before = found[each.parent] * values[each.parent]["share"] if each.parent else 0.0
        found[each.name] = own + before / share
    return found


def mean_speed(start: float) -> float:
    """The wave speed at the middle of a tube from that at its start."""
    return start * (1.0 - 0.5 * TAPER) ** 0.5


def made(sections: Sequence[Section], c: float, area: float, usual: Typical) -> list[Tube]:
    """The tubes, with the wave speed c [m/s] at their middles and the area [m²] at the root, for all of the flow:
    Z = ρ c/(π R0²), and c² = E h/(2 ρ (1 - η²) R0)."""
    rho, found = Fluid().rho, list[Tube]()
    shape = narrowed(sections, TAPER)
    for each in sections:
        taper, factor = map(float, shape[each.name])
        R0 = float(np.sqrt(area * each.share / np.pi)) * factor
        E = 2.0 * rho * c**2 * (1.0 - _ETA**2) / usual.h_R
        Z = rho * c / (np.pi * R0**2)
        found.append(Tube(each, c * each.time, R0, usual.h_R * R0, E, usual.relaxation * E, Z, taper))
    return found


def windkessel(end: Tube, tubes: Sequence[Tube], R: float, C: float) -> tuple[float, float, float]:
    """R1 [Pa·s/m³], C [m³/Pa] and R2 at the end of a tube, for a network of resistance R with C at all ends together.

    Including the friction on the way, a share s has the resistance R/s.
    """
    share = end.section.share
    values = {t.section.name: {**keyed(L=t.L, R0=t.R0, share=t.section.share), TAPERED: np.asarray(t.taper)}
              for t in tubes}  # fmt: skip
    way = float(on_the_way([t.section for t in tubes], values)[end.section.name])
    R1 = min(end.Z_end, _PROXIMAL * R / share)
    return R1, C * share, float(rest_of(R / share, R1, way))


def rest_of(whole: Array | float, R1: Array | float, way: Array | float) -> Array:
    """R2 of an end whose whole resistance includes R1 and that of the way."""
    return np.maximum(whole - R1 - way, _LEAST * np.asarray(whole))
