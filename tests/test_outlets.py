"""Outlet kinds: the load of a stage, its slope and the frequency domain are one condition; a new kind is one class."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from solver import Network, Settings, simulate, simulate_periodic
from solver.laws import outlets
from solver.laws.outlets import (
    OUTLETS,
    Array,
    Condition,
    Load,
    Numbers,
    Outlet,
    Pressure,
    Reflection,
    Resistance,
    Windkessel,
)
from solver.laws.wall import Wall
from solver.linear import waveforms
from solver.network.coefficients import coefficients
from solver.network.files import dumps, loads
from solver.quantities.quantity import quantity

NUMBERS = {
    Reflection: {"R_t": 0.3, "P_venous": 200.0},
    Windkessel: {"R1": 2e8, "C": 4e-10, "R2": 2e9, "P_venous": 200.0},
    Resistance: {"R": 2e9, "P_venous": 200.0},
    Pressure: {"P_venous": 200.0},
}
every_kind = pytest.mark.parametrize("kind", OUTLETS, ids=lambda kind: kind.__name__)


def numbers(kind: type[Outlet]) -> dict[str, Array]:
    return {key: np.array([[value]]) for key, value in NUMBERS[kind].items()}


def wall(sheep: Network) -> Wall:
    return coefficients(sheep).wall.at(np.array([5]))


@every_kind
def test_slope_is_that_of_the_flow(sheep: Network, kind: type[Outlet]) -> None:
    """slope = d flow/dP by central differences, at -1, 0 and 5 kPa : 1e-8."""
    load = kind.load(numbers(kind), wall(sheep), 1e-3)
    for P in (np.array([[p]]) for p in (-1e3, 0.0, 5e3)):
        expected = (load.flow(P + 1.0) - load.flow(P - 1.0)) / 2.0
        np.testing.assert_allclose(load.slope(P), expected, rtol=1e-8)


@every_kind
def test_a_further_flow_at_the_end(sheep: Network, kind: type[Outlet]) -> None:
    """A leak q = g P + b P²: scale Q = flow grows by scale q, and the slope is still that of the flow, to 1e-8."""
    load = kind.load(numbers(kind), wall(sheep), 1e-3)
    g, b = 1e-9, 1e-13
    both = load.beside(lambda P: (g * P + b * P * P, g + 2.0 * b * P))
    for P in (np.array([[p]]) for p in (-1e3, 0.0, 5e3)):
        np.testing.assert_allclose(both.flow(P), load.flow(P) + load.scale * (g * P + b * P * P), rtol=1e-14)
        expected = (both.flow(P + 1.0) - both.flow(P - 1.0)) / 2.0
        np.testing.assert_allclose(both.slope(P), expected, rtol=1e-8)


@every_kind
def test_without_flow_the_pressures_behind_stay_equal(sheep: Network, kind: type[Outlet]) -> None:
    """P_C = P_venous and Q = 0: P_b = keep P_C + give P_venous = P_venous over a stage of any length, to round-off."""
    for tau in (1e-4, 1.0, 1e9):
        load = kind.load(numbers(kind), wall(sheep), tau)
        np.testing.assert_allclose(load.keep + load.give, 1.0, rtol=1e-14)


@every_kind
def test_steady_flow_is_that_of_the_frequency_domain(sheep: Network, kind: type[Outlet]) -> None:
    """Long stages end in a steady state: its flow under a small change of P is that of the condition at ω = 0: 1e-6."""
    outlet, at = numbers(kind), wall(sheep)
    load, P = kind.load(outlet, at, 1e9), np.array([[1e-3]])
    a, b, r = kind.condition(outlet, at, np.zeros((1, 1)), np.zeros(1), np.ones((1, 1, 1)))
    behind = load.give * outlet["P_venous"] + load.keep * 0.0  # what was stored is forgotten
    # a F + b P' = r with F = -Q, and scale Q = flow(P - P_b): eliminate Q
    one, other = a[:, 0] * load.flow(P - behind), load.scale * (b[:, 0] * P - r[:, 0])
    np.testing.assert_allclose(one, other, rtol=1e-6)


@dataclass(frozen=True)
class Orifice(Outlet):
    """P - P_venous = a Q + b Q|Q|: a kind that no file of the project knows."""

    a: float = quantity(None, "Pa.s/m^3", "linear resistance a", 1.0, 1e15, nominal=1e9)
    b: float = quantity(None, "1", "quadratic resistance b", 0.0, 1e30)

    symbol = "O"
    noun = "orifice"

    @classmethod
    def load(cls, numbers: Numbers, wall: Wall, tau: float) -> Load:
        a, b = numbers["a"], numbers["b"]

        def flow(P: Array) -> Array:
            return 2.0 * P / (a + np.sqrt(a * a + 4.0 * b * np.abs(P)))

        return Load(1.0, flow, lambda P: 1.0 / (a + 2.0 * b * np.abs(flow(P))))

    @classmethod
    def condition(cls, numbers: Numbers, wall: Wall, P_0: Array, omega: Array, Z_ref: Array) -> Condition:
        Z = numbers["a"][:, None] + 0j * omega[:, None]
        return Z / Z_ref, np.ones_like(Z), 0.0 * Z


def test_a_new_kind_is_one_class(sheep: Network) -> None:
    """An orifice in place of a resistance: without b the same to 1e-9, with b its law holds at every time to 1e-4.

    In the frequency domain it is the resistance a.
    """
    quick = Settings(dt=2e-3, tolerance=1e-8)
    first, *others = sheep.outlets

    def ending_in(outlet: Outlet) -> Network:
        return replace(sheep, outlets=(outlet, *others))

    plain = ending_in(Resistance(first.segment, R=2e9))
    linear, bent = ending_in(Orifice(first.segment, a=2e9, b=0.0)), ending_in(Orifice(first.segment, a=2e9, b=3e15))
    runs = [simulate(network, duration=0.2, settings=quick) for network in (plain, linear, bent)]
    for name in runs[0]:
        np.testing.assert_allclose(runs[1][name], runs[0][name], atol=1e-9 * np.abs(runs[0][name]).max(), rtol=0.0)
    P, Q = runs[2][f"{first.segment}.outlet.P"], runs[2][f"{first.segment}.outlet.Q"]
    np.testing.assert_allclose(2e9 * Q + 3e15 * Q * np.abs(Q), P, atol=1e-4 * P.max())
    T, n = sheep.inlet.T, 64
    small = 1e-9 * np.sin(2.0 * np.pi * np.arange(n) / n)
    for name, wave in waveforms(linear, small, T).items():
        np.testing.assert_allclose(wave, waveforms(plain, small, T)[name], atol=1e-12 * np.abs(wave).max())
    batch = {f"{first.segment}.outlet.a": np.array([2e9, 3e9])}
    both = simulate_periodic(bent, parameters=batch, settings=Settings(dt=5e-3, element_length=0.1))
    assert both[f"{first.segment}.outlet.Q"][1].max() < both[f"{first.segment}.outlet.Q"][0].max()


def test_a_kind_states_what_the_solver_asks_of_it() -> None:
    """A class without a part of the interface fails where it is written, and the sentence names what is missing."""
    with pytest.raises(TypeError, match="Half: this kind of outlet lacks noun, load, condition; state"):
        type("Half", (Outlet,), {"symbol": "H"})


@dataclass(frozen=True)
class Inertial(Windkessel):
    """A Windkessel with an inertance L, of whose keys three are the Windkessel's; here L has no effect."""

    L: float = quantity(None, "Pa.s^2/m^3", "inertance L", 0.0, 1e15, nominal=1e6)


def test_kinds_that_share_keys(sheep: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kind of all keys of a table, the smallest of several; what stores follows from its capacity."""
    monkeypatch.setattr(outlets, "OUTLETS", (Inertial, *OUTLETS))
    text = dumps(sheep)
    given = "R1 = 2e8\nC = 4e-10\nR2 = 2e9"
    for more, kind in (("", Windkessel), ("\nL = 1e6", Inertial)):
        (end,) = {type(o) for o in loads(re.sub("R_t = .*", given + more, text), "sheep").outlets}
        assert end is kind
    with pytest.raises(ValueError, match="two conditions \\(Inertial and Resistance: L, R\\); keep one of"):
        loads(re.sub("R_t = .*", "L = 1e6\nR = 1e9", text), "sheep")
    assert [kind.stores for kind in (Inertial, *OUTLETS)] == [True, False, True, False, False]
