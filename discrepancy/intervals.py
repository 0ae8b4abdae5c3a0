"""The intervals that a study states: of an effect that was searched for, and whatever the walls may be."""

from __future__ import annotations

import math

import numpy as np

from fitting.estimate import Estimate
from fitting.inference.added import estimates
from fitting.inference.jackknife import jackknife
from fitting.inference.selection import conditioned
from fitting.inference.terms import Term
from fitting.inference.unknown import quantile
from solver.network import Network

from .verdict import Naming
from .weigh import Named, found_from

_FEWEST = 3  # sites
_SMALL = 1e-3  # a weight below which a hypothesis does not count


def stated(network: Network, naming: Naming, named: Named, term: Term) -> dict[str, Estimate]:
    """Values and 95 % intervals of a term of a hypothesis.

    Averaged over walls that have all in common and walls that differ, where the record does not tell; and given that
    the effect was found, which near the limit of detection says that it is smaller than it looks.
    """
    half = quantile(naming.problem.dof_of_noise)
    found = estimates(network, named.fit, term, half)
    if naming.verdict == "partial":
        wider = _wider(naming, named, term)
        return {key: _scaled(e, wider) for key, e in found.items()}
    same = [n for n in naming.ranked if n.key[0] == named.key[0] and n.key != named.key]
    for other in same[:1]:
        weight = 1.0 / (1.0 + math.exp(min(0.5 * (other.score - named.score), 700.0)))
        if weight > _SMALL:
            (twin,) = (t for t in other.fit.terms if t.label == term.label)
            told = estimates(network, other.fit, twin, half)
            found = {key: _averaged(e, told[key], weight, half) if key in told else e for key, e in found.items()}
    sizes = [i for i, u in enumerate(named.fit.unknowns) if u in term.unknowns and u.of_size]
    if len(sizes) != 1 or len(term.unknowns) != 1:
        return found
    x, sd = float(named.fit.x[sizes[0]]), math.sqrt(float(named.fit.covariance[sizes[0], sizes[0]]))
    limit = found_from(naming.terms, term)
    return {key: conditioned(e, x > 0.0, abs(x) / sd, limit, half) for key, e in found.items()}


def _wider(naming: Naming, named: Named, term: Term) -> float:
    """By how much an interval beside an error of the model is wider than its covariance says.

    As the estimate moves when one site, or on a bench one harmonic, is left out.
    """
    fit = named.fit
    sites = [name.rpartition(".")[0] for name in naming.problem.signals]
    group = fit.order if naming.problem.site else np.array([sites.index(sites[s]) for s in fit.signal])
    if len(np.unique(group)) < _FEWEST:
        return 1.0
    mine = [i for i, u in enumerate(fit.unknowns) if u in term.unknowns]
    sd = np.sqrt(np.diag(fit.covariance))[mine]
    return float(max(1.0, *(jackknife(fit, group)[mine] / sd)))


def _scaled(told: Estimate, factor: float) -> Estimate:
    low, high = told.ci95
    return Estimate(
        told.value, told.unit, (told.value - factor * (told.value - low), told.value + factor * (high - told.value))
    )


def _averaged(first: Estimate, second: Estimate, weight: float, quantile: float) -> Estimate:
    """The first one's value, with the spread about it of the mixture of both; weight : of the second."""
    apart = quantile * (second.value - first.value)
    own, other = ([end - e.value for end in e.ci95] for e in (first, second))
    below, above = (
        math.sqrt((1.0 - weight) * a**2 + weight * (b**2 + apart**2)) for a, b in zip(own, other, strict=True)
    )
    return Estimate(first.value, first.unit, (first.value - below, first.value + above))
