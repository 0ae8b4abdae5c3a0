"""The learned law of a wall: against the independent generator, derivatives, energy over any loop, and its ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from truth.anatomy import anatomy
from truth.beat import Beat, at_phase
from truth.bench import bench_wall, radius
from truth.hide import ALL, Effect, hide
from truth.network import Balance
from truth.shapes import arterial_pressure, ejection
from tubes import propagation

from solver import Network, beat_harmonics, loop, simulate
from solver.errors import InputError
from solver.laws.effects import BY_NAME
from solver.laws.wall_laws import LearnedStress
from solver.network.coefficients import coefficients

T = 0.5
BEAT = Beat(T, 80, 256)
LAW = BY_NAME["learned_wall"]
WIDE = {"learned_low": -0.05, "learned_span": 1.0, "learned_rate": 1e3}


def with_law(network: Network, hidden: str, size: float) -> Network:
    """The walls of the generator's cubic_rate, φ0 ε̇ + size φ0 ε̇³, or strain_viscosity, φ0 (1 + size ε) ε̇."""
    for s in network.segments:
        if hidden == "cubic_rate":
            network = LAW.add(network, s.name, {**WIDE, "learned_cubic": size * s.phi0})
        else:  # φ0 (1 + c ε) = φ0 (1 - 0.05 c) + φ0 c (ε + 0.05)
            network = LAW.add(network, s.name, {**WIDE, "learned_rise": size * s.phi0})
            network = network.with_parameters({f"{s.name}.phi0": (1.0 - 0.05 * size) * s.phi0})
    return network


HIDDEN = [("cubic_rate", 20.0), ("strain_viscosity", 8.0)]


@pytest.mark.parametrize(("hidden", "size"), HIDDEN)
def test_loop_against_the_generator(sheep: Network, hidden: str, size: float) -> None:
    """P on the loop of radii that Newton's method of the generator found: 1e-6 of the pulse, which it moves by 1 %."""
    sheep = replace(sheep, viscous_law="monotone")
    P = BEAT.values(arterial_pressure(np.random.default_rng(2), BEAT))
    R = radius(bench_wall(hide(anatomy(sheep), Effect(hidden, ALL, size)), "CA", BEAT), P)
    found = loop.loop_pressure(with_law(sheep, hidden, size), "CA", R, T)
    assert np.abs(found - P).max() <= 1e-6 * np.ptp(P)
    assert np.abs(loop.loop_pressure(sheep, "CA", R, T) - P).max() >= 0.01 * np.ptp(P)


@pytest.mark.parametrize(("hidden", "size"), [("cubic_rate", 0.3), ("strain_viscosity", 8.0)])
def test_waves_against_the_generator(sheep: Network, hidden: str, size: float) -> None:
    """Ten sites of the sheep by the generator's harmonic balance on its own points, and ours: 1e-5 of the pulse."""
    sheep = replace(sheep, viscous_law="monotone")
    c = ejection(np.random.default_rng(7), BEAT, sheep.inlet.Q_max)
    truth = Balance(hide(anatomy(sheep), Effect(hidden, ALL, size)), BEAT, 14).solve(c).channels
    names = [n for n in truth if n != "inlet.Q"]
    (X,), (plain,) = (
        beat_harmonics(n, names, 40, lambda t: at_phase(c, t / T), T, tolerance=1e-8, more=40)
        for n in (with_law(sheep, hidden, size), sheep)
    )
    pulse = np.array([np.ptp(BEAT.values(truth[n])) for n in names])
    right = np.stack([truth[n][:41] for n in names], axis=1)
    assert (np.abs(X - right) / pulse).max() <= 1e-5
    assert (np.abs(plain - right) / pulse).max() >= 1e-3


EVERY = {"learned_rise": 3e5, "learned_fall": 1e5, "learned_cubic": 2e4, "learned_friction": 4e3, "learned_low": 0.02,
         "learned_span": 0.08, "learned_rate": 1.5}  # fmt: skip


@pytest.mark.parametrize("tau", [0.0, 0.03])
def test_derivatives(sheep: Network, tau: float) -> None:
    """∂P/∂A, ∂P/∂A_t and the matrix of a loop against central differences, inside the range: 1e-6; memory too."""
    network = LAW.add(sheep.with_terms({"CA.tau": tau}) if tau else sheep, "CA", EVERY)
    w, s = loop.wall_of(network, "CA"), sheep.segment("CA")
    t = np.arange(64) * T / 64
    R = s.R0 * (1.06 + 0.03 * np.cos(2.0 * np.pi * t / T))
    D = loop.derivative_matrix(64, T)
    A, A_t = np.pi * R * R, 2.0 * np.pi * R * (D @ R)
    if not tau:
        h, k = 1e-5 * A, 1e-5 * np.abs(A_t).max()
        by_A = (w.pressure(A + h, A_t) - w.pressure(A - h, A_t)) / (2.0 * h)
        by_A_t = (w.pressure(A, A_t + k) - w.pressure(A, A_t - k)) / (2.0 * k)
        np.testing.assert_allclose(w.stiffness(A) + w.viscous_slope(A, A_t), by_A, atol=1e-6 * np.abs(by_A).max())
        np.testing.assert_allclose(w.viscosity(A, A_t), by_A_t, atol=1e-6 * np.abs(by_A_t).max())
    d = 1e-7 * s.R0 * np.sin(4.0 * np.pi * t / T + 0.3)
    moved = [loop.pressure(w, R + x, D @ (R + x), T)[0] for x in (d, -d)]
    np.testing.assert_allclose(
        loop.slope(w, R, D @ R, T) @ d, 0.5 * (moved[0] - moved[1]), atol=1e-6 * np.abs(moved[0] - moved[1]).max()
    )


