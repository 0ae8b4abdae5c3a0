"""The table of units against pint, an independent reading of the same texts."""

from __future__ import annotations

from fractions import Fraction

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
    exact_factor,
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


def test_pint_agrees_on_exact_factors() -> None:
    """Every symbol with every prefix, and products, quotients and powers: pint's factor as a fraction, or none."""
    exact = pint.UnitRegistry(non_int_type=Fraction)
    symbols = ("m", "s", "min", "g", "L", "Hz", "N", "J", "W", "Pa", "mmHg")
    texts = [
        prefix + symbol
        for symbol in symbols
        for prefix in ("", *"Mkcmu")
        if prefix + symbol == "mmHg" or symbol != "mmHg"
    ]
    texts += ["kPa.s^2", "mmHg.s/mL", "mL/mmHg", "mm^2/(mmHg.s)", "cm/s.m", "L/min", "mL/min", "kg/(m.s^2)", "cm^2/s"]
    read = 0
    for text in texts:
        unit = {1: "m", 2: "m^2", 3: "m^3"}.get(dict(base_units(text)).get("m", 0), "Pa")
        for wanted in (unit, text):
            factor = exact_factor(text, wanted)
            pair = [exact.parse_units(each.replace(".", "*")) for each in (text, wanted)]
            if factor is None:
                assert pair[0].dimensionality != pair[1].dimensionality
            else:
                assert factor == exact.convert(Fraction(1), *pair), (text, wanted)
                read += 1
    assert read >= len(texts)
    assert exact_factor("10^-3/mmHg", "1/Pa") is exact_factor("inch", "s") is exact_factor("m^-1", "1/m") is None


def test_what_people_read() -> None:
    """The usual unit, another on request, the SI unit where there is none; powers and products as printed."""
    assert [of_signal(f"CA.{signal}")[0] for signal in SIGNAL_UNITS] == ["mmHg", "mL/s", "mm"]
    assert readable("Pa", "MPa") == ("MPa", 1e-6)
    assert readable("1/Pa")[0] == "10⁻³/mmHg"
    assert readable("Pa/m") == ("Pa/m", 1.0)
    assert readable("1") == ("", 1.0)
    assert printed("m^2/(Pa.s)") == "m²/(Pa·s)"


@pytest.mark.parametrize("text", ["Pa s", "fathom", "m^", "m//s", "x.m", "kmmHg"])
def test_what_is_no_unit(text: str) -> None:
    with pytest.raises(ValueError, match=r"not understood at .*; write it like Pa\.s"):
        base_units(text)
