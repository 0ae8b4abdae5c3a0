"""What selection does to an interval: an effect that was only just found is mostly one that noise made look larger.

The size x ~ N(θ, 1) of an effect is reported only if |x| > c. Given that it was, its distribution function is

    F(x; θ) = (Φ(x - θ) - Φ(c - θ))/S,  S = Φ(θ - c) + Φ(-c - θ),   for x > c > 0,

and the 95 % interval of θ holds what puts x between the 2.5 % and the 97.5 % points. Far above c it is x ± 1.96.
H. Zhong, R. L. Prentice, Biostatistics 9 (2008) 621.
"""

from __future__ import annotations

import math

from scipy.optimize import brentq
from scipy.special import ndtr

_FAR = 4.0  # standard deviations above the threshold from which selection does nothing
_WIDEST = 12.0  # that the interval may reach down


def reach(d: float, threshold: float, quantile: float) -> tuple[float, float]:
    """How far the interval of a size of d > threshold standard deviations goes down and up, in standard deviations.

    quantile : half an interval without selection.
    """
    d = max(d, threshold + 1e-3)
    if d > threshold + _FAR:
        return quantile, quantile
    tail = float(ndtr(-quantile))

    def beyond(theta: float) -> float:
        """P(X > d or X < -c | selected)."""
        selected = float(ndtr(theta - threshold) + ndtr(-threshold - theta))
        return float(ndtr(theta - d)) / max(selected, 1e-300)

    low = _root(lambda t: beyond(t) - tail, d - _WIDEST, d)
    high = _root(lambda t: beyond(t) - (1.0 - tail), d - _WIDEST, d + quantile + 1.0)
    return d - low, max(high - d, 0.0)


def _root(f: object, low: float, high: float) -> float:
    """Where a function that rises crosses 0; the nearer end where it does not."""
    assert callable(f)
    if f(low) > 0.0:
        return low
    return float(brentq(f, low, high)) if f(high) > 0.0 else high


__all__ = ["reach"]
_ = math
