"""Balances of mass, momentum and wall law where the measured channels determine them, in units of their noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fitting.inference.fit import Array
from fitting.inference.models.bench import bench
from fitting.inference.models.bench_network import on_bench
from fitting.records.alignment.beats import Beats
from solver.network.description import Network
from solver.quantities.units import INFLOW

from ..findings.outcome import Balance


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
