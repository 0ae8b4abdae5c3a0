"""Units: rescaling metre, second and kilogram rescales every answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver import Network, Settings, Windkessel, simulate
from solver.quantities.quantity import quantities

# exponents of metre, second, kilogram
DIMENSIONS = {
    "m": (1, 0, 0),
    "s": (0, 1, 0),
    "Pa": (-1, -2, 1),
    "Pa.s": (-1, -1, 1),
    "Pa.s^2": (-1, 0, 1),
    "m^3/s": (3, -1, 0),
    "m^2/s": (2, -1, 0),
    "kg/m^3": (-3, 0, 1),
    "Pa.s/m^3": (-4, -1, 1),
    "m^3/Pa": (4, 2, -1),
    "1": (0, 0, 0),
}


@pytest.mark.parametrize(
    ("metre", "second", "kilogram"), [(3.0, 1.0, 1.0), (1.0, 0.3, 1.0), (1.0, 1.0, 7.0), (2.0, 3.0, 0.5)]
)
def test_rescaled_units(sheep: Network, metre: float, second: float, kilogram: float) -> None:
    """Nonlinear viscoelastic, reflections and a Windkessel, half a beat: equal to 1e-11 (2e-13)."""

    def factor(unit: str) -> float:
        a, b, c = DIMENSIONS[unit]
        return metre**a * second**b * kilogram**c

    def scaled(owner: object) -> object:
        values = {key: getattr(owner, key) * factor(q.unit) for key, q in quantities(owner).items()}
        return replace(owner, **values)  # type: ignore[type-var]

    outlets = (Windkessel("CA", 1e8, 2e-10, 1e9, P_venous=200.0), *sheep.outlets[1:])
    base = replace(sheep, outlets=outlets, P_0=100.0, viscous_law="monotone")
    base = base.with_parameters({"AA.phiNL": -2e4, "CA.ENL": 4e4})
    other = replace(
        scaled(base),
        fluid=scaled(base.fluid),
        inlet=scaled(base.inlet),
        segments=tuple(scaled(s) for s in base.segments),
        outlets=tuple(scaled(o) for o in base.outlets),
    )
    settings = Settings(dt=2e-3, tolerance=1e-8)
    one = simulate(base, duration=0.25, settings=settings)
    two = simulate(other, duration=0.25 * second, settings=Settings(2e-3 * second, 0.05 * metre, tolerance=1e-8))
    for name in one:
        size = factor(one.units[name]) * np.abs(one[name]).max()
        np.testing.assert_allclose(two[name], one[name] * factor(one.units[name]), rtol=0, atol=1e-11 * size)
