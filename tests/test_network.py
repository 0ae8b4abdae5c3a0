"""The description of a network: what is allowed, what every error says, and the round trips."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from random_networks import networks

from solver.laws.outlets import Pressure, Reflection, Resistance, Windkessel
from solver.network.description import (
    Fluid,
    Inlet,
    Junction,
    Network,
    Quantity,
    Segment,
    Site,
    check_parameters,
    from_dict,
    quantities,
    to_dict,
)
from solver.network.doubts import network_doubts

AA = Segment("AA", L=0.04, R0=9.48e-3, h=3.8e-4, E=1.539e6, phi0=25451.0)
BT = replace(AA, name="BT", phi0=0.0)
PD = replace(AA, name="PD", L=0.1)
X, Y = replace(AA, name="X"), replace(AA, name="Y")


def fork(**changes: Any) -> Network:
    """AA -> BT + PD, with a Windkessel at BT and a reflection at PD."""
    parts: dict[str, Any] = {
        "name": "fork",
        "segments": (AA, BT, PD),
        "inlet": Inlet("AA"),
        "junctions": (Junction(("AA",), ("BT", "PD")),),
        "outlets": (Windkessel("BT", R1=1e8, C=1e-9, R2=1e9), Reflection("PD", R_t=0.3)),
        "sites": (Site("root", "AA"),),
    }
    return Network(**{**parts, **changes})


def with_segment(**changes: Any) -> dict[str, Any]:
    return {"segments": (replace(AA, **changes), BT, PD)}


def with_outlets(*outlets: Any) -> dict[str, Any]:
    return {"outlets": (*outlets, Reflection("PD", R_t=0.3))}


FORK = fork().junctions

# what is changed in the fork -> the words that the sentence must contain: thing, quantity, value, range, remedy
BAD_NETWORKS = {
    "negative length": (with_segment(L=-0.04), ["AA.L = -0.04 m", "length L", "[0.0001, 10] m", "check the value"]),
    "zero radius": (with_segment(R0=0.0), ["AA.R0 = 0 m", "radius R0", "[1e-05, 0.2] m"]),
    "NaN modulus": (with_segment(E=math.nan), ["AA.E = nan Pa", "Young's modulus E", "[100, 1e+10] Pa"]),
    "infinite thickness": (with_segment(h=math.inf), ["AA.h = inf m", "wall thickness h", "[1e-06, 0.1] m"]),
    "negative viscosity": (with_segment(phi0=-1.0), ["AA.phi0 = -1 Pa.s", "wall viscosity phi0", "[0, 1e+08]"]),
    "text as number": (with_segment(E="1 MPa"), ["AA.E = '1 MPa'", "must be a number in Pa"]),
    "bool as number": (with_segment(E=True), ["AA.E = True", "must be a number in Pa"]),
    "text without unit": ({"eta": "half"}, ["network.eta = 'half': must be a number."]),
    "None as number": (with_segment(E=None), ["AA.E = None", "must be a number in Pa"]),
    "phiNL without phi0": (
        with_segment(phi0=0.0, phiNL=-1.0),
        ["AA.phiNL", "AA.phi0 = 0", "phiNL/phi0 must lie in [-100, 100] s", "set AA"],
    ),
    "negative density": ({"fluid": Fluid(rho=-1060.0)}, ["fluid.rho = -1060 kg/m^3", "blood density", "[1, 100000]"]),
    "Poisson's ratio": ({"eta": 0.6}, ["network.eta = 0.6 (no unit)", "Poisson's ratio", "[0, 0.5]"]),
    "period": ({"inlet": Inlet("AA", T=0.0)}, ["inlet.T = 0 s", "period T", "[0.001, 100] s"]),
    "position": ({"sites": (Site("root", "AA", 1.5),)}, ["site root.position = 1.5", "position x/L", "[0, 1]"]),
    "junction k": ({"junctions": (replace(FORK[0], k=2.0),)}, ["junction AA.k = 2", "[0, 1]"]),
    "R_t below -1": (with_outlets(Reflection("BT", R_t=-1.0)), ["BT.outlet.R_t = -1", "reflection", "[-0.999, 1]"]),
    "compliance": (with_outlets(Windkessel("BT", R1=1e8, C=0.0, R2=1e9)), ["BT.outlet.C = 0 m^3/Pa", "compliance C"]),
    "resistance": (with_outlets(Resistance("BT", R=-1.0)), ["BT.outlet.R = -1 Pa.s/m^3", "resistance R"]),
    "elastic law": ({"elastic_law": "betta"}, ["elastic_law = 'betta'", "must be one of beta, regression"]),
    "viscous law": ({"viscous_law": "none"}, ["viscous_law = 'none'", "must be one of quadratic, monotone"]),
    "no segments": ({"segments": ()}, ["network fork", "no segments", "give at least one"]),
    "network name": ({"name": "my network"}, ["network name 'my network'", "letters, digits and _", "rename"]),
    "segment name": (with_segment(name="A.A"), ["segment name 'A.A'", "must start with a letter", "rename"]),
    "reserved name": (with_segment(name="time"), ["segment name 'time' is reserved", "rename it"]),
    "segment twice": ({"segments": (AA, BT, PD, PD)}, ["segment PD", "occurs 2 times", "must be unique"]),
    "site twice": ({"sites": (Site("s", "AA"), Site("s", "PD"))}, ["site s", "occurs 2 times", "must be unique"]),
    "unknown in junction": (
        {"junctions": (Junction(("AA",), ("BT", "PT")),)},
        ["junction AA", "no segment 'PT'", "did you mean", "PD"],
    ),
    "unknown in outlet": (
        with_outlets(Reflection("BTT", R_t=0.3)),
        ["outlet BTT", "no segment 'BTT'", "did you mean BT"],
    ),
    "unknown in site": ({"sites": (Site("root", "Aa"),)}, ["site root", "no segment 'Aa'", "did you mean AA"]),
    "unknown in inlet": ({"inlet": Inlet("AAA")}, ["inlet", "no segment 'AAA'", "did you mean AA"]),
    "two roots": (
        {"segments": (AA, BT, PD, X), "outlets": (*fork().outlets, Reflection("X", R_t=0.3))},
        ["segment X", "upstream end is not joined", "second root beside AA", "let a junction flow into it"],
    ),
    "two flow into the inlet": (
        {"segments": (AA, BT, PD, X), "junctions": (*FORK, Junction(("X",), ("AA",)))},
        ["segment X", "second root beside AA"],
    ),
    "unreachable": (
        {"segments": (AA, BT, PD, X, Y), "junctions": (*FORK, Junction(("X",), ("Y",)), Junction(("Y",), ("X",)))},
        ["segment X", "cannot be reached from the inlet of AA", "join it with a junction or remove it"],
    ),
    "no outlet": (
        {"outlets": (Reflection("PD", R_t=0.3),)},
        ["segment BT", "downstream end has neither junction nor outlet", "R_t = 0"],
    ),
    "outlet with two conditions": (
        with_outlets(Reflection("BT", R_t=0.3), Resistance("BT", R=1e9)),
        ["segment BT", "downstream end is joined twice", "an outlet condition and an outlet condition", "keep one"],
    ),
    "outlet at a junction": (
        {"outlets": (*fork().outlets, Reflection("AA", R_t=0.3))},
        ["segment AA", "joined twice", "junction AA and an outlet condition", "keep one"],
    ),
    "loop into the inlet": (
        {"junctions": (*FORK, Junction(("BT",), ("AA",))), "outlets": (Reflection("PD", R_t=0.3),)},
        ["segment AA", "upstream end is joined twice", "the inlet and junction BT", "keep one"],
    ),
    "junction without outflow": (
        {"junctions": (*FORK, Junction(("BT",), ()))},
        ["junction of BT", "it has no partner", "one that flows out"],
    ),
    "junction without inflow": (
        {"junctions": (Junction((), ("BT", "PD")),)},
        ["junction of BT, PD", "it has no partner", "at least one segment that flows in"],
    ),
}


@pytest.mark.parametrize("case", BAD_NETWORKS)
def test_error_says_what_where_and_what_to_do(case: str) -> None:
    """A network that is not allowed raises ValueError with one sentence of thing, quantity, value, range, remedy."""
    changes, words = BAD_NETWORKS[case]
    with pytest.raises(ValueError) as error:
        fork(**changes)
    sentence = str(error.value)
    assert [word for word in words if word not in sentence] == []
    assert sentence.endswith((".", "?")) and "\n" not in sentence


def test_range_ends() -> None:
    """Both ends of a range are allowed, the lower one unless it is open."""
    closed = Quantity("m", "length", 1.0, 2.0)
    closed.check("x", 1.0)
    closed.check("x", 2)
    closed.check("x", np.float64(2.0))
    with pytest.raises(ValueError, match=r"x = 1 m is not allowed: length must lie in \(1, 2\] m"):
        Quantity("m", "length", 1.0, 2.0, open_low=True).check("x", 1.0)


def test_of_a_batch_the_first_number_that_is_not_allowed_is_named() -> None:
    """The first by name, whatever the lengths of the arrays; ends of ranges are allowed."""
    fine = {"AA.phi0": np.zeros(3), "fluid.friction": 0.0, "network.eta": np.array([0.0, 0.25, 0.5])}
    check_parameters(fork(), fine)
    bad = {"BT.E": np.array([1e6, -1.0, -2.0]), "AA.E": -3.0, "PD.E": np.full(3, np.nan), "AA.L": np.array([np.inf])}
    for names, words in ((list(bad), "BT.E = -1 "), (["AA.E", "BT.E"], "AA.E = -3 "), (["PD.E"], "PD.E = nan "),
                         (["AA.L"], "AA.L = inf ")):  # fmt: skip
        with pytest.raises(ValueError, match=f"^{words}"):
            check_parameters(fork(), fine | {name: bad[name] for name in names})


def test_defaults_lie_in_their_ranges() -> None:
    """Every default value passes its own check."""
    for kind in (Fluid, Segment, Junction, Site, Inlet, Network, Reflection, Windkessel, Resistance, Pressure):
        for key, q in quantities(kind).items():
            if hasattr(kind, key):  # fields without default are not class attributes
                q.check(f"{kind.__name__}.{key}", getattr(kind, key))


def test_parameters_by_name() -> None:
    """The names are the FMU's: network, fluid, one group per segment, one per outlet; each has a quantity."""
    network = fork()
    values = network.parameters()
    assert values["AA.E"] == 1.539e6
    assert values["BT.outlet.C"] == 1e-9
    assert values["fluid.rho"] == 1060.0
    assert values["network.P_ref"] == 0.0
    assert values.keys() == network.parameter_quantities().keys()
    assert network.parameter_quantities()["BT.outlet.C"].unit == "m^3/Pa"


