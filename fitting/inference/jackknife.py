"""The change of estimates without a part of the data: the effect of errors that are correlated over many data.

Also the prediction of a site from the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.linalg import solve_triangular

from ..records.channels.noise import Target
from .fit import Array, Fit
from .gauss_newton import linear_step
from .unknown import precision

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


def _within(whole: Target, fit: Fit, chosen: Array) -> Rest:
    """The linear problem of a fit in some channels, ``chosen`` : (m,) bool, whitened by their own covariance."""
    white = subset(whole, np.flatnonzero(chosen))(np.column_stack([fit.J, fit.z]))
    return white[:, :-1], white[:, -1]


def without_each_site(whole: Target, fit: Fit) -> list[Rest]:
    """The linear problem of a fit without one site, each in turn; sites whose sensor is a term of the fit stay, because
    the others do not determine it."""
    return [_within(whole, fit, ~there) for there in _sites(whole, fit).values()]


def _sites(whole: Target, fit: Fit) -> dict[str, Array]:
    """(m,) True for the channels at each site, without the sites that a sensor of the fit is at."""
    names = np.array([name.rpartition(".")[0] for name in whole.names])
    faulty = {term.place.rpartition(".")[0] for term in fit.terms if term.is_sensor}
    return {site: names == site for site in dict.fromkeys(names.tolist()) if site not in faulty}


def leave_one_site_out(whole: Target, fit: Fit) -> dict[str, float]:
    """Whitened RMS of each site, predicted from the others: the hypothesis refitted without it, linearised at its fit.

    None for a single site; the measurement chain of a site cannot be predicted from others.
    """
    found = {}
    for site, there in _sites(whole, fit).items():
        if there.all() or not len(fit.x):
            continue
        (J, z), (there_J, there_z) = (_within(whole, fit, chosen) for chosen in (~there, there))
        residual = there_z + there_J @ linear_step(fit, J, z)
        # the uncertainty of the unknowns, estimated from the others, adds to the covariance
        spread = np.linalg.pinv(J.T @ J + np.diag(precision(fit.prior, fit.x)), hermitian=True)
        V = np.eye(len(residual)) + there_J @ spread @ there_J.T
        found[site] = float(np.sqrt(residual @ np.linalg.solve(V, residual) / len(residual)))
    return found
