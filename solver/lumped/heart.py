"""A left heart: ventricle and atrium of time-varying elastance, two valves, filled from the veins; without FMI.

Chambers (Suga, Sagawa, Shoukas, Circ. Res. 32, 314 (1973)), with an activation e(t) between 0 and 1:

    P = P_0 + E(t) (V - V_0),     E(t) = E_min + (contractility E_max - E_min) e(t)

In the ventricle minus R Q, with Q its flow into the aorta: an ejecting ventricle develops less pressure than an
isovolumic one at the same volume.

Valves (Mynard, Davidson, Penny, Smolich, Int. J. Numer. Meth. Biomed. Eng. 28, 626 (2012), doi:10.1002/cnm.1466), with
the open fraction s = r + (1 - r) ζ of the area A, r the fraction that never closes, and a resistance R in series:

    ΔP = (ρ l / A s) dQ/dt + R Q + ρ |Q| Q / 2 (A s)²
    dζ/dt = K_open ΔP (1 - ζ)  where ΔP > 0,   K_close ΔP ζ  where ΔP < 0

Filling: venous.P - P_atrium = R_venous Q_venous. Load: the port of the arteries, :class:`Port`.

The step is in :mod:`~solver.lumped.heart_step`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..io.saved import Kind, dataclasses
from .arithmetic import select
from .component import Arithmetic
from .heart_parts import Aorta, Chamber, Filling, Heart, Pace, Valve, Ventricle
from .heart_step import HeartState, Port, ValveState, initial_state, step

INPUTS = ("aorta.P_0", "aorta.Z", "aorta.Z_0", "venous.P")
OUTPUTS = (
    "aorta.Q", "aorta.P", "aorta.V", "venous.V", "venous.Q", "left_ventricle.P", "left_ventricle.V", "left_atrium.P",
    "left_atrium.V", "mitral_valve.Q", "mitral_valve.opening", "aortic_valve.opening", "heart.phase",
)  # fmt: skip


class HeartComponent(Arithmetic):
    """The heart as a component of an FMU."""

    remade = frozenset(("own",))
    kept = ("known", "state")

    def __init__(self, heart: Heart) -> None:
        self.own = self.heart = heart

    def kinds(self) -> dict[type, Kind]:
        """The types of objects in a saved state."""
        return dataclasses(Heart, Pace, Chamber, Ventricle, Valve, Filling, Aorta, HeartState, ValveState)

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Start at the end of filling; raises ValueError if the parameters are inconsistent."""
        self.heart = self.own.with_values(values)
        self.known = {name: values[name] for name in INPUTS}
        self.state = initial_state(self.heart, t0, values["venous.P"], values["aorta.P_0"])

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Apply tunable parameters; the phase of the beat is continuous."""
        self.heart = self.heart.with_values(changed)

    def advance(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """One step. If P_0, Z and Z_0 are all 0 in the first step, the start values apply."""
        sent = (values["aorta.P_0"] != 0.0) | (values["aorta.Z"] != 0.0) | (values["aorta.Z_0"] != 0.0)
        received = sent | (self.state.h_before > 0.0)
        known = {name: select(received, values[name], self.known[name]) for name in INPUTS}
        port = Port(known["aorta.P_0"], known["aorta.Z"], known["aorta.Z_0"])
        self.state = step(self.heart, replace(self.state, t=t), h, port, known["venous.P"])

    def outputs(self) -> list[float]:
        """In the order of ``OUTPUTS``."""
        s = self.state
        return [
            s.aortic.Q, s.P_aorta, s.ejected, s.taken, s.Q_venous, s.P_ventricle, s.V_ventricle, s.P_atrium, s.V_atrium,
            s.mitral.Q, s.mitral.opening, s.aortic.opening, s.phase,
        ]  # fmt: skip