def test_with_parameters_changes_only_those_named() -> None:
    """with_parameters({}) is the same network; one value per owner changes that value and no other."""
    network = fork()
    assert network.with_parameters({}) == network
    changes = {"AA.E": 2e6, "PD.outlet.R_t": 0.5, "fluid.nu": 0.0, "network.P_ref": 1e4}
    assert network.with_parameters(changes).parameters() == {**network.parameters(), **changes}
    assert network == fork()  # the original is as before


BAD_PARAMETERS = {
    "unknown": ({"AA.EE": 1e6}, ["AA.EE", "not a parameter of network fork", "did you mean AA.E"]),
    "unknown segment": ({"AB.E": 1e6}, ["AB.E", "not a parameter", "did you mean"]),
    "negative": ({"AA.E": -1.0}, ["AA.E = -1 Pa", "[100, 1e+10] Pa"]),
    "NaN": ({"CA.E": 1e6, "AA.E": math.nan}, ["CA.E", "not a parameter"]),
    "text": ({"AA.E": "stiff"}, ["AA.E = 'stiff'", "must be a number in Pa"]),
    "bool": ({"AA.E": True}, ["AA.E = True", "must be a number in Pa"]),
    "phiNL without phi0": ({"BT.phiNL": -1.0}, ["BT.phiNL = -1 Pa.s^2 is too large for BT", "raise BT.phi0"]),
    "phi0 taken away": ({"AA.phiNL": -1.0, "AA.phi0": 0.0}, ["AA.phiNL = -1", "AA.phi0 = 0 Pa.s"]),
    "one of a batch": ({"AA.E": np.array([1e6, -1.0, 2e6])}, ["AA.E = -1 Pa", "[100, 1e+10] Pa"]),
}


