"""How far estimates move when a part of the data is left out: what an error that is alike in many data does to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import solve_triangular

from .fit import Fit
from .gauss_newton import bounded_step
from .unknown import bounds

Array = np.ndarray

Rest = tuple[Array, Array]  # (J, z) of what stays, whitened by its own covariance


def jackknife(fit: Fit, without: Sequence[Rest]) -> Array:
    """(p,) standard deviations √((m - 1)/m Σ_g (x_g - x̄)²) of the unknowns, each x_g without one of m parts of data.

    The problem is linear about the fit. An error of the model is seldom independent from harmonic to harmonic, as its
    covariance takes it to be; then this is larger than what the covariance says.
    B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans (SIAM 1982).
    """
    low, high = bounds(fit.unknowns)
    steps = np.array([bounded_step(J, z, fit.prior, fit.x, low, high) for J, z in without])
    m = len(steps)
    return np.sqrt((m - 1.0) / m * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0))


def without_groups(fit: Fit, group: Array, L: Array) -> list[Rest]:
    """The linear problem of a fit without each group of data d = L z, the others whitened anew.

    group : (n,) of every entry of d. L : (n, n) lower, L Lᵀ the covariance of d.
    """
    d, C, found = L @ np.column_stack([fit.z, fit.J]), L @ L.T, []
    for g in np.unique(group):
        kept = group != g
        white = solve_triangular(np.linalg.cholesky(C[np.ix_(kept, kept)]), d[kept], lower=True)
        found.append((white[:, 1:], white[:, 0]))
    return found
