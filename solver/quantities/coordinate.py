"""The search coordinate of a number of an effect: x = 0 if the effect is absent, |x| = 1 for an effect of typical size.

scale   value = nominal exp(step x)         shift   value = nominal + step x
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .quantity import Quantity

SCALE, SHIFT = "scale", "shift"
_WIDEST = 5.0


@dataclass(frozen=True)
class Coordinate:
    """One unknown x of a search. moves : (variable, step) pairs. low, high : bounds of x from the allowed ranges.

    unit, size, nominal : those of the reported value, nominal exp(size x) or nominal + size x.
    ratio : the modulus that this value is relative to ("E" for φ0/E), or None.
    """

    name: str
    kind: str
    moves: tuple[tuple[str, float], ...]
    low: float
    high: float
    unit: str = "1"
    size: float = 1.0
    nominal: float = 0.0
    ratio: str | None = None


def allowed(
    kind: str,
    moves: Sequence[tuple[str, float]],
    values: Mapping[str, float],
    quantity: Quantity,
    widest: float = _WIDEST,
) -> tuple[float, float]:
    """The lowest and the highest x that keep every variable in the range of its quantity; values : at x = 0.

    widest : the largest decrease of the logarithm of a scaled number without a lower bound.
    """
    low, high = -math.inf, math.inf
    for variable, step in moves:
        start = values[variable]
        if step <= 0.0:
            continue
        if kind == SCALE:
            low = max(low, (math.log(quantity.low / start) if quantity.low > 0.0 else -widest) / step)
            high = min(high, math.log(quantity.high / start) / step)
        else:
            low, high = max(low, (quantity.low - start) / step), min(high, (quantity.high - start) / step)
    return low, high
