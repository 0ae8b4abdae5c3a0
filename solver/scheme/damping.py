"""Damping of the unresolved parts of the flow, for walls whose own viscosity is too small.

Junctions that conserve the static pressure add ½ρU²Q to the flow into a vessel. Resolved waves carry this energy away;
polynomials of high degree stay at the junction and grow, in elastic walls as soon as the steps are too short to damp
them. So a resistance acts on the flow's polynomials of degree k > (N + 1)/2, in the momentum of their element:

    Z e/(e + (δAc)²) Σ_k q_k v_k,     e = Σ_k q_k²,
    Z = ρc/A - 2 N (N + 1) ν/h where that is positive

q_k, v_k [m³/s] : coefficients of the Legendre polynomial P_k in the flow and in the test function. Z [Pa·s/m³] : the
impedance of a wave, minus that of the wall's own viscosity ν = Re ∂P/∂(∂A/∂t) for P_N, at its frequency c N √(2(N +
1))/h; h is the length of the element. With v = Q the term dissipates the power Z e²/(e + (δAc)²) and never generates
any; it changes neither mass nor steady flow. A smooth flow has q_k = O(h^k); once that is less than δAc, the resistance
falls with its square, and the orders of convergence are kept. Growth at a junction is limited to about δc, one or two
millimetres per second. With N = 1 the term would damp resolved parts, so there is none; nor in networks without
junctions.
Method: spectral vanishing viscosity, E. Tadmor, SIAM J. Numer. Anal. 26 (1989) 30; with an indicator of unresolved
parts as in P.-O. Persson, J. Peraire, AIAA 2006-112.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..laws.wall import Wall
from ..mesh.mesh import Mesh

Array = np.ndarray

_SEEN = 3e-4  # δ, of the wave speed: velocities of high degree that count as unresolved


@dataclass(frozen=True)
class NoDamping:
    """No damping: the viscosity of all walls suffices."""

    def add_to(self, R: Array, Q: Array) -> None:
        return None

    def slope(self, Q: Array) -> float:
        return 0.0


@dataclass(frozen=True)
class HighDegrees:
    """The resistance against the high degrees.

    Z, small : (B, n_e, N+1), the same at all points of an element; small : (δAc)². high : (N+1, N+1), of
    :attr:`~solver.mesh.element.Element.high_degrees`.
    """

    Z: Array
    small: Array
    high: Array

    MEMBER_AXIS: ClassVar[Mapping[str, int | None]] = {"high": None}  # no batch axis; the others have it first

    def add_to(self, R: Array, Q: Array) -> None:
        """Add it to the momentum R [Pa], for the flow Q [m³/s], both (B, n_e, N+1)."""
        parts, size, all_of_it = self._sizes(Q)
        R += self.Z * parts * (size / all_of_it)

    def slope(self, Q: Array) -> Array:
        """Its derivative by the flow, (B, n_e, N+1, N+1)."""
        parts, size, all_of_it = self._sizes(Q)
        grows = 2.0 * self.Z * parts * self.small / all_of_it**2  # d(e/(e + small)) = small/(e + small)² 2 parts dQ
        return (self.Z * size / all_of_it)[..., None] * self.high + grows[..., None] * parts[..., None, :]

    def _sizes(self, Q: Array) -> tuple[Array, Array, Array]:
        """Half the derivative of e by Q; e; and e + (δAc)²."""
        parts = Q @ self.high
        size = (Q * parts).sum(axis=-1)[..., None]
        return parts, size, size + self.small


Damping = NoDamping | HighDegrees


def damping(mesh: Mesh, wall: Wall, A: Array, h: Array, every: bool = False) -> Damping:
    """The damping of elements of length h : (B, n_e, 1) [m], in walls at rest at A : (B, n_e, N) [m²]. every : return a
    term even if it is 0, because the viscosity of all walls suffices."""
    el, N, joined = mesh.element, mesh.element.N, mesh.topology.junctions
    c, Z = wall.wave_speed(A), undamped(mesh, wall, A, h)[..., None]
    if N == 1 or joined.start == joined.stop or not (every or (Z > 0.0).any()):
        return NoDamping()
    small = ((_SEEN * A * c) ** 2).sum(axis=-1)[..., None] / N
    Z, small = (np.broadcast_to(x, (*x.shape[:-1], N + 1)).copy() for x in (np.maximum(Z, 0.0), small))
    return HighDegrees(Z, small, el.high_degrees)


def undamped(mesh: Mesh, wall: Wall, A: Array, h: Array) -> Array:
    """Z of the elements before it is cut at 0, (B, n_e) [Pa·s/m³]: none is positive if the viscosity of all walls damps
    the degrees that are not resolved. Arguments as above."""
    N, c = mesh.element.N, wall.wave_speed(A)
    viscosity = wall.loss(A, c * N * np.sqrt(2.0 * (N + 1)) / h)
    found: Array = (wall.rho * c / A - 2.0 * N * (N + 1) / h * viscosity).sum(axis=-1) / N
    return found
