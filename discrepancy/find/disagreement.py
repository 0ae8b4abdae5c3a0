"""Find where simulation and record disagree: z of every channel and harmonic, and balances of mass, momentum and wall
law where the measured channels determine them, in units of their noise.

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
from fitting.inference.models.bench import bench
from fitting.inference.models.bench_network import on_bench
from fitting.records.alignment.beats import Beats
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .. import thresholds
from ..findings.outcome import Balance, Located


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


# --- balances ---------------------------------------------------------------------------------------------------------


def mass_balances(beats: Beats, network: Network) -> tuple[Balance, ...]:
    """Mean inflow minus mean outflow between measured sites, from the record alone, in noise units.

    One for every junction with a measured flow in all its vessels, and one between inlet and its segment.
    """
    flows = {site.segment: f"{site.name}.Q" for site in network.sites if f"{site.name}.Q" in beats.values}
    root, joined = network.inlet.segment, []
    if INFLOW in beats.values and root in flows:
        joined.append((root, [INFLOW], [flows[root]]))
    for junction in network.junctions:
        if all(s in flows for s in (*junction.inflow, *junction.outflow)):
            into, out = [flows[s] for s in junction.inflow], [flows[s] for s in junction.outflow]
            joined.append((f"junction {junction.name}", into, out))
    found = []
    for where, into, out in joined:
        names, sign = (*into, *out), np.repeat([1.0, -1.0], [len(into), len(out)])
        difference = sign @ np.array([beats.mean(name).mean() for name in names])
        variance = sign @ beats.covariance(names)[0].real @ sign
        found.append(Balance("mass", where, float(difference / np.sqrt(max(variance, 1e-300)))))
    return tuple(found)


def momentum_balances(
    names: Sequence[str], residual: Array, covariance: Array, network: Network
) -> tuple[Balance, ...]:
    """Pressure drops between neighbouring measured sites against the simulated ones: RMS over harmonics / noise.

    residual : (K+1, m) measured minus simulated coefficients. covariance : (K+1, m, m).
    """
    at = {site.segment: names.index(f"{site.name}.P") for site in network.sites if f"{site.name}.P" in names}
    found = []
    for junction in network.junctions:
        for a in (s for s in junction.inflow if s in at):
            for b in (s for s in junction.outflow if s in at):
                sign = np.zeros(len(names))
                sign[[at[a], at[b]]] = 1.0, -1.0
                variance = np.einsum("i,kij,j->k", sign, covariance, sign).real
                z = np.sqrt(np.mean(np.abs(residual @ sign) ** 2 / np.maximum(variance, 1e-300)))
                found.append(Balance("momentum", f"{a} to {b}", float(z)))
    return tuple(found)


def wall_balances(beats: Beats, network: Network) -> tuple[Balance, ...]:
    """The wall law at every site with P and R, with E, phi0 and R0 refitted: RMS of its residual over its noise."""
    found = []
    for site in network.sites:
        if {f"{site.name}.P", f"{site.name}.R"} <= set(beats.values):
            (local,) = bench(beats, on_bench(network, site.name, segment=site.segment), site.name).refit([()])
            if local is not None:  # a wall of this kind fits the loop
                found.append(Balance("wall law", site.name, float(np.sqrt(np.mean(local.z**2)))))
    return tuple(found)
