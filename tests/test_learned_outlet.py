"""The learned law of an outlet: against a resistance and by hand, derivatives, energy, small waves, and its limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from solver import Network, Resistance, Windkessel, beat_harmonics, linear, simulate, simulate_periodic
from solver.errors import InputError
from solver.laws.effects import BY_NAME
from solver.laws.outlets import Reflection

LAW: Any = BY_NAME["learned_outlet"]
NUMBERS = {"learned_open": 3e-10, "learned_shut": 1e-10, "learned_from": 5e3, "learned_over": 6e3}
NAMES = ["CA.P", "CA.Q", "AA.P", "CA.outlet.P", "CA.outlet.Q"]


def law(network: Network, **numbers: float) -> Network:
    return LAW.add(network, "CA", {**NUMBERS, **numbers})


def test_equal_terms_are_a_resistance(sheep: Network) -> None:
    """open = shut = 1/R - 1/R' beside R' is a resistance R: by balance to 1e-9, by steps of both schemes to what they
    are solved to, 1e-6 of each pulse, and of small waves to 1e-12."""
    R, more = 2e9, 5e9
    g = 1.0 / R - 1.0 / more
    plain = sheep.with_outlet(Resistance("CA", R=R))
    acting = law(sheep.with_outlet(Resistance("CA", R=more)), learned_open=g, learned_shut=g)
    one, two = (beat_harmonics(n, NAMES, 20, tolerance=1e-9)[0] for n in (plain, acting))
    np.testing.assert_allclose(two, one, atol=1e-9 * np.abs(one[1:]).max(axis=0).min())
    for scheme in ("staggered", "muscl"):
        a, b = (simulate(n, duration=0.05, scheme=scheme) for n in (plain, acting))
        for name in NAMES:
            np.testing.assert_allclose(b[name], a[name], atol=1e-6 * np.ptp(a[name]))
    Q = np.array([1e-5, 1e-5j])
    found, expected = (linear.solve(n, Q, np.array([0.0, 30.0])).P_node for n in (acting, plain))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("end", [Reflection("CA", R_t=0.3), Resistance("CA", R=2e9)])
def test_steps_and_balance_agree(sheep: Network, end: Reflection | Resistance) -> None:
    """A conductance that triples over the pulse: to the error of the steps, 5e-5 of each pulse, which the law moves by
    1 % and more. Beside a resistance Q is P/R and what the law says of P, to 1e-6."""
    plain = sheep.with_outlet(end)
    run = simulate_periodic(law(plain), tolerance=1e-6, start="periodic")
    stepped = np.array([np.fft.rfft(run[n][:-1], norm="forward")[:31] for n in NAMES]).T
    X, other = (beat_harmonics(n, NAMES, 30, tolerance=1e-8)[0] for n in (law(plain), plain))
    pulse = np.array([np.ptp(run[n]) for n in NAMES])
    assert (np.abs(stepped - X) / pulse).max() <= 5e-5
    assert (np.abs(other - X) / pulse).max() >= 1e-2
    if isinstance(end, Resistance):
        P, Q = run["CA.outlet.P"], run["CA.outlet.Q"]
        u = np.clip((P - 5e3) / 6e3, 0.0, 1.0)
        np.testing.assert_allclose(Q, P / end.R + (1e-10 + 2e-10 * u) * P, atol=1e-6 * np.ptp(Q))


@pytest.mark.parametrize("seed", range(5))
def test_it_gives_out_no_energy_and_its_slope_is_that(seed: int) -> None:
    """q (P - P_venous) >= 0 at every pressure, of numbers >= 0, and ∂q/∂P by differences of 1 Pa to 1e-4 but at its
    ends."""
    rng = np.random.default_rng(seed)
    open_, shut = rng.exponential(1e-10, 2) * (rng.random(2) < 0.7)
    values = {"learned_open": open_, "learned_shut": shut, "learned_from": rng.uniform(-2e3, 8e3), "learned_over": 5e3}
    P = np.linspace(-2e4, 3e4, 501)
    q, slope = LAW.outflow(P, values)
    assert (q * P).min() >= 0.0
    low, high = values["learned_from"], values["learned_from"] + 5e3
    smooth = (np.abs(P - low) > 2.0) & (np.abs(P - high) > 2.0)
    differences = 0.5 * (LAW.outflow(P + 1.0, values)[0] - LAW.outflow(P - 1.0, values)[0])
    np.testing.assert_allclose(slope[smooth], differences[smooth], atol=1e-4 * np.abs(slope).max() + 1e-30)
    far = np.array([high + 1e4, high + 2e4])  # held: a straight line through P_venous
    np.testing.assert_allclose(LAW.outflow(far, values)[0], open_ * far)


def test_it_is_no_candidate_but_makes_laws(sheep: Network) -> None:
    """No search tries it as it is; a term's size is a tenth of 1/Z, none may be below 0, all that is seen is in its
    range, and a Windkessel, whose flow is none of P - P_venous, has none."""
    assert LAW.coordinates(sheep, "CA") == ()
    (rises,) = LAW.learned(sheep, "CA", ("learned_open",))
    s = sheep.segment("CA")
    c = np.sqrt(s.E * s.h / (1.0 - sheep.eta**2) / s.R0 / 2.0 / sheep.fluid.rho)
    assert rises.low == 0.0 and rises.size == pytest.approx(0.1 * np.pi * s.R0**2 / (sheep.fluid.rho * c))
    held = LAW.valid(np.array([6e3, 10e3]), np.zeros(1))
    assert held == pytest.approx({"learned_from": 5e3, "learned_over": 6e3})
    assert "shut (1 - u)" in LAW.formula(("learned_open", "learned_shut"))
    soft = sheep.with_outlet(Windkessel("CA", R1=3e8, C=1e-10, R2=2e9))
    assert "CA" not in LAW.where(soft) and "CA" in LAW.where(sheep)
    with pytest.raises(InputError, match="learned_outlet is no effect of a Windkessel"):
        simulate(soft.with_terms({f"CA.outlet.{key}": x for key, x in NUMBERS.items()}), duration=0.01)


def test_a_range_alone_is_no_law(sheep: Network) -> None:
    """The range of a law whose sizes are 0 does nothing at a Windkessel, where the law itself is refused."""
    soft = sheep.with_outlet(Windkessel("CA", R1=3e8, C=1e-10, R2=2e9))
    ranged = {f"CA.outlet.{key}": x if key in LAW.how else 0.0 for key, x in NUMBERS.items()}
    found, expected = (simulate(n, duration=0.02)["CA.P"] for n in (soft.with_terms(ranged), soft))
    np.testing.assert_array_equal(found, expected)