def test_small_waves_feel_the_viscosity_at_rest(sheep: Network) -> None:
    """γ of the frequency domain with rise u at the strain of P_0 is that of as much more φ0, to 1e-12, tau or not."""
    omega, P_0 = np.array([10.0, 60.0]), sheep.P_0
    s = sheep.segment("CA")
    strain = float(np.sqrt(coefficients(sheep).wall.area(np.array([[P_0]]))[0, 5] / (np.pi * s.R0**2)) - 1.0)
    law = {"learned_low": strain - 0.02, "learned_span": 0.08, "learned_rise": 4e5}
    for terms in ({}, {"CA.tau": 0.02}):
        base = sheep.with_terms(terms)
        more = base.with_parameters({"CA.phi0": s.phi0 + 1e5})
        found, expected = (propagation(n, omega)[0][5] for n in (LAW.add(base, "CA", law), more))
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_no_loop_gives_out_energy(seed: int) -> None:
    """∮ σ_L dε >= 0 of random loops, far beyond the range too, and σ_L does not fall with ε̇; random numbers >= 0."""
    rng = np.random.default_rng(seed)
    law = LearnedStress(
        *(rng.exponential(1e4, 4) * (rng.random(4) < 0.6)), *rng.uniform([-0.1, 0.02, 0.1], [0.1, 0.2, 2.0])
    )
    t, k = np.linspace(0.0, 2.0 * np.pi, 4096, endpoint=False), np.arange(1, 6)
    a, b = rng.normal(size=(2, 5, 1)) * 0.2 / k[:, None]
    strain = (a * np.cos(np.outer(k, t)) + b * np.sin(np.outer(k, t))).sum(axis=0)
    rate = (k[:, None] * (b * np.cos(np.outer(k, t)) - a * np.sin(np.outer(k, t)))).sum(axis=0)
    power = law.stress(strain, rate) * rate
    assert power.min() >= 0.0
    assert (np.diff(law.stress(strain[:, None], np.linspace(-5.0, 5.0, 101)), axis=1) >= -1e-9).all()
    np.testing.assert_allclose(law.stress(strain, -rate), -law.stress(strain, rate))


def test_it_is_held_beyond_its_range() -> None:
    """Below and above it is what it is at the border; faster, its slope stays, and it has no step."""
    law = LearnedStress(*map(np.array, EVERY.values()))
    low, high, fast = 0.02, 0.10, 1.5
    for beyond, border in ((-0.3, low), (0.4, high)):
        assert law.stress(np.array(beyond), np.array(0.7)) == pytest.approx(law.stress(np.array(border), np.array(0.7)))
        assert law.by_strain(np.array(beyond), np.array(0.7)) == 0.0
    inside, border, beyond = (law.stress(np.array(0.05), np.array(fast + h)) for h in (-1e-6, 0.0, 2.0))
    slope = float(law.by_rate(np.array(0.05), np.array(fast)))
    assert (border - inside) / 1e-6 == pytest.approx(slope, rel=1e-4)
    assert (beyond - border) / 2.0 == pytest.approx(slope) == law.by_rate(np.array(0.05), np.array(9.0))


def test_it_is_no_candidate_but_makes_laws(sheep: Network) -> None:
    """No search tries it as it is; its terms are counted relative to E, none may be below 0, all that is seen is in
    its range; a scheme without it and numbers out of range are refused."""
    assert LAW.coordinates(sheep, "CA") == () == LAW.coordinates(sheep, "all")
    rise, cubic = LAW.learned(sheep, "CA", ("learned_rise", "learned_cubic"))
    E = sheep.segment("CA").E
    assert (rise.low, cubic.low, rise.size, cubic.size) == (0.0, 0.0, 0.005 * E, 0.02 * E)
    (everywhere,) = LAW.learned(sheep, "all", ("learned_cubic",))
    assert everywhere.ratio == "E" and len(everywhere.moves) == len(sheep.segments)
    held = LAW.valid(np.array([0.02, 0.10]), np.array([-1.0, 0.4]))
    assert held == pytest.approx({"learned_low": 0.0, "learned_span": 0.12, "learned_rate": 1.25})
    far = LAW.valid(np.array([-0.85, 0.15]), np.array([-1.0, 0.4]))  # no strain is lower than a wall's may be
    assert (far["learned_low"], far["learned_span"]) == pytest.approx((-0.9, 0.9 + 0.15 + 0.25))
    assert all(("u = " in LAW.formula((key,))) == (key in ("learned_rise", "learned_fall")) for key in LAW.library)
    with pytest.raises(InputError, match="does not support the effect learned_wall"):
        simulate(LAW.add(sheep, "CA", EVERY), duration=0.01, scheme="muscl")
    with pytest.raises(InputError, match="strain range of the learned law"):
        LAW.add(sheep, "CA", {"learned_span": 0.0})
