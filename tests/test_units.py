"""The table of units against pint, an independent reading of the same texts."""

from __future__ import annotations

import pint
import pytest

from solver.laws.effects import ALL
from solver.laws.outlets import OUTLETS
from solver.network.description import Fluid, Inlet, Junction, Network, Segment
from solver.quantities.quantity import quantities
from solver.quantities.units import (
    SIGNAL_UNITS,
    base_units,
    display_factor,
    display_units,
    of_signal,
    printed,
    readable,
)

PINT = pint.UnitRegistry()
OWNERS = (Network, Fluid, Segment, Junction, Inlet, *OUTLETS)
TERMS = [q for effect in ALL for q in effect.terms.values() if q.unit != "signal"]
QUANTITIES = TERMS + [q for owner in OWNERS for q in quantities(owner).values()]
UNITS = sorted({q.unit for q in QUANTITIES} | {"Pa/m", "1/Pa", "J/m", "m^2/Pa", "s^2", "Hz", "kg/(m.s^2)", "W/m^2"})


def pint_unit(text: str) -> pint.Quantity:
    return PINT.Quantity(PINT.parse_expression(text.replace(".", "*"))).to_base_units()


@pytest.mark.parametrize("unit", UNITS)
def test_pint_agrees_on_base_units(unit: str) -> None:
    """Powers of kg, m, s, and that no SI unit has a factor; for units that no table names, too."""
    text = "*".join(f"{name}**{power}" for name, power in base_units(unit).items())
    assert pint_unit(unit) == PINT.Quantity(1.0, text)


@pytest.mark.parametrize("unit", UNITS)
def test_pint_agrees_on_display_factors(unit: str) -> None:
    """display = factor · SI, of every unit that an SI unit or a quantity is read in."""
    for display in {*display_units(unit), *(q.display for q in QUANTITIES if q.unit == unit and q.display)}:
        assert base_units(display) == base_units(unit)
        assert display_factor(display) * pint_unit(display).magnitude == pytest.approx(1.0, rel=1e-15)


def test_what_people_read() -> None:
    """The usual unit, another on request, the SI unit where there is none; powers and products as printed."""
    assert [of_signal(f"CA.{signal}")[0] for signal in SIGNAL_UNITS] == ["mmHg", "mL/s", "mm"]
    assert readable("Pa", "MPa") == ("MPa", 1e-6)
    assert readable("1/Pa")[0] == "10⁻³/mmHg"
    assert readable("Pa/m") == ("Pa/m", 1.0)
    assert readable("1") == ("", 1.0)
    assert printed("m^2/(Pa.s)") == "m²/(Pa·s)"


@pytest.mark.parametrize("text", ["Pa s", "fathom", "m^", "m//s", "x.m"])
def test_what_is_no_unit(text: str) -> None:
    with pytest.raises(ValueError, match=r"not understood at .*; write it like Pa\.s"):
        base_units(text)
