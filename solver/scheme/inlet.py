"""The drives of the network at its inlets: given flows, or given pressures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..mesh.mesh import Index, as_slice
from .sdirk import INFLOW_AT_STAGES, INFLOW_TIMES, VALUES_AT_STAGES

Array = np.ndarray


@dataclass(frozen=True)
class Inlets:
    """The condition at each inlet, 0 = scale ΣQ + gain drive - slope H, all (B, n_inlets).

    A given flow enters the node: 0 = ΣQ + Q. A given pressure: 0 = (P - H)/Z with Z = ρ c0/A0 of the artery, so that it
    has the unit of flow, as at other nodes. by_flow, first : (n_inlets,) True for a given flow, and the columns of the
    state vector with the flow there.
    """

    by_flow: Array
    scale: Array
    gain: Array
    slope: Array
    first: Array

    @staticmethod
    def of(by_flow: Array, Y: Array, first: Array) -> Inlets:
        """For inlets with or without given flow : (n_inlets,), in arteries of admittance Y = 1/Z : (B, n_inlets)."""
        scale = np.where(by_flow, 1.0, np.zeros_like(Y))
        return Inlets(by_flow, scale, np.where(by_flow, 1.0, Y), np.where(by_flow, 0.0, Y), first)

    def each(self, drive: Array) -> Array:
        """The drive of each inlet at the times of a step, (n_inlets, 4, B or 1); a single inlet may omit its axis."""
        return np.reshape(drive, (len(self.by_flow), len(INFLOW_TIMES), -1))

    def at_stages(self, drive: Array) -> Array:
        """gain drive at the stages of a step : (STAGES, B, n_inlets) [m³/s], from drive : (n_inlets, 4, B or 1)."""
        return self.gain * np.matmul(self._at_stages, drive).transpose(1, 2, 0)

    def begin(self, y: Array, drive: Array) -> None:
        """Start a step from y : (B, n) with drive : (n_inlets, B or 1). If a given inflow jumps (a held input with a
        new value), so does the flow at the inlet; if a given pressure jumps, the flow follows by its inertia.

        Spread over the step, the jump would appear in the inlet pressure as its inertia divided by dt.
        """
        inlets, columns = self._set
        y[:, columns] = drive[inlets].T

    def flow(self, given: Array, H: Array) -> Array:
        """The condition without ΣQ, for given = gain drive and the pressures H : (B, n_inlets) [m³/s]."""
        return given - self.slope * H

    @cached_property
    def _at_stages(self) -> Array:
        return np.where(self.by_flow[:, None, None], INFLOW_AT_STAGES, VALUES_AT_STAGES)

    @cached_property
    def _set(self) -> tuple[Index, Index]:
        """The inlets with given flows, and their columns."""
        return as_slice(np.flatnonzero(self.by_flow)), as_slice(self.first[self.by_flow])