@pytest.mark.parametrize("case", BAD_PARAMETERS)
def test_parameters_that_are_not_allowed(case: str) -> None:
    """An unknown name or a value outside the range raises ValueError, for scalars and for batches."""
    values, words = BAD_PARAMETERS[case]
    with pytest.raises(ValueError) as error:
        check_parameters(fork(), values)
    assert [word for word in words if word not in str(error.value)] == []
    with pytest.raises(ValueError, match="."):
        fork().with_parameters(values)


def test_inflow_is_the_half_sine() -> None:
    """Q(t) = Q_max max(0, sin 2πt/T): peak at T/4, none in the second half, to round-off (1e-15 Q_max).

    After 1000 beats the error is that of the time itself: 2π·ulp(500)/T = 7e-13 Q_max.
    """
    inlet = Inlet("AA", Q_max=55e-6, T=0.5)
    t = np.array([0.0, 0.1, 0.125, 0.25, 0.3, 0.375])
    exact = 55e-6 * np.array([0.0, math.sin(0.4 * math.pi), 1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(inlet.Q(t), exact, rtol=0.0, atol=1e-15 * 55e-6)
    np.testing.assert_allclose(inlet.Q(t + 500.0), exact, rtol=0.0, atol=1e-12 * 55e-6)


@given(networks())
def test_plain_data_round_trip_is_exact(network: Network) -> None:
    """from_dict(to_dict(n)), also through JSON, is n bit for bit (repr tells -0.0 from 0.0)."""
    assert from_dict(to_dict(network)) == network
    again = from_dict(json.loads(json.dumps(to_dict(network))))
    assert again == network and repr(again) == repr(network)


def test_a_thick_wall_is_doubtful() -> None:
    """h/R0 up to 0.2 is a thin wall; beyond, one sentence names the thickest segment, and by Lamé how much more it
    yields: displacements at the inner radius a of p a (3/2) b²/(b² - a²)/E and, of a thin wall, p a (3/4) (a/h)/E."""
    thin = replace(PD, h=0.2 * PD.R0)
    assert network_doubts(fork()) == network_doubts(fork(segments=(AA, BT, thin))) == ()
    a, b = PD.R0, 1.3 * PD.R0
    more = (1.5 * b**2 / (b**2 - a**2)) / (0.75 * a / (b - a)) - 1.0
    (said,) = network_doubts(fork(segments=(replace(AA, h=0.25 * AA.R0), BT, replace(PD, h=b - a))))
    assert said.startswith("segment PD (and 1 more): h/R0 = 0.3, ") and f"would yield {more:.0%} more" in said
