"""The evidence of a hypothesis, by Laplace's approximation, and the widths of priors that the record itself tells.

    -2 ln p(data | hypothesis) = |z|² + ln det C - 2 ln(priors) + ln det(JᵀJ + Λ) - p ln 2π   at the maximum,

with the whitened residual z, its Jacobian J and the curvature Λ of the priors. What is refitted has a prior about 0.
The size of an effect has one that favours no decade: from hardly visible to typical, sizes are equally likely on a
logarithmic scale. Every unknown so pays for what the data made of its prior; BIC is the limit of many data.

Unknowns of a group share the width of their Gaussian priors: the one that makes the record most probable (empirical
Bayes), or 0, which means that there are no deviations. D. J. C. MacKay, Neural Computation 4 (1992) 415.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .fit import Fit
from .unknown import Unknown, bounds, penalty, precision

Array = np.ndarray

DECADES = 3.0  # over which the sizes of an effect are spread
WIDTHS = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.4, 2.0)  # that a group may have, in its stated spreads
DOUBT = 1.0  # standard deviation of the logarithm of a width about the stated spread
COMMON = 0.5  # probability beforehand that a group has no deviations
_SWEEPS = 3
_FREE = 1e-9  # precision that stands for none
LOG_RANGE = DECADES * math.log(10.0)


@dataclass(frozen=True)
class Widths:
    """Of every group, in its stated spreads. score : -2 ln evidence there."""

    of: Mapping[str, float]
    score: float


class Linear:
    """Unknowns p about a point as a linear problem: what widths do to its evidence, in a fraction of a millisecond.

    z : (n,) whitened residual at x : (p,). J : (n, p). log_volume : ln det C.

    Of the q unknowns that are not held at an end of their range, and of y = z - J x, the residual at 0:
    gram : (q, q) JᵀJ. right : (q,) Jᵀy. free : (q,) which are sizes of effects. groups : (q,) names, "" where there is
    none. signs : (q,) 2 of a size that may be negative, else 1. sd : (q,) of the priors of what has no group.
    held : -2 ln of the priors of the others, where they are held. rest : what widths do not change, with yᵀy, ln det C
    and ``held``.
    """

    def __init__(self, z: Array, J: Array, x: Array, unknowns: Sequence[Unknown], log_volume: float = 0.0) -> None:
        prior = np.array([_FREE if u.prior_sd is None else u.prior_sd**-2.0 for u in unknowns])
        moves = ~_held(z, J, x, prior, unknowns)
        still = [(u, i) for i, u in enumerate(unknowns) if not moves[i]]
        self.held = sum(_price(u) if u.of_size else penalty(prior[[i]], x[[i]]) for u, i in still)
        J, x, prior = J[:, moves], x[moves], prior[moves]
        unknowns = [u for u, m in zip(unknowns, moves, strict=True) if m]
        y = z - J @ x
        self.gram, self.right = J.T @ J, J.T @ y
        self.free = np.array([u.of_size for u in unknowns], bool)
        self.groups = ["" if u.stated else u.group for u in unknowns]
        self.signs = np.array([2.0 if u.low < 0.0 else 1.0 for u in unknowns])
        grouped = np.array([bool(g) for g in self.groups], bool)
        local = precision(prior, x)
        plain = ~self.free & ~grouped
        self.sd = np.where(self.free, 1.0, np.sqrt(1.0 / local))
        # the tails of the priors of what all have in common, to second order about x
        self.rest = float(y @ y) + log_volume + penalty(prior[plain], x[plain]) - float(local[plain] @ x[plain] ** 2)
        self.rest += float(np.log(local[plain]).sum() - np.log(prior[plain]).sum()) + self.held

    @classmethod
    def of(cls, fit: Fit) -> Linear:
        """Of a fit, about where it is."""
        return cls(fit.z, fit.J, fit.x, fit.unknowns, fit.log_volume)

    def at(self, widths: Mapping[str, float] | None = None) -> float:
        """-2 ln evidence, up to a constant of the record, with these widths of the groups."""
        return float(self._scores(self._sds(widths or {})[None])[0])

    def _sds(self, widths: Mapping[str, float]) -> Array:
        """(p,) standard deviations of the priors."""
        return np.array([widths.get(g, s) if g else s for g, s in zip(self.groups, self.sd, strict=True)])

    def _of_widths(self, found: Mapping[str, float], group: str) -> Array:
        """-2 ln evidence of every width that a group may have, the others as found."""
        w = np.tile(self._sds(found), (len(WIDTHS), 1))
        w[:, [g == group for g in self.groups]] = np.array(WIDTHS)[:, None]
        return self._scores(w) + _BEFOREHAND

    def _scores(self, w: Array) -> Array:
        """-2 ln evidence : (m,) with standard deviations w : (m, p) of the priors."""
        ends = np.flatnonzero(self.free)
        A = w[:, :, None] * self.gram * w[:, None, :] + np.diag(np.where(self.free, _FREE, 1.0))
        right = np.zeros((*w.shape, 1 + len(ends)))
        right[:, :, 0] = w * self.right
        right[:, ends, 1 + np.arange(len(ends))] = 1.0
        left = np.linalg.solve(A, right)
        gain = np.einsum("mi,mi->m", right[:, :, 0], left[:, :, 0])
        volume = np.log(np.diagonal(np.linalg.cholesky(A), axis1=1, axis2=2)).sum(axis=1)
        value = self.rest - gain + 2.0 * volume
        if not len(ends):
            return np.asarray(value)
        # -2 ln of the priors 1/(2 |x| ln range) of effects, less ln 2π of each; not below its standard deviation
        size = np.maximum(np.abs(left[:, ends, 0]), np.sqrt(left[:, ends, 1 + np.arange(len(ends))]))
        sizes = 2.0 * np.log(self.signs[ends] * size * LOG_RANGE).sum(axis=1)
        return np.asarray(value + sizes - len(ends) * math.log(2.0 * math.pi))

    def inferred(self) -> Widths:
        """The most probable widths, one group after the other, a few times."""
        found = dict.fromkeys(dict.fromkeys(g for g in self.groups if g), 1.0)
        best = math.inf
        for _ in range(_SWEEPS):
            value = best
            for group in found:
                scores = self._of_widths(found, group)
                value, found[group] = float(scores.min()), WIDTHS[int(scores.argmin())]
            if value > best - 0.1:
                break
            best = value
        return Widths(found, self.at(found) + sum(map(beforehand, found.values())))

    def spreads(self) -> dict[str, float]:
        """Of every group the root of the mean square of its width, over all that it may be, the others as inferred."""
        found, widths = self.inferred().of, np.array(WIDTHS)
        many = np.zeros(len(WIDTHS))  # WIDTHS stand for all that a group with deviations may have
        many[1:] = 2.0 * math.log(np.exp(-0.5 * _BEFOREHAND[1:]).sum() / (1.0 - COMMON))
        spread = {}
        for group in found:
            score = self._of_widths(found, group) + many
            p = np.exp(-0.5 * (score - score.min()))
            spread[group] = math.sqrt(float(p @ widths**2 / p.sum()))
        return spread


def _held(z: Array, J: Array, x: Array, prior: Array, unknowns: Sequence[Unknown]) -> Array:
    """(p,) which unknowns stand at an end of their range that the data would have them leave."""
    downhill = -(J.T @ z + precision(prior, x) * x)
    low, high = bounds(unknowns)
    return np.asarray(((x <= low) & (downhill < 0.0)) | ((x >= high) & (downhill > 0.0)))


def _price(unknown: Unknown) -> float:
    """-2 ln of what is left of the prior of a size that is as large as its own standard deviation."""
    return 2.0 * math.log((2.0 if unknown.low < 0.0 else 1.0) * LOG_RANGE / math.sqrt(2.0 * math.pi))


def beforehand(width: float) -> float:
    """-2 ln of the prior of a width: 0 for a group without deviations, else log-normal about the stated spread."""
    if width == 0.0:
        return -2.0 * math.log(COMMON)
    return (math.log(width) / DOUBT) ** 2 - 2.0 * math.log(1.0 - COMMON)


_BEFOREHAND = np.array([beforehand(w) for w in WIDTHS])


def with_widths(fit: Fit) -> Fit:
    """A fit whose covariance goes by the widths of its groups, averaged as the record tells; it is linear in w²."""
    return replace(fit, widths=Linear.of(fit).spreads())


def score(fit: Fit) -> float:
    """-2 ln evidence of a fit, up to a constant of the record, with the most probable widths of its groups."""
    return Linear.of(fit).inferred().score
