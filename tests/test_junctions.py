"""Steady flow through a junction, where the equations can be integrated by hand."""

from __future__ import annotations

import numpy as np
import pytest

from solver import Fluid, Inlet, Junction, Network, Resistance, Segment, Settings, Site, simulate

RHO = 1060.0


@pytest.mark.parametrize("k", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("alpha", [1.0, 4.0 / 3.0])
def test_pressure_kept_at_a_junction(k: float, alpha: float) -> None:
    """P + k (ρ/2)(Q/A)² is one on all sides; without friction P + αρU²/2 is constant along a vessel: 1e-7 of P."""
    segments = (
        Segment("parent", 0.1, 9e-3, 1e-3, 6e5, 2e4),
        Segment("one", 0.1, 5e-3, 8e-4, 8e5, 2e4),
        Segment("two", 0.1, 7e-3, 8e-4, 8e5, 2e4),
    )
    sites = tuple(Site(f"{s.name}_{end}", s.name, x) for s in segments for end, x in (("start", 0.0), ("end", 1.0)))
    outlets = (Resistance("one", 4e7), Resistance("two", 2e7))
    fluid = Fluid(RHO, nu=0.0, alpha=alpha)
    junctions = (Junction(("parent",), ("one", "two"), k),)
    network = Network("steady", segments, Inlet("parent"), junctions, outlets, sites, fluid)
    settings = Settings(dt=5e-3, tolerance=1e-9)
    result = simulate(network, lambda t: 1e-4 * np.minimum(t / 0.1, 1.0), 4.0, settings=settings)

    def total(site: str, weight: float) -> float:
        P, Q, R = (result[f"{site}.{kind}"][-1] for kind in "PQR")
        return float(P + weight * RHO / 2 * (Q / (np.pi * R**2)) ** 2)

    joined = [total("parent_end", k), total("one_start", k), total("two_start", k)]
    np.testing.assert_allclose(joined, joined[0], rtol=1e-7)
    for segment in segments:
        assert total(f"{segment.name}_start", alpha) == pytest.approx(total(f"{segment.name}_end", alpha), rel=1e-7)
    assert result["one.outlet.Q"][-1] + result["two.outlet.Q"][-1] == pytest.approx(1e-4, rel=1e-7)
