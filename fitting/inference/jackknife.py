"""How far estimates move when a part of the data is left out: what an error that is alike in many data does to them."""

from __future__ import annotations

import numpy as np

from .fit import Fit
from .search import bounded_step
from .unknown import bounds

Array = np.ndarray


def jackknife(fit: Fit, group: Array) -> Array:
    """(p,) standard deviations √((m - 1)/m Σ_g (x_g - x̄)²) of the unknowns, each x_g without one of m groups of data.

    group : (n,) of every entry of z. The problem is linear about the fit. An error of the model is seldom independent
    from harmonic to harmonic, as its covariance takes it to be; then this is larger than what the covariance says.
    B. Efron, The Jackknife, the Bootstrap and Other Resampling Plans (SIAM 1982).
    """
    found, (low, high) = [], bounds(fit.unknowns)
    for g in np.unique(group):
        kept = group != g
        found.append(bounded_step(fit.J[kept], fit.z[kept], fit.prior, fit.x, low, high))
    steps, m = np.array(found), len(found)
    return np.sqrt((m - 1.0) / m * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0))
