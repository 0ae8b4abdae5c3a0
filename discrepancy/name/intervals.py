"""The intervals that a study states: conditional on the selection of an effect; walls are nuisance parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from fitting.inference.extended_network import estimates
from fitting.inference.fit import Fit
from fitting.inference.hierarchy import with_widths
from fitting.inference.hypothesis import PlacedEffect, effect_of, rewired
from fitting.inference.intervals import reaches
from fitting.inference.jackknife import jackknife
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown import Unknown, quantile
from fitting.results.estimate import Estimate
from solver.network.description import Network
from solver.quantities.coordinate import SCALE

from .scoring import Named, found_from
from .verdict import Naming

_FEWEST = 3  # sites
_MOST = 4  # parameters of an effect with profiled intervals
_STRAIGHT = 0.05  # relative half width below which the likelihood is as quadratic as the covariance assumes
_SEARCHES = 4  # at most, for the minimum
_GAIN = 0.05  # of the cost: a smaller gain counts as none
_FAR = 4.0  # standard deviations above the threshold beyond which selection has no effect
_WIDEST = 12.0  # that an interval may reach down


def profiled(naming: Naming, runs: Runs) -> Naming:
    """Polish the best fit, then profile the likelihood of effects with 2 to 4 parameters. Effects with more parameters,
    with narrow intervals, or not reached within the time limit keep the intervals of the covariance."""
    if not naming.adds:
        return naming
    with suppress(OutOfTime):
        naming = _at_minimum(naming, runs)
        best, half = naming.best.fit, quantile(naming.problem.dof_of_noise)
        several = [t for t in best.terms if 1 < len(t.unknowns) <= _MOST]
        chosen = [u for t in several if any(_wide(best, u, half) for u in t.unknowns) for u in t.unknowns]
        if chosen:
            naming = replace(naming, reaches=reaches(naming.problem, best, chosen, half, runs))
    return naming


def _at_minimum(naming: Naming, runs: Runs) -> Naming:
    """The best fit polished: refitted from the file's walls if its own are implausible, then with fresh derivatives
    until the cost falls no more."""
    problem, (best, *others) = naming.problem, naming.ranked
    fit = best.fit
    if fit.odd:
        fit = _lower(fit, problem.refit([fit.terms], None, runs))
    for _ in range(_SEARCHES):
        before, fit = fit, _lower(fit, problem.refine([fit], runs))
        if fit is before:
            break
    if fit is best.fit:
        return naming
    found = best.moved_to(fit, problem.dof_of_noise)
    members = tuple(found if m is best else m for m in naming.members)
    return replace(naming, ranked=(found, *others), members=members)


def _lower(fit: Fit, others: Sequence[Fit | None]) -> Fit:
    """The fit of the lowest cost. Another one must gain more than _GAIN, unless it alone has converged."""

    def gained(other: Fit) -> bool:
        alone = other.converged and not fit.converged
        return other.cost < fit.cost + (_GAIN if alone else -_GAIN)

    return min((f for f in others if f is not None and gained(f)), key=lambda f: f.cost, default=fit)


def _wide(fit: Fit, unknown: Unknown, half: float) -> bool:
    """True if an interval is so wide that the likelihood may not be quadratic, or reaches a bound."""
    i = fit.unknowns.index(unknown)
    x, reach = float(fit.x[i]), half * math.sqrt(float(fit.covariance[i, i]))
    narrow = reach < _STRAIGHT * (1.0 / unknown.size if unknown.kind == SCALE else abs(x))
    return not narrow or x - reach <= unknown.low or x + reach >= unknown.high


def stated(network: Network, naming: Naming, named: Named, term: PlacedEffect) -> dict[str, Estimate]:
    """Estimates with 95 % intervals, within their ranges, of a term of a hypothesis. The spread of the walls is that
    estimated from the record.

    Those of a one-parameter effect are conditional on its selection, which makes them smaller near the limit of
    detection. Intervals of a partial verdict are widened instead (:func:`_wider`).
    """
    half, fit = quantile(naming.problem.dof_of_noise), with_widths(named.fit)
    found = estimates(network, fit, term, half, naming.reaches if named.key == naming.best.key else None)
    if naming.verdict == "partial":
        wider = _wider(naming, fit, term)
        found = {key: _scaled(e, wider) for key, e in found.items()}
    elif len(term.unknowns) == 1 and term.unknowns[0].of_size:
        i = fit.unknowns.index(term.unknowns[0])
        x, sd = float(fit.x[i]), math.sqrt(float(fit.covariance[i, i]))
        limit = found_from(naming.terms, term, named)
        found = {key: conditioned(e, x > 0.0, abs(x) / sd, limit, half) for key, e in found.items()}
    known = rewired(network, named.fit.terms).parameter_quantities()
    known = known | {f"{term.place}.{k}": q for k, q in effect_of(term).terms.items()}
    return {key: e.within(known[key].low, known[key].high) if key in known else e for key, e in found.items()}


def _wider(naming: Naming, fit: Fit, term: PlacedEffect) -> float:
    """The factor by which model discrepancy widens an interval beyond its covariance.

    It is the scatter of the estimate when one site, or on a bench one harmonic, is left out (jackknife), at least 1.
    """
    parts = naming.problem.without_each(fit)
    if len(parts) < _FEWEST:
        return 1.0
    mine = [i for i, u in enumerate(fit.unknowns) if u in term.unknowns]
    sd = np.sqrt(np.diag(fit.covariance))[mine]
    return float(max(1.0, *(jackknife(fit, parts)[mine] / sd)))


def _scaled(estimate: Estimate, factor: float) -> Estimate:
    low, high = (estimate.value + factor * (end - estimate.value) for end in estimate.ci95)
    return replace(estimate, ci95=(low, high))


# --- after selection --------------------------------------------------------------------------------------------------
# Noise has usually increased the estimate of an effect just above its threshold. The size x ~ N(θ, 1) of an effect is
# reported only if |x| > c. Given that it was,
#
#     P(X > x) = Φ(θ - x)/S for x > c,   S = Φ(θ - c) + Φ(-θ - c),
#
# and the interval of θ contains the values for which x lies between the 2.5 % and 97.5 % points. Far above c it is
# x ± 1.96. H. Zhong, R. L. Prentice, Biostatistics 9 (2008) 621.


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
