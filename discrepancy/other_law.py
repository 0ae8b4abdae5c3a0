"""Whether the other elastic law explains the record of a bench by itself.

A law that is not the wall's leaves a misfit that effects can take up in part: with P and R of a soft carotid of the
β-law, the regression law lacks a bend of its elasticity. Effects are asked under the file's law alone.
"""

from __future__ import annotations

from scipy.stats import chi2

from fitting.elastic_law import MISFIT
from fitting.records.beats import Beats
from fitting.wall import fit
from solver.errors import InputError
from solver.network import Network


def other_law(beats: Beats, network: Network, site: str) -> tuple[str, ...]:
    """A sentence where a wall of another law than the file's describes P and R of a site within their noise, and its
    evidence is decided (:mod:`fitting.weighing`); none otherwise.

    benchmarks/elastic_laws.py counts how often the wrong law is decided: in 1 of 1600 recordings.
    """
    name = next((s.segment for s in network.sites if s.name == site), site)
    try:
        found = fit(beats, site, network.segment(name).h, eta=network.eta)
    except InputError:  # no wall of either law
        return ()
    law, own = found.model.elastic, network.elastic_law
    weights = found.evidence
    if law == own or weights is None or not weights.decided:
        return ()
    if chi2.sf(found.chi2, found.dof) < MISFIT:
        return ()
    return (
        f"{site}: the file's elastic law is {own}, but a wall of the {law} law explains P and R within their noise by "
        f"itself ({found.law}): what is named may only stand for the law; set "
        f'elastic_law = "{law}" in the file, fit its wall anew, and compare.',
    )
