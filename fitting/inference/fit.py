"""A hypothesis refitted to a record, and the test of its whitened residual."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import log_ndtr, ndtri_exp

from .hypothesis import PlacedEffect
from .unknown import Array, Unknown, bounds, penalty, precision, precisions

_ODD = 4.0  # standard deviations of a prior
# Partial sums over n harmonics whose largest is that of _INDEPENDENT √n independent ones: from P(T > t) of 100 000
# residuals of one channel with 2 to 41 harmonics, at probabilities of 10 to 0.3 %: 1.15 to 1.4
_INDEPENDENT = 1.25
_RARE = -30.0  # logarithm of a probability that is its own 1 - exp(-p)


@dataclass(frozen=True)
class Member:
    """One point of one hypothesis."""

    terms: tuple[PlacedEffect, ...]
    unknowns: tuple[Unknown, ...]
    x: Array


@dataclass(frozen=True)
class Fit:
    """The maximum of likelihood and priors of one hypothesis.

    unknowns : nuisances first, then those of ``terms``; x : (p,). z : (n,) whitened residual, N(0, 1) if the hypothesis
    is true; J : (n, p) its derivatives. order : (n,) the harmonic of each entry of z. signal : (n,) the channel of each
    entry. converged : whether the search converged. log_volume : log det of the covariance of z, if it depends on the
    hypothesis. widths : of the priors of groups, in their stated spreads, if they were estimated. derived_at : (p,)
    the point at which all of J was computed; None if it was updated since.
    """

    terms: tuple[PlacedEffect, ...]
    unknowns: tuple[Unknown, ...]
    x: Array
    z: Array
    J: Array
    order: Array
    signal: Array
    converged: bool = True
    log_volume: float = 0.0
    widths: Mapping[str, float] = field(default_factory=dict)
    derived_at: Array | None = None

    @property
    def derived(self) -> bool:
        """True if z and J were computed at x, not predicted or updated."""
        at = self.derived_at
        return at is not None and self.J.shape[1] == len(at) and np.array_equal(at, self.x)

    @property
    def member(self) -> Member:
        """The point of the fit."""
        return Member(self.terms, self.unknowns, self.x)

    @property
    def prior(self) -> Array:
        """(p,) precision of the priors of x at 0."""
        return precisions(self.unknowns)

    @property
    def columns(self) -> dict[str, Array]:
        """(n,) whitened derivatives by name of the unknown."""
        return dict(zip((u.name for u in self.unknowns), self.J.T, strict=True))

    @property
    def chi2(self) -> float:
        """|z|² of the data."""
        return float(self.z @ self.z)

    @property
    def odd(self) -> bool:
        """True if an unknown is so far from its prior mean that another minimum may be better."""
        return bool(np.any(self.prior * self.x**2 > _ODD**2))

    @property
    def cost(self) -> float:
        """-2 log of likelihood and priors, up to a constant: the cost function of the search."""
        return self.chi2 + penalty(self.prior, self.x) + self.log_volume

    @property
    def covariance(self) -> Array:
        """(p, p) of x - truth: A⁻¹ with A = JᵀJ + Λ and the curvature Λ of the priors.

        x was fitted with the stated spreads. If true values spread by ``widths`` w of those, x - truth = A⁻¹ (Jᵀn - Λ
        truth) with noise n has the covariance A⁻¹ (JᵀJ + w² Λ) A⁻¹.
        """
        data, own = self.J.T @ self.J, precision(self.prior, self.x)
        known = np.linalg.pinv(data + np.diag(own), hermitian=True)
        if not self.widths:
            return known
        w = np.array([self.widths.get(u.group, 1.0) for u in self.unknowns])
        return known @ (data + np.diag(w**2 * own)) @ known


def taken_over(terms: tuple[PlacedEffect, ...], unknowns: tuple[Unknown, ...], start: Fit | None) -> Member:
    """A start for one hypothesis: the values of another fit for shared unknowns, zero for all others, within bounds."""
    known = {} if start is None else dict(zip((u.name for u in start.unknowns), start.x, strict=True))
    return Member(terms, unknowns, np.clip([known.get(u.name, 0.0) for u in unknowns], *bounds(unknowns)))


def sizes_of(fit: Fit, term: PlacedEffect) -> list[float]:
    """The numbers of a term in a fit."""
    return [float(x) for u, x in zip(fit.unknowns, fit.x, strict=True) if u in term.unknowns]


def begun(member: Member, term: PlacedEffect) -> list[Member]:
    """Start points of a search for one term of a member: the present point, and the starts of the term."""
    at = [i for i, u in enumerate(member.unknowns) if u in term.unknowns]
    trials = [member]
    for values in term.starts:
        x = member.x.copy()
        x[at] = values
        trials.append(replace(member, x=x))
    return trials


def projected(J: Array, prior: Array, columns: Array) -> Array:
    """The part of whitened columns (n, q) that a refit of the unknowns J : (n, p) with their priors cannot absorb."""
    tall = np.concatenate([J, np.diag(np.sqrt(prior))])
    q = np.linalg.qr(tall)[0]
    padded = np.concatenate([columns, np.zeros((len(prior), columns.shape[1]))])
    return padded - q @ (q.T @ padded)


def misfit(fit: Fit, dof_of_noise: float) -> float:
    """The significance of the residual, as a standard normal deviate of equal probability.

    Missing physics mainly affects low harmonics, so a sum over all harmonics would hide it. For every channel, and for
    all together, the test takes Σ z² - 1 over harmonics up to k, for each k (an adaptive Neyman test, Fan 1996), each
    divided by its standard deviation, which includes that of the noise estimate with ``dof_of_noise`` degrees of
    freedom. For pure noise the largest value T has P(T > t) = 1 - exp(-n (1 - Φ(t))), with n effectively independent
    values.
    """
    worst = -np.inf
    signals = np.unique(fit.signal)
    groups = [np.ones(len(fit.z), bool)] + [fit.signal == s for s in signals if len(signals) > 1]
    p = max(fit.x.size - int((fit.prior > 0.5).sum()), 0)
    for i, group in enumerate(groups):
        order = np.argsort(fit.order[group], kind="stable")
        k, excess = fit.order[group][order], (fit.z[group] ** 2)[order]
        sums, n = np.cumsum(excess), np.arange(1, len(excess) + 1)
        ends = np.flatnonzero(np.append(np.diff(k) > 0, True))
        lost = np.minimum(p, n[ends] - 1) if i == 0 else 0.0
        mean = n[ends] - lost
        ratio = sums[ends] / mean
        # Wilson-Hilferty: the cube root of chi2/n is close to normal, tails too
        spread = np.sqrt(2.0 / 9.0 * (1.0 / mean + 1.0 / dof_of_noise))
        deviation = (np.cbrt(ratio) - (1.0 - 2.0 / (9.0 * mean))) / spread
        worst = max(worst, float(deviation.max()))
    independent = _INDEPENDENT * len(groups) * math.sqrt(len(np.unique(fit.order)))
    log_p = math.log(independent) + float(log_ndtr(-worst))
    return -float(ndtri_exp(math.log(-math.expm1(-math.exp(log_p))) if log_p > _RARE else log_p))
