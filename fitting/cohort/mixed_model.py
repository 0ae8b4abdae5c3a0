"""Site means when every animal gives several sites: fixed site, random animal, by restricted maximum likelihood.

    y_ij = μ_j + a_i + e_ij,   Var y_i = σ² (1 + λ 11ᵀ)

for animal i at site j, with one value per cell; cells may be missing. λ = σ_a²/σ² may be slightly negative, because a
covariance between the sites of one animal may be: with a bound at 0, contrasts between sites would seem too certain. So
balanced data give exactly the analysis of variance, and two sites the paired t test. Degrees of freedom by
Satterthwaite's method, of F tests by that of Fai and Cornelius (J. Stat. Comput. Simul. 54, 1996, 363–378).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import fdtrc, stdtr, stdtrit

from solver.errors import InputError

Array = np.ndarray

_GRID = np.linspace(np.log(1e-6), np.log(1e8), 57)  # of log(1 + n_max λ), to locate the maximum likelihood
_NOTHING = 1e-28  # scatter due to rounding, relative to the squares of the values


@dataclass(frozen=True)
class Contrast:
    """A combination of site means: estimate, standard error, degrees of freedom."""

    estimate: float
    se: float
    df: float

    def interval(self, level: float) -> tuple[float, float]:
        """Its two-sided interval, 0 < level < 1, by Student's t."""
        half = float(stdtrit(self.df, 0.5 + 0.5 * level)) * self.se
        return self.estimate - half, self.estimate + half

    def p_value(self) -> float:
        """Two-sided p of a true value of 0."""
        if self.se == 0.0:
            return float(self.estimate == 0.0)
        return float(2.0 * stdtr(self.df, -abs(self.estimate) / self.se))


@dataclass(frozen=True)
class RandomIntercept:
    """sites : labels in the order of ``means`` : (J,). residual, shared : σ² and σ_a² = λσ² (see above for its sign).

    animals, n : numbers of animals and values.
    """

    sites: tuple[str, ...]
    means: Array
    residual: float
    shared: float
    animals: int
    n: int
    _inverse: Array  # A⁻¹ : (J, J), the covariance of the means over σ²
    _slope: Array  # its derivative by λ
    _variances: Array  # (2, 2) covariance of (log σ², λ)

    def contrast(self, weights: Sequence[float] | Array) -> Contrast:
        """Σ w_j μ_j with Satterthwaite's degrees of freedom. weights : (J,)."""
        w = np.asarray(weights, float)
        scaled = float(w @ self._inverse @ w)
        gradient = np.array([1.0, float(w @ self._slope @ w) / scaled])
        df = 2.0 / float(gradient @ self._variances @ gradient)
        return Contrast(float(w @ self.means), float(np.sqrt(self.residual * scaled)), df)

    def deviations(self) -> tuple[Contrast, ...]:
        """μ_j minus the mean of all μ, for each site."""
        J = len(self.sites)
        return tuple(self.contrast(row) for row in np.eye(J) - 1.0 / J)

    def overall(self) -> Contrast:
        """The mean of all μ_j."""
        return self.contrast(np.full(len(self.sites), 1.0 / len(self.sites)))

    def f_test(self) -> tuple[float, float, float, float]:
        """F, its two degrees of freedom, and p of equal site means."""
        q = len(self.sites) - 1
        rows = np.eye(q, q + 1) - np.eye(q, q + 1, 1)
        _, axes = np.linalg.eigh(rows @ self._inverse @ rows.T)
        parts = [self.contrast(axis @ rows) for axis in axes.T]  # uncorrelated
        if self.residual == 0.0:
            return np.inf, float(q), float(self.n), 0.0
        F = sum((part.estimate / part.se) ** 2 for part in parts) / q
        E = sum(part.df / (part.df - 2.0) for part in parts if part.df > 2.0)
        df = 2.0 * E / (E - q) if E > q else min(part.df for part in parts)
        return F, float(q), df, float(fdtrc(q, df, F))


def random_intercept(y: Array, sites: Sequence[str], animals: Sequence[str]) -> RandomIntercept:
    """Fit the model to the values y : (n,) of ``sites`` and ``animals`` : n labels each.

    Sites are in the order of their first value. Raises ValueError unless there are two sites, two animals, an animal
    with two sites, more values than sites, and at most one value per cell.
    """
    data = _Data.of(np.asarray(y, float), list(sites), list(animals))
    lam = data.best() if data.squares > _NOTHING * data.size else 0.0
    state = data.at(lam)
    rss, inverse, w = max(state.rss, 0.0), state.inverse, state.w
    M = np.diag(data.counts * w) - np.outer(w, w) * (data.S @ inverse @ data.S.T)
    information = 0.5 * np.array([[data.dof, np.trace(M)], [np.trace(M), np.sum(M * M)]])
    residual = rss / data.dof if data.squares > _NOTHING * data.size else 0.0
    return RandomIntercept(
        data.labels,
        data.centre + inverse @ state.b,
        residual,
        lam * residual,
        len(data.counts),
        data.n,
        inverse,
        inverse @ (data.S.T @ (w[:, None] ** 2 * data.S)) @ inverse,
        np.linalg.inv(information),
    )


