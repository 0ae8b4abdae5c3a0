"""Localised effects: they act on the part [x - l/2, x + l/2] of x/L, as far as it lies in the segment.

Position and length are continuous unknowns: an effect on walls has a short ramp at each end, which preserves the length
of the part, and a force on the flow is integrated exactly over the part, whatever elements contain it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from ..quantities.coordinate import Coordinate
from ..quantities.quantity import Quantity
from .effect import DROP, OUTFLOW, Array, Described, Drag, Effect, Points, SearchSpec, Values, small_wave_impedance
from .wall import Wall

_RAMP = 0.08  # of L, over which a wall changes at an end of the part
_GRID = tuple(round(0.05 + 0.1 * i, 2) for i in range(10))  # element ends for a part at a non-default position
_FROM, _TO = 0.02, 0.98  # where a search may place the middle
_POSITIONS = (0.15, 0.3, 0.5, 0.7, 0.85)  # start positions of a search
_STEP = 0.15  # of a position in a search, for x = 1
_MIDDLE = "middle of the part as a fraction of the segment from its upstream end"
_EXTENT = "length of the part as a fraction of that of the segment"


def part_keys(key: str, length: float) -> tuple[dict[str, Quantity], dict[str, float]]:
    """Quantities and default values of position and length of the part that the effect with this key acts on."""
    position, extent = f"{key}_position", f"{key}_length"
    quantities = {
        position: Quantity("1", _MIDDLE, 0.0, 1.0, nominal=_STEP, tunable=False),
        extent: Quantity("1", _EXTENT, 0.01, 1.0, nominal=0.2, tunable=False),
    }
    return quantities, {position: 0.5, extent: length}


class Partial(Effect):
    """An effect on a part of a segment; ``along`` : the keys of its middle and of its length.

    longest : upper bound of its length in a search, as a fraction of L.
    """

    owner = "segment"
    places = ("segment",)
    longest: ClassVar[float] = 1.0

    def ends(self, values: Values) -> tuple[Array, Array]:
        """x/L where the part begins and ends, inside the segment."""
        middle, half = values[self.along[0]], 0.5 * values[self.along[1]]
        return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)

    def cut_at(self, values: Values) -> tuple[float, ...]:
        usual = all(np.all(values[key] == self.neutral[key]) for key in self.along)
        return self.cuts if usual else _GRID

    def inside(self, values: Values, x: Array) -> Array:
        """1 in the part and 0 outside : (B, n) at x : (n,), with a ramp about its ends."""
        start, end = self.ends(values)
        begun = _risen(x, start, np.minimum(_RAMP, 2.0 * start))
        going_on = _risen(-x, -end, np.minimum(_RAMP, 2.0 * (1.0 - end)))
        return np.maximum(begun + going_on - 1.0, 0.0)

    def coordinates_along(self, network: Described, place: str) -> tuple[Coordinate, ...]:
        names = self.variables(network, place)
        found = [self._coordinate(network, place, key, names[key]) for key in self.along]
        position, length = (coordinate for coordinate in found if coordinate is not None)
        low, high = ((end - position.nominal) / position.size for end in (_FROM, _TO))
        longest = (self.longest - length.nominal) / length.size
        return replace(position, low=low, high=high), replace(length, high=min(length.high, longest))


def _risen(x: Array, at: Array, width: Array) -> Array:
    """A smooth step from 0 to 1 over a width about a point; with zero width it jumps to 1 there."""
    wide = width > 0.0
    t = np.clip((x - at) / np.where(wide, width, 1.0) + 0.5, 0.0, 1.0)
    return np.where(wide, t * t * (3.0 - 2.0 * t), np.where(x >= at, 1.0, 0.0))


_PARTS = tuple((p, 0.3) for p in _POSITIONS)  # three tenths long


class WallStiffness(Partial):
    part, usual = part_keys("E", 1.0)
    name = "wall_stiffness"
    equation = "E becomes s E in one segment or a part of it"
    terms = {"E_scale": Quantity("1", "stiffness scale s of the wall, E becomes s E", 1e-2, 1e2), **part}
    neutral = {"E_scale": 1.0, **usual}
    along = tuple(part)
    longest = 0.8  # a longer part is the artery's own wall
    search = SearchSpec(typical={"E_scale": 0.3}, scales=True, starts_along=_PARTS, local=True)
    signature = "wave speed, and reflections whose timing gives the place"
    confusable = ("taper",)
    separator = "radius and pressure at one site"

    def of_animal(self, network: Described, place: str) -> bool:
        return True

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        scale, inside = values["E_scale"], self.inside(values, x)
        s = scale / ((1.0 - inside) * scale + inside)  # on the ramps the compliance 1/s is linear
        return replace(wall, K=wall.K * s, e=wall.e / s)


class SideBranch(Partial):
    part, usual = part_keys("leak", 1.0)
    name = "side_branch"
    equation = "∂A/∂t + ∂Q/∂x = -g (P - P_venous), P_venous of the outlet where the segment ends, else 0"
    terms = {"leak": Quantity("m^2/(Pa.s)", "leak conductance g per length", 0.0, 1e-3, nominal=1e-9), **part}
    neutral = {"leak": 0.0, **usual}
    along = tuple(part)
    # leak: share of the flow of a progressive wave that is lost over the segment, g L Z
    search = SearchSpec(typical={"leak": 0.05}, starts_along=_PARTS, source=OUTFLOW)
    signature = "the flow falls along the segment"
    confusable = ("terminal_reflection",)
    separator = "Q at both ends of the segment"

    def step(self, network: Described, owner: Any, key: str) -> float:
        if key in self.along:
            return super().step(network, owner, key)
        return self.search.typical[key] / (small_wave_impedance(network, owner) * float(owner.L))

    def wall(self, wall: Wall, values: Values, x: Array) -> Wall:
        return replace(wall, leak=values["leak"] * self.inside(values, x))


class Stenosis(Partial):
    """A localised loss of pressure. A search fits its length only if a length of 0.1 L leaves more than noise, because
    most records do not reveal the length.
    Sheep, 40 dB, P, Q and R at seven sites: K = 10 over 0.2 L differs from one over 0.05 L at the same position by 0.2
    to 4 standard deviations of all data together, with K refitted (up to 11 for K = 30). If a long stenosis extends
    across a site away from its middle, it differs from a tenth of L, with position and K refitted, by up to 11 (0.2 L
    about x/L = 0.42; 18 for K = 30).
    """

    part, usual = part_keys("K", 0.1)
    name = "stenosis"
    equation = "Δp = K (ρ/2) Q|Q|/A² over a part of the segment"
    terms = {"K": Quantity("1", "loss coefficient K", 0.0, 1e5, tunable=False), **part}
    neutral = {"K": 0.0, **usual}
    along = tuple(part)
    cuts = (0.45, 0.55)
    search = SearchSpec(typical={"K": 10.0}, starts_along=tuple((p,) for p in _POSITIONS), source=DROP)
    signature = "pressure drop quadratic in the flow, largest in systole; reflections whose timing gives the place"
    confusable = ("fluid_friction",)
    separator = "P on both sides"

    def drag(self, values: Values, points: Points) -> Drag | None:
        start, end = self.ends(values)
        quadratic = 0.5 * values["K"] / ((end - start) * points.L) * points.part(start, end)
        none = np.zeros((0, *quadratic.shape))
        return Drag(quadratic, none, none)
