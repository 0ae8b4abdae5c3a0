"""The veins, the right heart and the lungs as one reservoir, which closes the volume; without FMI.

    P = (V - V_unstressed) / C,     V = V_start + V_arteries - V_heart

Its inputs are volumes, not flows: the volume that has left the arteries and the volume that has entered the heart, both
since the start. So the total volume is constant to round-off, for any communication step and any order in which a
master runs the components.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..io.saved import Kind, dataclasses
from ..quantities.quantity import quantity, with_values
from .arithmetic import divided, select
from .component import Arithmetic

EXCHANGES = ("end", "start")


@dataclass(frozen=True)
class Reservoir:
    """An elastic reservoir."""

    C: float = quantity(None, "m^3/Pa", "compliance", 1e-12, 1e-3, nominal=1e-7, display="mL/mmHg")
    V_unstressed: float = quantity(None, "m^3", "volume at no pressure", 0.0, 1.0, nominal=1e-3, display="mL")
    P_start: float = quantity(
        None, "Pa", "pressure at the start", -1e5, 1e5, nominal=1e3, display="mmHg", tunable=False
    )


@dataclass(frozen=True)
class Body:
    """A reservoir of veins. reference : the source of its numbers."""

    name: str
    reference: str
    body: Reservoir

    def with_values(self, values: Mapping[str, Any]) -> Body:
        """The body with the parameters in ``values``."""
        return replace(self, body=with_values("body", self.body, values))


@dataclass(frozen=True)
class BodyState:
    """V_start [m³]; net [m³] : gain since the start, at the time ``known`` [s]; and that of the previous step."""

    t: float
    V_start: float
    known: float
    net: float
    known_before: float
    net_before: float


class BodyComponent(Arithmetic):
    """The reservoir as a component of an FMU.

    ``body.exchange`` gives the time of the inputs that are set before a step: its ``end``, for a master that runs the
    body last, or its ``start``, for one that runs all components in parallel. In the latter case the volume at the end
    of the step is extrapolated from the last two.
    """

    remade = frozenset(("own",))
    kept = ("extrapolates", "state")

    def __init__(self, body: Body) -> None:
        self.own = self.body = body

    def kinds(self) -> dict[type, Kind]:
        """The types of objects in a saved state."""
        return dataclasses(Body, Reservoir, BodyState)

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Start with the reservoir at P_start."""
        self.body = self.own.with_values(values)
        self.extrapolates = values["body.exchange"] == "start"
        reservoir = self.body.body
        gained = values["arteries.V"] - values["heart.V"]
        V_start = reservoir.V_unstressed + reservoir.C * reservoir.P_start
        self.state = BodyState(t0, V_start, t0, gained, t0, gained)

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Apply tunable parameters."""
        self.body = self.body.with_values(changed)

    def advance(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Apply the volumes."""
        s = self.state
        net = values["arteries.V"] - values["heart.V"]
        self.state = BodyState(t + h, s.V_start, select(self.extrapolates, t, t + h), net, s.known, s.net)

    @property
    def V(self) -> float:
        """Volume at the present time [m³]; not extrapolated over a step of more than twice the one before."""
        s = self.state
        ahead = divided(s.t - s.known, s.known - s.known_before, 0.0)
        return s.V_start + s.net + select(ahead <= 2.0, ahead, 0.0) * (s.net - s.net_before)

    def outputs(self) -> list[float]:
        """Pressure [Pa] and volume [m³]."""
        reservoir = self.body.body
        return [(self.V - reservoir.V_unstressed) / reservoir.C, self.V]