@dataclass(frozen=True)
class _State:
    """At one λ: A⁻¹, Xᵀ W y, 1/(1 + n_i λ), residual sum of squares, minus twice the log-likelihood, its slope."""

    inverse: Array
    b: Array
    w: Array
    rss: float
    cost: float
    slope: float


@dataclass(frozen=True)
class _Data:
    """S : (animals, J) mask of existing cells; values minus ``centre``, the plain site means, for their sums.

    W = 1 - λ/(1 + n_i λ) 11ᵀ is the inverse of Var y_i/σ², so λ depends only on sums by animal and by site.
    """

    labels: tuple[str, ...]
    S: Array
    centre: Array
    totals: Array
    squares: float
    size: float

    @staticmethod
    def of(y: Array, sites: list[str], animals: list[str]) -> _Data:
        labels, groups = tuple(dict.fromkeys(sites)), list(dict.fromkeys(animals))
        cells = np.full((len(groups), len(labels)), np.nan)
        for value, site, animal in zip(y, sites, animals, strict=True):
            cell = groups.index(animal), labels.index(site)
            if not np.isnan(cells[cell]):
                raise InputError(f"subject {animal} has two values at site {site}; give one.")
            cells[cell] = value
        there = ~np.isnan(cells)
        if len(labels) < 2 or len(groups) < 2 or there.sum(axis=1).max() < 2 or there.sum() < len(labels) + 2:
            counts = zip((int(there.sum()), len(groups), len(labels)), ("value", "subject", "site"), strict=True)
            values, subjects, places = (f"{n} {noun}{'' if n == 1 else 's'}" for n, noun in counts)
            raise InputError(
                f"{values} of {subjects} at {places} cannot separate sites from subjects; "
                "give two sites or more of at least two subjects each."
            )
        centre = np.nanmean(cells, axis=0)
        residual = np.where(there, cells - centre, 0.0)
        return _Data(
            labels,
            there.astype(float),
            centre,
            residual.sum(axis=1),
            float(np.sum(residual**2)),
            float(np.nansum(cells**2)),
        )

    @property
    def counts(self) -> Array:
        return np.asarray(self.S.sum(axis=1))

    @property
    def n(self) -> int:
        return int(self.S.sum())

    @property
    def dof(self) -> int:
        return self.n - len(self.labels)

    def at(self, lam: float) -> _State:
        n = self.counts
        w = 1.0 / (1.0 + n * lam)
        c = lam * w
        inverse = np.linalg.inv(np.diag(self.S.sum(axis=0)) - self.S.T @ (c[:, None] * self.S))
        b = -self.S.T @ (c * self.totals)  # the sums by site vanish: y is centred
        means = inverse @ b
        rss = self.squares - float(c @ self.totals**2) - float(b @ means)
        residual = self.totals - self.S @ means
        leverage = np.einsum("ij,jk,ik->i", self.S, inverse, self.S)
        cost = self.dof * np.log(max(rss, 1e-300)) - np.sum(np.log(w)) - np.linalg.slogdet(inverse)[1]
        slope = -self.dof * float(w**2 @ residual**2) / max(rss, 1e-300) + float(n @ w) - float(w**2 @ leverage)
        return _State(inverse, b, w, rss, float(cost), slope)

    def best(self) -> float:
        """λ of the largest restricted likelihood."""
        n_max = float(self.counts.max())

        def lam(log_kappa: float) -> float:
            return float(np.expm1(log_kappa) / n_max)

        costs = [self.at(lam(x)).cost for x in _GRID]
        i = int(np.argmin(costs))
        low, high = _GRID[max(i - 1, 0)], _GRID[min(i + 1, len(_GRID) - 1)]
        if self.at(lam(low)).slope >= 0.0 or self.at(lam(high)).slope <= 0.0:
            return lam(_GRID[i])  # at an end of the grid: no scatter of one of the two kinds
        return lam(float(brentq(lambda x: self.at(lam(x)).slope, low, high, xtol=1e-13)))
