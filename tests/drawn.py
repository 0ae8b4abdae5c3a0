"""The smallest network, and its segments."""

from __future__ import annotations

from solver import Inlet, Network, Resistance, Segment


def segment(name: str, R0: float) -> Segment:
    return Segment(name, L=0.1, R0=R0, h=0.1 * R0, E=1e6, phi0=1e4)


TUBE = Network("tube", (segment("tube", 0.01),), Inlet("tube"), outlets=(Resistance("tube", R=1e8),))
