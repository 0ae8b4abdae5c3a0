"""Find where simulation and record disagree: z of every channel and harmonic.

z is the residual of the mean beat's Fourier coefficient over its standard deviation, of sensors, inflow and solver
together; for a complex coefficient, |z|² is a χ² of two degrees of freedom over two. The global χ² comes first, then
the significant entries by Benjamini and Yekutieli (Ann. Stat. 29, 2001, 1165), valid for correlated entries too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from fitting.inference.fit import Array

from .. import thresholds
from ..findings.outcome import Located


@dataclass(frozen=True)
class Disagreement:
    """z : (K+1, m) of the channels. p_value : of the global χ². located : the largest significant entries."""

    z: Array
    p_value: float
    located: tuple[Located, ...]


def find(names: Sequence[str], residual: Array, covariance: Array) -> Disagreement:
    """The significant entries of a residual, measured minus simulated.

    residual : (K+1, m) complex coefficients. covariance : (K+1, m, m).
    """
    variance = np.einsum("kii->ki", covariance).real
    z = np.abs(residual) / np.sqrt(variance)
    p = np.where(np.arange(len(z))[:, None] == 0, 2.0 * ndtr(-z), np.exp(-(z**2)))
    rising, rank = np.sort(np.nan_to_num(p, nan=1.0), axis=None), np.arange(1, p.size + 1)
    passed = rising * (p.size / rank * np.sum(1.0 / rank)) <= thresholds.CHANCE
    significant = p <= np.max(rising, where=passed, initial=-1.0)
    order = np.argsort(-np.where(significant, z, -1.0), axis=None)
    located = []
    for flat in order[: thresholds.FEW]:
        k, i = (int(n) for n in np.unravel_index(int(flat), z.shape))
        if significant[k, i]:
            site, _, signal = names[i].rpartition(".")
            phase = float(np.degrees(np.angle(residual[k, i])))
            located.append(Located(site, signal, int(k), float(z[k, i]), phase))
    power = np.einsum("ki,kij,kj->k", residual.conj(), np.linalg.inv(covariance), residual).real
    total = power[0] + 2.0 * power[1:].sum()  # χ² = Σ weight x† C⁻¹ x
    p_value = float(chdtrc(residual.shape[1] * (2 * len(power) - 1), total))
    return Disagreement(z, p_value, tuple(located))
