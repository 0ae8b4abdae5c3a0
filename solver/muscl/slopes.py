"""Slopes in the cells from the differences a and b to the neighbours on both sides, by name.

All are exact for a = b, so of second order for smooth waves. The limited ones create no new extrema: if a and b differ
in sign they are 0, or at most a fifth of the larger (van Albada's).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray

_NOTHING = 1e-300  # where both differences vanish


def van_albada(a: Array, b: Array) -> Array:
    """(a b² + b a²)/(a² + b²), closer to the smaller difference; a smooth function of both."""
    return (a * b) * (a + b) / (a * a + b * b + _NOTHING)


def minmod(a: Array, b: Array) -> Array:
    """The smaller difference."""
    return _limited(a, b, np.minimum(np.abs(a), np.abs(b)))


def monotonized_central(a: Array, b: Array) -> Array:
    """The mean of both, at most twice the smaller one."""
    return _limited(a, b, np.minimum(0.5 * np.abs(a + b), 2.0 * np.minimum(np.abs(a), np.abs(b))))


def central(a: Array, b: Array) -> Array:
    """The mean of both, unlimited."""
    return 0.5 * (a + b)


def _limited(a: Array, b: Array, size: Array) -> Array:
    return np.where(a * b > 0.0, np.copysign(size, a), 0.0)


SLOPES: dict[str, Callable[[Array, Array], Array]] = {
    "van Albada": van_albada,
    "minmod": minmod,
    "monotonized central": monotonized_central,
    "central": central,
}
