"""The memory of a wall's viscous stress: Maxwell elements in parallel.

    σ_v = Σ share_j σ_j,     τ_j dσ_j/dt + σ_j = φ0 ε̇

In the first element the stress of the viscous law replaces φ0 ε̇; the others are linear. An element with τ = 0
is a damper. Source: R. M. Christensen, Theory of Viscoelasticity (2nd ed. 1982), ch. 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray


def weights(tau: Array, theta: Any) -> Array:
    """Share of the stress that elements with relaxation times τ reach under a rate that lasts θ [s]: θ/(τ + θ).

    1/(1 + iωτ) for θ = 1/iω, and exactly 1 where τ = 0.
    """
    off = tau == 0.0
    return np.where(off, 1.0, theta / (np.where(off, 1.0, tau) + theta))


@dataclass(frozen=True)
class Moment:
    """The elements at the end of an implicit stage: σ_v = direct σ_law + linear φ0 ε̇ + faded.

    weight [-], rest [Pa] : (m, …) of each element, σ_j = weight_j (its stress without memory) + rest_j.
    direct, linear [-], faded [Pa] : (…) their sums.
    """

    weight: Array
    rest: Array
    direct: Array
    linear: Array
    faded: Array

    @classmethod
    def of(cls, tau: Array, share: Array, past: Array, theta: Any) -> Moment:
        """θ [s] after the stresses were ``past`` : (m, …) [Pa], by one backward Euler step, implicit in the
        relaxation."""
        weight = weights(tau, theta)
        rest, shared = (1.0 - weight) * past, share * weight
        return cls(weight, rest, shared[0], shared[1:].sum(axis=0), (share * rest).sum(axis=0))

    @classmethod
    def present(cls, stress: Array) -> Moment:
        """A moment with known stress σ_v : (…) [Pa], independent of the strain rate."""
        none = np.zeros((1, 1))
        return cls(none[None], stress[None], none, none, stress)
