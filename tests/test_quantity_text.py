"""Units of numbers in files: read into SI, exactly; what is no quantity is refused."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from network_text import FORK

from solver.laws.outlets import Reflection, Windkessel
from solver.network.files import loads, parse_quantity

MMHG = Fraction("133.322387415")  # pint's mmHg: 13.5951 g/cm³ times 9.80665 m/s²


def test_units_are_read_into_si() -> None:
    """Each value is the double nearest to its exact SI value; bare numbers are SI; absent keys keep their defaults."""
    n = loads(FORK, "fork.toml")
    aa, bt, pd = n.segments
    assert (aa.L, aa.R0, aa.h, aa.E, aa.phi0) == (0.04, 0.00948, 0.00038, 1539000.0, 25451.0)
    assert (bt.L, bt.R0, bt.E, bt.phi0) == (0.04, 0.009, 683000.0, 0.0)
    assert (pd.R0, pd.E) == (0.0088, 842000.0)
    assert (n.fluid.rho, n.fluid.nu, n.inlet.Q_max, n.inlet.T) == (1060.0, 3.5e-6, 55e-6, 0.5)
    windkessel, reflection = n.outlets
    assert isinstance(windkessel, Windkessel) and isinstance(reflection, Reflection)
    assert windkessel.R1 == float(MMHG * 10**6)
    assert windkessel.C == float(Fraction("0.1e-6") / MMHG)
    assert windkessel.R2 == float(10 * MMHG * 10**6)
    assert reflection.R_t == 0.3


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("4 cm", "m", 0.04),
        ("4cm", "m", 0.04),
        (" .38 mm ", "m", 0.00038),
        ("-1e-3 km", "m", -1.0),
        ("100 µm", "m", 1e-4),
        ("0.04", "m", 0.04),
        (0.04, "m", 0.04),
        (4, "m", 4.0),
        ("25.451 kPa*s", "Pa.s", 25451.0),
        ("25.451 kPa.s", "Pa.s", 25451.0),
        ("25.451 kPa·s", "Pa.s", 25451.0),
        ("25.451 kPa s", "Pa.s", 25451.0),
        ("-23.287665 kPa*s^2", "Pa.s^2", -23287.665),
        ("3.3 L/min", "m^3/s", 5.5e-5),
        ("55 cm³/s", "m^3/s", 5.5e-5),
        ("1 mmHg/(mL/s)", "Pa.s/m^3", 133322387.415),
        ("120 mmHg", "Pa", 15998.6864898),
        ("500 ms", "s", 0.5),
        ("30 %", "1", 0.3),
        ("0.3", "1", 0.3),
    ],
)
def test_parse_quantity(text: str | float, unit: str, value: float) -> None:
    """The result is the double nearest to the decimal SI value: exact equality."""
    assert parse_quantity(text, unit, "x") == value


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("4 kPa", ['x = "4 kPa"', "the unit kPa does not convert", "expected m", "correct the unit"]),
        ("0 kPa", ['x = "0 kPa"', "the unit kPa does not convert"]),
        ("4 cn", ['x = "4 cn"', "the unit cn is not known", "expected m"]),
        ("4 cm)", ["the unit cm) is not known"]),
        ("4 5 cm", ["the unit 5 cm is not known"]),
        ("4 m**9**9**9**9", ["the unit m**9**9**9**9 is not known"]),  # exact arithmetic would never end
        ("4 ((99**99)**99)*m", ["the unit ((99**99)**99)*m is not known"]),
        ("4 m*9**(9*9**9)", ["the unit m*9**(9*9**9) is not known"]),
        ("4,5 cm", ["the unit ,5 cm is not known"]),
        ("4 m^0", ["the unit m^0 is not known"]),
        ("cm", ['x = "cm"', "must be a number in m", "with a unit in quotes"]),
        ("", ['x = ""', "must be a number in m"]),
        (None, ["x = null", "must be a number in m"]),
        (True, ["x = true", "must be a number in m"]),
        ([0.04], ["x = [0.04]", "must be a number in m"]),
        ("nan", ['x = "nan"', "finite", "check the value"]),
        ("-inf cm", ['x = "-inf cm"', "finite"]),
        (float("nan"), ["x = NaN", "finite"]),
        ("1e400 m", ["finite"]),
        ("1e308 km", ["finite"]),
        (10**400, ["finite"]),
    ],
)
def test_quantities_that_are_not(value: object, words: list[str]) -> None:
    """What is not a finite length raises ValueError with name, value, expected unit and remedy."""
    with pytest.raises(ValueError) as error:
        parse_quantity(value, "m", "x")  # type: ignore[arg-type]
    assert [word for word in words if word not in str(error.value)] == []


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("600 rpm", "Hz", "the unit rpm does not convert to the expected Hz"),  # pint: 62.8 Hz
        ("63 rad/s", "Hz", "the unit rad/s does not convert to the expected Hz"),
        ("30 deg", "1", "the unit deg does not convert to the expected number without unit"),
        ("3 dB", "1", "the unit dB is not known"),
        ("0 dB", "1", "the unit dB is not known"),
    ],
)
def test_angles_and_levels_are_no_numbers(text: str, unit: str, words: str) -> None:
    """An angular frequency is no frequency without its factor of 2 pi, and a level has no factor."""
    with pytest.raises(ValueError, match=words):
        parse_quantity(text, unit, "x")


@given(st.text("0123456789 .e+-cmkPasL/*^()[]%·{\"'=\n", max_size=12))
def test_parse_quantity_gives_a_float_or_value_error(text: str) -> None:
    """No text whatever makes the parser of numbers or units raise anything but a sentence about x."""
    try:
        assert isinstance(parse_quantity(text, "m", "x"), float)
    except ValueError as error:
        assert str(error).startswith("x = ")
