"""The evidence of a hypothesis, by Laplace's approximation, and the widths of priors estimated from the record.

    -2 ln p(data | hypothesis) = |z|² + ln det C - 2 ln(priors) + ln det(JᵀJ + Λ) - p ln 2π   at the maximum,

with the whitened residual z, its Jacobian J and the curvature Λ of the priors. Nuisances have a prior about 0.
The size x of an effect, in units of its typical size, has a prior that favours no decade: it is uniform on a
logarithmic scale, and decreases beyond X = 10, as 1/(x (1 + (x/X)²)); the evidence integrates over the allowed range
only. So every unknown is penalised by the ratio of posterior to prior width; BIC is the limit of many data.

Unknowns of a group share the width of their Gaussian priors: the one that makes the record most probable (empirical
Bayes), or 0, which means that there are no deviations. D. J. C. MacKay, Neural Computation 4 (1992) 415. An outlier
has its own width, far beyond the stated spread; otherwise it would widen its whole group.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import erfcx, ndtr

from .fit import Array, Fit
from .unknown import Unknown, bounds, penalty, precision

DECADES = 3.0  # over which the sizes of an effect are spread
LARGE = 10.0  # X, typical sizes of an effect, from which ever fewer are expected: judgement
WIDTHS = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.4, 2.0)  # possible widths of a group, in its stated spreads
APART = (2.0, 4.0, 8.0, 16.0, 32.0)  # possible widths of an outlier, equally likely
DOUBT = 1.0  # standard deviation of the logarithm of a width about the stated spread
COMMON = 0.5  # probability beforehand that a group has no deviations
_SWEEPS = 3
_FREE = 1e-9  # precision of a flat prior
LOG_RANGE = DECADES * math.log(10.0)
_FAR = 1e200  # so that what is appended stays positive definite; it has no influence on the rows before it


@dataclass(frozen=True)
class Widths:
    """The width of every group, in its stated spreads. score : -2 ln evidence with these widths."""

    of: Mapping[str, float]
    score: float


class Linear:
    """The linear problem of p unknowns about a point, with the evidence as a function of the widths (fast).

    normal : (p+1, p+1) [J y]ᵀ [J y] of the whitened residual y + J x. x : (p,) the point. log_volume : ln det C.

    Of the q unknowns inside their ranges (the others are fixed at a bound):
    gram : (q, q) JᵀJ. right : (q,) Jᵀy. free : (q,) True for sizes of effects. groups : (q,) names, "" without a
    group. signs : (q,) 2 for a size that may be negative, else 1. sd : (q,) of the priors of unknowns without a group.
    held : -2 ln of the priors of the fixed unknowns. rest : the part independent of the widths, with yᵀy, ln det C and
    ``held``.
    """

    def __init__(self, normal: Array, x: Array, unknowns: Sequence[Unknown], log_volume: float = 0.0) -> None:
        prior = np.array([_FREE if u.prior_sd is None else u.prior_sd**-2.0 for u in unknowns])
        downhill = -((normal @ np.append(x, 1.0))[:-1] + precision(prior, x) * x)
        low, high = bounds(unknowns)
        moves = ~((x <= low) & (downhill < 0.0) | (x >= high) & (downhill > 0.0))  # the others are held at a bound
        still = [(u, i) for i, u in enumerate(unknowns) if not moves[i]]
        sd = _free_sds(normal, x, prior, unknowns) if any(u.of_size for u, _ in still) else np.zeros(len(x))
        self.held = sum(
            _price(u, x[i], sd[i], downhill[i]) if u.of_size else penalty(prior[[i]], x[[i]]) for u, i in still
        )
        # the fixed unknowns contribute to y
        gone = np.concatenate([np.where(moves, 0.0, x), [1.0]])
        self.gram, self.right = normal[:-1, :-1][np.ix_(moves, moves)], (normal @ gone)[:-1][moves]
        rest, x, prior = float(gone @ normal @ gone), x[moves], prior[moves]
        unknowns = [u for u, m in zip(unknowns, moves, strict=True) if m]
        self.free = np.array([u.of_size for u in unknowns], bool)
        self.groups = ["" if u.stated else u.group for u in unknowns]
        self.apart = {u.group for u in unknowns if u.apart}
        self.signs = np.array([_signs(u) for u in unknowns])
        self.low, self.high = bounds(unknowns)
        grouped = np.array([bool(g) for g in self.groups], bool)
        local = precision(prior, x)
        plain = ~self.free & ~grouped
        self.sd = np.where(self.free, 1.0, np.sqrt(1.0 / local))
        # the tails of the priors of common nuisances, to second order about x
        self.rest = rest + log_volume + penalty(prior[plain], x[plain]) - float(local[plain] @ x[plain] ** 2)
        self.rest += float(np.log(local[plain]).sum() - np.log(prior[plain]).sum()) + self.held

    @classmethod
    def of(cls, fit: Fit) -> Linear:
        """The linear problem of a fit, about its point."""
        return cls.of_columns(fit.z, fit.J, fit.x, fit.unknowns, fit.log_volume)

    @classmethod
    def of_columns(cls, z: Array, J: Array, x: Array, unknowns: Sequence[Unknown], log_volume: float = 0.0) -> Linear:
        """z : (n,) whitened residual at x, J : (n, p)."""
        tall = np.column_stack([J, z - J @ x])
        return cls(tall.T @ tall, x, unknowns, log_volume)

    def at(self, widths: Mapping[str, float] | None = None) -> float:
        """-2 ln evidence, up to a constant of the record, with these widths of the groups."""
        return float(self._scores(self._sds(widths or {})[None])[0])

    def _sds(self, widths: Mapping[str, float]) -> Array:
        """(p,) standard deviations of the priors."""
        return np.array([widths.get(g, s) if g else s for g, s in zip(self.groups, self.sd, strict=True)])

    def _of_widths(self, found: Mapping[str, float], group: str) -> Array:
        """-2 ln evidence for every possible width of a group, with the other widths fixed."""
        widths, prior = _CHOICES[group in self.apart]
        w = np.tile(self._sds(found), (len(widths), 1))
        w[:, [g == group for g in self.groups]] = widths[:, None]
        return self._scores(w) + prior

    def _scores(self, w: Array) -> Array:
        """-2 ln evidence : (m,) with standard deviations w : (m, p) of the priors."""
        ends = np.flatnonzero(self.free)
        A = w[:, :, None] * self.gram * w[:, None, :] + np.diag(np.where(self.free, _FREE, 1.0))
        right = np.zeros((*w.shape, 1 + len(ends)))
        right[:, :, 0] = w * self.right
        right[:, ends, 1 + np.arange(len(ends))] = 1.0
        left, volume = forward(A, right)
        value = self.rest - (left[:, :, 0] ** 2).sum(axis=1) + volume
        if not len(ends):
            return np.asarray(value)
        # -2 ln of the priors 1/(2 |x| (1 + (x/X)²) ln range) of effects, less ln 2π of each; |x| not below its sd
        x, sd = -np.einsum("mp,mpi->mi", left[:, :, 0], left[:, :, 1:]), np.sqrt((left[:, :, 1:] ** 2).sum(axis=1))
        size = np.maximum(np.abs(x), sd) / _share(x, sd, self.low[ends], self.high[ends])
        sizes = 2.0 * np.log(self.signs[ends] * size * (1.0 + (x**2 + sd**2) / LARGE**2) * LOG_RANGE).sum(axis=1)
        return np.asarray(value + sizes - len(ends) * math.log(2.0 * math.pi))

    def inferred(self) -> Widths:
        """The most probable widths, by a few sweeps over the groups."""
        found = {g: APART[-1] if g in self.apart else 1.0 for g in dict.fromkeys(self.groups) if g}
        best = math.inf
        for _ in range(_SWEEPS):
            value = best
            for group in found:
                scores = self._of_widths(found, group)
                value, found[group] = float(scores.min()), float(_CHOICES[group in self.apart][0][scores.argmin()])
            if value > best - 0.1:
                break
            best = value
        return Widths(found, self.at(found) + sum(beforehand(w, g in self.apart) for g, w in found.items()))

    def spreads(self) -> dict[str, float]:
        """Per group the root mean square of its width over its posterior, with the other widths fixed."""
        found, many = self.inferred().of, np.zeros(len(WIDTHS))  # WIDTHS represent the continuous range of a width
        many[1:] = 2.0 * math.log(np.exp(-0.5 * _CHOICES[False][1][1:]).sum() / (1.0 - COMMON))
        spread = {}
        for group in found:
            widths = _CHOICES[group in self.apart][0]
            score = self._of_widths(found, group) + (0.0 if group in self.apart else many)
            p = np.exp(-0.5 * (score - score.min()))
            spread[group] = math.sqrt(float(p @ widths**2 / p.sum()))
        return spread


def _free_sds(normal: Array, x: Array, prior: Array, unknowns: Sequence[Unknown]) -> Array:
    """(p,) marginal standard deviations of the unknowns at x, without their ranges.

    Raises LinAlgError if sources absorb an unknown to round-off, which may give a negative variance.
    """
    local = np.where([u.of_size for u in unknowns], _FREE, precision(prior, x))
    A = normal[:-1, :-1] + np.diag(local)
    scale = np.sqrt(np.diag(A))
    variance = np.diag(np.linalg.pinv(A / np.outer(scale, scale), hermitian=True))
    if variance.min(initial=0.0) < 0.0:
        raise np.linalg.LinAlgError("no information is below 0")
    return np.asarray(np.sqrt(variance) / scale)


def _signs(unknown: Unknown) -> float:
    return 2.0 if unknown.low < 0.0 else 1.0


def _share(x: Array, sd: Array, low: Array, high: Array) -> Array:
    """The fraction of a Gaussian that lies in a range : (…, n); its maximum is in it, or at an end."""
    x = np.clip(x, low, high)
    return np.asarray(ndtr((high - x) / sd) - ndtr((low - x) / sd))


def _price(unknown: Unknown, x: float, sd: float, downhill: float) -> float:
    """-2 ln ∫ exp(-g u - u²/2 sd²) du/(signs max(|x|, sd) (1 + (x/X)²) ln range) over u >= 0 for a size at its bound.

    u : distance into the range. sd : without the bound. downhill : ±g, the slope of -ln p beyond the bound.
    A parameter with equal bounds pays as if its size equalled its standard deviation, without a range.
    """
    if unknown.low == unknown.high:
        return 2.0 * math.log(_signs(unknown) * LOG_RANGE / math.sqrt(2.0 * math.pi))
    width = math.sqrt(0.5 * math.pi) * sd * float(erfcx(abs(downhill) * sd / math.sqrt(2.0)))
    return 2.0 * math.log(_signs(unknown) * max(abs(x), sd) * (1.0 + (x / LARGE) ** 2) * LOG_RANGE / width)


def beforehand(width: float, apart: bool = False) -> float:
    """-2 ln of the prior of a width: 0 for a group without deviations, else log-normal about the stated spread.

    apart : for an outlier.
    """
    if apart:
        return 2.0 * math.log(len(APART))
    if width == 0.0:
        return -2.0 * math.log(COMMON)
    return (math.log(width) / DOUBT) ** 2 - 2.0 * math.log(1.0 - COMMON)


# (n,) possible widths and -2 ln of their priors; key True: for an outlier
_CHOICES = {
    apart: (np.array(widths), np.array([beforehand(w, apart) for w in widths]))
    for apart, widths in ((False, WIDTHS), (True, APART))
}


def forward(A: Array, right: Array) -> tuple[Array, Array]:
    """L⁻¹ right : (…, p, n) and ln det A : (…,), with A = L Lᵀ : (…, p, p) and right : (…, p, n).

    The right-hand sides are appended to A as rows, so that the factorisation solves for them: NumPy has no triangular
    solve, and its general one takes longer than the factorisation. Raises LinAlgError if A is not positive definite.
    """
    p, n = right.shape[-2:]
    both = np.zeros((*A.shape[:-2], p + n, p + n))
    both[..., :p, :p] = A
    both[..., p:, :p] = right.swapaxes(-1, -2)
    both[..., range(p, p + n), range(p, p + n)] = _FAR
    L = np.linalg.cholesky(both)
    diagonal = np.diagonal(L, axis1=-2, axis2=-1)[..., :p]
    return L[..., p:, :p].swapaxes(-1, -2), 2.0 * np.log(diagonal).sum(axis=-1)


def with_widths(fit: Fit) -> Fit:
    """A fit with the widths of its groups, averaged over their posterior, in its covariance, which is linear in w²."""
    return replace(fit, widths=Linear.of(fit).spreads())


def score(fit: Fit) -> float:
    """-2 ln evidence of a fit, up to a constant of the record, with the most probable widths of its groups."""
    return Linear.of(fit).inferred().score
