"""The part of a network record that some of its channels hold."""

from __future__ import annotations

import numpy as np

from .fits import Fit, bounded_step, bounds, precision
from .network import NetworkProblem

Array = np.ndarray


class Subset:
    """Turns whitened columns (n, q) of all channels into those of some: back to coefficients, chosen, whitened anew.

    keep : indices of the channels.
    """

    def __init__(self, problem: NetworkProblem, keep: Array) -> None:
        self.m, self.K, self.keep = len(problem.names), problem.K, keep
        self.back = np.linalg.inv(problem.target.whitener)
        C = problem.target.covariance[:, keep[:, None], keep]
        scale = np.sqrt(np.einsum("kii->ki", C).real)
        factor = np.linalg.cholesky(C / (scale[:, :, None] * scale[:, None, :]))
        self.white = np.linalg.inv(factor) / scale[:, None, :]

    def __call__(self, z: Array) -> Array:
        mean, rest = z[: self.m], z[self.m :].reshape(2, self.K, self.m, -1) / np.sqrt(2.0)
        whole = np.concatenate([mean[None] + 0j, rest[0] + 1j * rest[1]])
        part = self.white @ (self.back @ whole)[:, self.keep]
        parts = [part[:1].real, np.sqrt(2.0) * part[1:].real, np.sqrt(2.0) * part[1:].imag]
        return np.concatenate([p.reshape(-1, z.shape[1]) for p in parts])


def leave_one_site_out(problem: NetworkProblem, fit: Fit) -> dict[str, float]:
    """Whitened RMS of each site as the others foretell it: a hypothesis refitted without it, linearised where it is.

    Sites that are the only ones are left out; a measurement chain at a site is not foretold by others.
    """
    sites = list(dict.fromkeys(name.rpartition(".")[0] for name in problem.names))
    faulty = {term.place.rpartition(".")[0] for term in fit.terms if term.is_sensor}
    if len(sites) < 2 or not len(fit.x):
        return {}
    low, high = bounds(fit.unknowns)
    found = {}
    for site in sites:
        there = np.array([name.rpartition(".")[0] == site for name in problem.names])
        if site in faulty:
            continue
        others, own = (Subset(problem, np.flatnonzero(chosen)) for chosen in (~there, there))
        J, there_J = others(fit.J), own(fit.J)
        step = bounded_step(J, others(fit.z[:, None])[:, 0], fit.prior, fit.x, low, high)
        left = own(fit.z[:, None])[:, 0] + there_J @ step
        # what the others know of the unknowns is uncertain, too
        spread = np.linalg.pinv(J.T @ J + np.diag(precision(fit.prior, fit.x)), hermitian=True)
        V = np.eye(len(left)) + there_J @ spread @ there_J.T
        found[site] = float(np.sqrt(left @ np.linalg.solve(V, left) / len(left)))
    return found
