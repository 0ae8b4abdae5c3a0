"""What a network file may say in a paper's own numbers: values at both ends, areas, beta, C_v, mu, a profile."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest
from network_text import FORK

from solver import Settings, Windkessel, simulate
from solver.laws import outlets
from solver.laws.outlets import Resistance
from solver.network.coefficients import coefficients
from solver.network.description import Network, from_dict, to_dict
from solver.network.files import dumps, loads
from solver.quantities.quantity import quantity

AA = FORK[FORK.index("[segments.AA]") : FORK.index("[segments.BT]")]


def fork(segment: str = AA, **more: str) -> Network:
    """The fork with another section of AA, and other texts in place of some."""
    text = FORK.replace(AA, segment + "\n\n")
    for old, new in more.values():
        assert old in text
        text = text.replace(old, new)
    return loads(text, "fork.toml")


TAPERED = '[segments.AA]\nL = "4 cm"\nR0 = ["12 mm", "8 mm"]\nh = ["1 mm", "0.9 mm"]\nE = [4e5, "0.6 MPa"]\n'


def test_values_at_both_ends() -> None:
    """R0(x), h(x) and E(x) are straight between the ends; K = E h/((1 - η²) R0) and K_h = h/((1 - η²) R0) follow.

    Expected: round-off.
    """
    network = fork(TAPERED)
    x = np.linspace(0.0, 1.0, 5)
    wall = coefficients(network).wall_at(np.zeros(5, int), x)
    R0, h, E = 12e-3 - 4e-3 * x, 1e-3 - 1e-4 * x, 4e5 + 2e5 * x
    np.testing.assert_allclose(wall.A0[0], np.pi * R0**2, rtol=1e-14)
    np.testing.assert_allclose(wall.K[0], E * h / 0.75 / R0, rtol=1e-14)
    np.testing.assert_allclose(wall.K_h[0], h / 0.75 / R0, rtol=1e-14)
    assert loads(dumps(network), "again.toml") == network
    assert from_dict(json.loads(json.dumps(to_dict(network)))) == network


def test_a_tapered_wall_rests() -> None:
    """At rest under a uniform pressure other than P_ref nothing moves, whatever tapers: |Q| <= 1e-13 m³/s of 5e-5."""
    ends = "[outlets.BT]\nP_venous = 9e3\n[outlets.PD]\nP_venous = 9e3\n[network]\nP_0 = 9e3\nP_ref = 2e3\n"
    text = FORK[: FORK.index("[outlets.BT]")].replace(AA, TAPERED + "\n") + ends
    text = text.replace("Q_max = ", "Q_max = 0.0 #")
    result = simulate(loads(text, "fork.toml"), duration=0.05, settings=Settings(dt=5e-3))
    assert max(np.abs(result[name]).max() for name in result if name.endswith(".Q")) < 1e-13


def test_areas_beta_and_C_v() -> None:
    """A0 = π R0², β = √π E h/((1-η²) A0), C_v = √π φ0 h/(2 (1-η²) √A0 ρ): back to what they were made of, to 1e-14."""
    old, rho = fork().segment("AA"), 1060.0
    A0 = np.pi * old.R0**2
    beta = np.sqrt(np.pi) * old.E * old.h / (0.75 * A0)
    C_v = np.sqrt(np.pi) * old.phi0 * old.h / (2.0 * 0.75 * np.sqrt(A0) * rho)
    text = f'[segments.AA]\nL = 0.04\nh = {old.h}\nA0 = "{A0 * 1e4:.17g} cm^2"\n'
    text += f'beta = "{beta * 1e-2:.17g} Pa/cm"\nC_v = "{C_v * 1e4:.17g} cm^2/s"'
    new = fork(text).segment("AA")
    assert (new.R0, new.E, new.phi0) == pytest.approx((old.R0, old.E, old.phi0), rel=1e-14)


def test_viscosity_and_profile() -> None:
    """ν = μ/ρ; u ∝ 1 - (r/R)^γ has C_f = 2 (γ+2) π ν and α = (γ+2)/(γ+1): 22 and 1.1 for γ = 9, 8 and 4/3 for γ = 2."""
    for profile, friction, alpha in ((9, 22.0, 1.1), (2, 8.0, 4.0 / 3.0)):
        new = f'rho = "1.06 g/cm^3"\nmu = "4 mPa*s"\nprofile = {profile}'
        fluid = fork(fluid=('rho = "1.06 g/cm^3"', new)).fluid
        assert fluid.nu == pytest.approx(4e-3 / 1060.0, rel=1e-15)
        assert (fluid.friction, fluid.alpha) == pytest.approx((friction, alpha), rel=1e-15)


def test_windkessel_of_two_elements() -> None:
    """R and C alone: P = P_C, C dP_C/dt = Q - (P_C - P_venous)/R."""
    two = fork(outlet=("R_t = 0.3", 'R = "1e8 Pa*s/m^3"\nC = "0.1 mL/mmHg"\nP_venous = 100.0')).outlets[1]
    assert isinstance(two, Windkessel)
    assert (two.R1, two.R2, two.P_venous) == (0.0, 1e8, 100.0)


@dataclass(frozen=True)
class Inertial(Resistance):
    """A kind with R and C of its own, beside an inertance."""

    C: float = quantity(None, "m^3/Pa", "compliance C", 1e-15, 1.0)
    inertance: float = quantity(None, "Pa.s^2/m^3", "inertance L", 1.0, 1e15)

    symbol, noun = "RCL", "inertial Windkessel"


def test_another_kind_may_have_resistance_and_compliance(monkeypatch: pytest.MonkeyPatch) -> None:
    """R and C beside a number of another kind are that kind's, not a Windkessel's."""
    monkeypatch.setattr(outlets, "OUTLETS", (*outlets.OUTLETS, Inertial))
    found = fork(outlet=("R_t = 0.3", "R = 1e8\nC = 1e-9\ninertance = 1e6")).outlets[1]
    assert isinstance(found, Inertial) and (found.R, found.C, found.inertance) == (1e8, 1e-9, 1e6)
    assert isinstance(fork(outlet=("R_t = 0.3", "R = 1e8\nC = 1e-9")).outlets[1], Windkessel)


BAD = {
    "both radii": ("R0", "R0 = 1e-2\nA0 = 3e-4", ["AA: A0 and R0 say the same", "keep one"]),
    "three ends": ("R0", "R0 = [1e-2, 2e-2, 1e-2]", ["AA.R0 = [0.01, 0.02, 0.01]", "[first, last]"]),
    "length at both ends": ("L", "L = [0.1, 0.2]", ["AA.L", "number in m", "R0, h, E"]),
    "beta without h": ("h", "beta = 1e6", ["AA: beta and E say the same"]),
    "beta alone": ("E", "beta = 1e6", []),
    "negative area": ("R0", "A0 = -1.0", ["AA.A0 = -1 m^2 is not allowed", "check the value"]),
    "taper twice": ("R0", "R0 = [1e-2, 9e-3]\ntaper = 0.1", ["AA: R0 and taper", "keep one"]),
    "unknown key": ("R0", "R_0 = 1e-2", ["AA: unknown key 'R_0'", "did you mean R0?"]),
    "two C_v": ("R0", 'R0 = 9e-3\nC_v = ["0.3 m^2/s", "0.6 m^2/s"]', ["AA.C_v = ['0.3 m^2/s'", "give one number"]),
    "too much taper": ("R0", "R0 = [1e-2, 1e-3]", ["AA.taper = ", "taper s of R0", "must lie in [-1.5, 1.5]"]),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_segments(case: str) -> None:
    """One sentence that names segment, key and remedy."""
    key, new, words = BAD[case]
    lines = ["L = 0.04", "R0 = 9e-3", "h = 1e-3", "E = 5e5"]
    text = "\n".join(["[segments.AA]", *(line for line in lines if not line.startswith(f"{key} ")), new])
    if not words:
        fork(text)
        return
    with pytest.raises(ValueError) as error:
        fork(text)
    assert [word for word in words if word not in str(error.value)] == []


def test_beta_needs_h() -> None:
    with pytest.raises(ValueError, match=r"fork.toml: AA: beta needs h beside it; add h\."):
        fork("[segments.AA]\nL = 0.04\nR0 = 9e-3\nbeta = 1e6")


def test_fluid_given_twice() -> None:
    for more, words in (("nu = 3e-6\nmu = 4e-3", "mu and nu"), ("friction = 8\nprofile = 2", "profile and friction")):
        with pytest.raises(ValueError, match=f"fluid: {words} say the same; keep one"):
            fork(fluid=('rho = "1.06 g/cm^3"', more))
