"""The change of estimates without a part of the data: the effect of errors that are correlated over many data."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import solve_triangular

from ..records.channels.noise import Target
from .fit import Fit
from .gauss_newton import linear_step

Array = np.ndarray

Rest = tuple[Array, Array]  # (J, z) of what stays, whitened by its own covariance


def jackknife(fit: Fit, without: Sequence[Rest]) -> Array:
    """(p,) standard deviations √((m - 1)/m Σ_g (x_g - x̄)²) of the unknowns, each x_g without one of m parts of data.

    The problem is linear about the fit. The covariance assumes that model errors of harmonics are independent; they
    seldom are, and then these standard deviations are larger than those of the covariance.
    B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans (SIAM 1982).
    """
    steps = np.array([linear_step(fit, J, z) for J, z in without])
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


# --- channels and sites of a network record --------------------------------------------------------------------------


def subset(whole: Target, keep: Array) -> Callable[[Array], Array]:
    """Turns whitened columns (n, q) of all channels into those of some: back to coefficients, chosen, whitened anew.

    keep : indices of the channels.
    """
    part = Target.of([whole.names[i] for i in keep], whole.X[:, keep], whole.covariance[:, keep[:, None], keep])
    return lambda columns: part.whiten(whole.unwhiten(columns)[:, keep])


def without_each_site(whole: Target, fit: Fit) -> list[Rest]:
    """The linear problem of a fit without one site, each in turn; sites whose sensor is a term of the fit stay, because
    the others do not determine it."""
    sites = np.array([name.rpartition(".")[0] for name in whole.names])
    faulty = {term.place.rpartition(".")[0] for term in fit.terms if term.is_sensor}
    found = []
    for site in dict.fromkeys(sites.tolist()):
        if site not in faulty:
            white = subset(whole, np.flatnonzero(sites != site))(np.column_stack([fit.J, fit.z]))
            found.append((white[:, :-1], white[:, -1]))
    return found
