"""What drives the network at an inlet: a given flow, or a given pressure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .sdirk import INFLOW_AT_STAGES, VALUES_AT_STAGES

Array = np.ndarray


@dataclass(frozen=True)
class FlowInlet:
    """Q(t) [m³/s] is given: what flows in flows on. scale : of ΣQ in the condition. slope : of the rest by -H."""

    scale: ClassVar[float] = 1.0
    slope: ClassVar[float] = 0.0
    at_stages: ClassVar[Array] = INFLOW_AT_STAGES

    def begin(self, Q: Array, drive: Array) -> None:
        """Start a step: where the inflow jumps (a held input that is set anew) the flow Q : (B,) there is the new one.

        Spread over the step, the jump would show in the inlet pressure as its inertia divided by dt.
        """
        Q[:] = drive

    def surplus(self, drive: Array, H: Array) -> Array:
        """What the condition says beside ΣQ : (B,) [m³/s]."""
        return drive

    def flow(self, drive: Array, H: Array) -> Array:
        """The size of the flow that this drives : (B,) [m³/s]."""
        return np.abs(drive)


@dataclass(frozen=True)
class PressureInlet:
    """P(t) [Pa] is given: 0 = (P - H)/Z, Z = ρ c0/A0 of the artery, which makes it a flow as at the other nodes."""

    slope: Array  # (B,) 1/Z

    scale: ClassVar[float] = 0.0
    at_stages: ClassVar[Array] = VALUES_AT_STAGES

    def begin(self, Q: Array, drive: Array) -> None:
        """Start a step: the flow follows the pressure by its inertia."""

    def surplus(self, drive: Array, H: Array) -> Array:
        """What the condition says beside ΣQ : (B,) [m³/s]."""
        return self.slope * (drive - H)

    def flow(self, drive: Array, H: Array) -> Array:
        """The size of the flow that this drives : (B,) [m³/s]."""
        return np.abs(self.slope * (drive - H))


Inlet = FlowInlet | PressureInlet
