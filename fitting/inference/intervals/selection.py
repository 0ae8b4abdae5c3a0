"""Intervals after selection: noise has usually increased the estimate of an effect just above its threshold.

The size x ~ N(θ, 1) of an effect is reported only if |x| > c. Given that it was,

    P(X > x) = Φ(θ - x)/S for x > c,   S = Φ(θ - c) + Φ(-θ - c),

and the interval of θ contains the values for which x lies between the 2.5 % and 97.5 % points. Far above c it is
x ± 1.96.
H. Zhong, R. L. Prentice, Biostatistics 9 (2008) 621.
"""

from __future__ import annotations

from collections.abc import Callable

from scipy.optimize import brentq
from scipy.special import ndtr

from ...results.estimate import Estimate

_FAR = 4.0  # standard deviations above the threshold beyond which selection has no effect
_WIDEST = 12.0  # that an interval may reach down


def reach(d: float, threshold: float, quantile: float) -> tuple[float, float]:
    """Reach of the interval of a size of d standard deviations, toward zero and away from it, in standard deviations.

    threshold : c. quantile : half an interval without selection.
    """
    d = max(d, threshold + 1e-3)
    if d > threshold + _FAR:
        return quantile, quantile
    tail = float(ndtr(-quantile))

    def beyond(theta: float) -> float:
        selected = float(ndtr(theta - threshold) + ndtr(-theta - threshold))
        return float(ndtr(theta - d)) / max(selected, 1e-300)

    low = _root(lambda t: beyond(t) - tail, d - _WIDEST, d)
    high = _root(lambda t: beyond(t) - (1.0 - tail), d - _WIDEST, d + quantile + 1.0)
    return d - low, max(high - d, 0.0)


def conditioned(estimate: Estimate, toward_low: bool, d: float, threshold: float, quantile: float) -> Estimate:
    """An estimate of a size of d standard deviations, conditioned on its detection.

    toward_low : whether the value is smaller where the effect is absent.
    """
    toward, away = (x / quantile for x in reach(d, threshold, quantile))
    below, above = (toward, away) if toward_low else (away, toward)
    low, high = estimate.ci95
    return Estimate(
        estimate.value,
        estimate.unit,
        (estimate.value - below * (estimate.value - low), estimate.value + above * (high - estimate.value)),
    )


def _root(f: Callable[[float], float], low: float, high: float) -> float:
    """Where a function that rises crosses 0; the nearer end where it does not."""
    if f(low) > 0.0:
        return low
    return float(brentq(f, low, high)) if f(high) > 0.0 else high
