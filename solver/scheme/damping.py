"""What damps the parts of the flow that elements do not resolve, where the wall does not do it itself.

Junctions that keep the static pressure give ½ρU²Q to what flows into a vessel. Waves that are resolved run away with
it; polynomials of high degree stay at the junction and grow, in elastic walls as soon as steps are too short to damp
them. So the flow's polynomials of degree k > (N + 1)/2 meet a resistance, in the momentum of their element:

    Σ_k Z s_k q_k v_k,     s_k = ((2k - N - 1)/(N - 1))²,     Z = ½ρc/A - 2 N (N + 1) ν/h where that is positive

q_k, v_k : what of the Legendre polynomial P_k is in the flow and in the test function. Z [Pa·s/m³] : half the impedance
of a wave, as in an upwind flux, less that of the wall's own viscosity ν = Re ∂P/∂(∂A/∂t) for P_N, at the frequency
c N √(2(N + 1))/h at which that swings; h the length of the element. Tested with v = Q it takes the power Σ Z s_k q_k².
It changes neither mass nor steady flow. A smooth flow has q_k = O(h^k): where there is damping, pressures are of order
N (N = 2, 3) instead of N + 1. With N = 1 it would be of the size of a first-order error, and there is none; nor
in networks without junctions. Method: spectral vanishing viscosity, E. Tadmor, SIAM J. Numer. Anal. 26 (1989) 30.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..wall import Wall
from .mesh import Mesh

Array = np.ndarray

_PART = 0.5  # of the impedance of a wave


@dataclass(frozen=True)
class NoDamping:
    """All walls damp by themselves."""

    slope = 0.0

    def add_to(self, R: Array, Q: Array) -> None:
        return None


@dataclass(frozen=True)
class HighDegrees:
    """The resistance against the high degrees. Z : (B, n_e, N+1), the same at all points. high : (N+1, N+1)."""

    Z: Array
    high: Array

    MEMBER_AXIS: ClassVar[Mapping[str, int | None]] = {"high": None}  # which counts a batch; of Z the first

    def add_to(self, R: Array, Q: Array) -> None:
        """Add it to the momentum R, for the flow Q, both (B, n_e, N+1)."""
        R += self.Z * (Q @ self.high)

    @property
    def slope(self) -> Array:
        """Its derivative by the flow, (B, n_e, N+1, N+1)."""
        return self.Z[..., None] * self.high


Damping = NoDamping | HighDegrees


def damping(mesh: Mesh, wall: Wall, A: Array, h: Array) -> Damping:
    """The damping of elements of length h : (B, n_e, 1) [m], in walls at rest at A : (B, n_e, N) [m²]."""
    el, N, joined = mesh.element, mesh.element.N, mesh.topology.junctions
    c = wall.wave_speed(A)
    viscosity = wall.loss(A, c * N * np.sqrt(2.0 * (N + 1)) / h)
    Z = (_PART * wall.rho * c / A - 2.0 * N * (N + 1) / h * viscosity).mean(axis=-1, keepdims=True)
    if N == 1 or joined.start == joined.stop or not (Z > 0.0).any():
        return NoDamping()
    return HighDegrees(np.repeat(np.maximum(Z, 0.0), N + 1, axis=-1), el.high_degrees)
