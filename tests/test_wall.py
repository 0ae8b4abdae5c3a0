"""Wall laws: pressure, derivative, inverse and integrals tied together, and tied to the equations of the paper.

Derivatives are taken by a complex step, f'(x) = Im f(x + ih)/h with h = 1e-30, which has no truncation error to
speak of, so the tolerances are a few units of round-off (2.2e-16).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from solver.laws.wall import Wall
from solver.laws.wall_laws import (
    ELASTIC_LAWS,
    VISCOUS_LAWS,
    Array,
    ElasticLaw,
    Monotone,
    Quadratic,
    riemann_velocity,
    wave_speed,
)

# the ascending aorta of Table 1
E, H, R0, PHI0, ETA, RHO = 1.539e6, 3.8e-4, 9.48e-3, 25451.0, 0.5, 1060.0
A0 = math.pi * R0**2
K_H = H / ((1.0 - ETA**2) * R0)
STRETCH = np.linspace(0.6, 1.6, 41)
K = np.full_like(STRETCH, E * K_H)
DENSITY = np.full_like(STRETCH, RHO)

every_elastic_law = pytest.mark.parametrize("law", ELASTIC_LAWS.values(), ids=ELASTIC_LAWS)
every_ENL = pytest.mark.parametrize("e", [0.0, 0.01, 0.3, -0.2])


def derivative(f: Callable[[Array], Array], x: Array) -> Array:
    return f(x + 1e-30j).imag / 1e-30


# --- elastic laws -------------------------------------------------------------------------------------------------


@every_elastic_law
@every_ENL
def test_derivative_is_that_of_the_pressure(law: ElasticLaw, e: float) -> None:
    """dP_el/ds is the derivative of P_el(s) for strains -0.4 to 0.6, to round-off (6e-16), with and without E_NL."""
    slope = derivative(lambda s: law.pressure(s, K, np.array(e)), STRETCH)
    np.testing.assert_allclose(law.derivative(STRETCH, K, np.array(e)), slope, rtol=1e-15)


@every_elastic_law
@every_ENL
def test_energy_is_the_integral_of_the_pressure(law: ElasticLaw, e: float) -> None:
    """d(energy)/ds = P_el s and energy(1) = 0; and energy = ∫₁ˢ P_el s ds by 6 Gauss nodes, exact here (2e-16 K)."""
    work = derivative(lambda s: law.energy(s, K, np.array(e)), STRETCH)
    np.testing.assert_allclose(law.pressure(STRETCH, K, np.array(e)) * STRETCH, work, atol=3e-16 * K[0], rtol=0.0)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    half = 0.5 * (STRETCH - 1.0)[:, None]
    s = 1.0 + half * (1.0 + nodes)
    integral = half[:, 0] * ((law.pressure(s, K[:, None], np.array(e)) * s) @ weights)
    np.testing.assert_allclose(law.energy(STRETCH, K, np.array(e)), integral, atol=3e-16 * K[0], rtol=0.0)
    assert law.energy(np.array(1.0), K[0], np.array(e)) == 0.0


@every_elastic_law
@every_ENL
def test_stretch_is_the_inverse_of_the_pressure(law: ElasticLaw, e: float) -> None:
    """stretch(P_el(s)) = s to round-off (3e-16), and P_el(1) = 0, stretch(0) = 1 exactly."""
    P = law.pressure(STRETCH, K, np.array(e))
    np.testing.assert_allclose(law.stretch(P, K, np.array(e)), STRETCH, rtol=5e-16)
    assert law.pressure(np.array(1.0), K[0], np.array(e)) == 0.0
    assert law.stretch(np.array(0.0), K[0], np.array(e)) == 1.0


@pytest.mark.parametrize(
    ("name", "e", "highest"),
    [("regression", 0.0, 1.0), ("beta", -0.2, 1.25), ("regression", -0.2, 1.4 - math.sqrt(0.96))],
)
def test_no_wall_carries_more_than_the_highest_pressure(name: str, e: float, highest: float) -> None:
    """P_el/K has the supremum 1 (regression), -1/(4e) (β) or 1 - 2e - 2√(e² - e) (regression, e < 0): NaN above it,
    and no warning, as searches try such walls."""
    s = ELASTIC_LAWS[name].stretch(np.array([0.999, 1.001]) * highest * K[0], K[0], np.array(e))
    assert s[0] > 1.0 and np.isnan(s[1])


def test_laws_differ_by_the_stretch() -> None:
    """P_β = (R/R0) P_regression at every stretch (the paper's two laws), to round-off (3e-16)."""
    for e in (0.0, 0.3):
        beta, regression = (ELASTIC_LAWS[name].pressure(STRETCH, K, np.array(e)) for name in ("beta", "regression"))
        np.testing.assert_allclose(beta, STRETCH * regression, rtol=4e-16)


def test_beta_is_the_law_of_the_network() -> None:
    """P_el = β (√A - √A0), β = √π E h/((1-η²) A0) (`sheep_constitutive`), to the round-off of √A - √A0 (2e-15 K)."""
    beta = math.sqrt(math.pi) * E * H / ((1.0 - ETA**2) * A0)
    paper = beta * (np.sqrt(A0 * STRETCH**2) - math.sqrt(A0))
    np.testing.assert_allclose(
        ELASTIC_LAWS["beta"].pressure(STRETCH, K, np.array(0.0)), paper, rtol=0.0, atol=2e-15 * K[0]
    )


def test_regression_is_the_law_of_the_fit() -> None:
    """P_el = E h/(1-η²) (1/R0 - 1/R) (`sheep_pressure_radius`), to the round-off of the difference (2e-15 K)."""
    paper = E * H / (1.0 - ETA**2) * (1.0 / R0 - 1.0 / (R0 * STRETCH))
    np.testing.assert_allclose(
        ELASTIC_LAWS["regression"].pressure(STRETCH, K, np.array(0.0)), paper, rtol=0.0, atol=2e-15 * K[0]
    )


# --- waves --------------------------------------------------------------------------------------------------------


@every_elastic_law
def test_wave_speed_at_the_reference_radius(law: ElasticLaw) -> None:
    """c0² = 2Eh/(3ρR0) for η = 0.5, to round-off (4e-16); both laws have it, with and without E_NL."""
    for e in (0.0, 0.3):
        c0 = wave_speed(law, np.array(1.0), K[0], np.array(e), np.array(RHO))
        assert c0**2 == pytest.approx(2.0 * E * H / (3.0 * RHO * R0), rel=4e-16)


@every_elastic_law
def test_wave_speed_from_the_area(law: ElasticLaw) -> None:
    """c² = (A/ρ) dP/dA with P as a function of A, to round-off (6e-16)."""
    A = A0 * STRETCH**2
    slope = derivative(lambda area: law.pressure(np.sqrt(area / A0), K, np.array(0.3)), A)
    c = wave_speed(law, STRETCH, K, np.array(0.3), DENSITY)
    np.testing.assert_allclose(c**2, A / RHO * slope, rtol=1e-15)


def test_riemann_velocity_in_closed_form() -> None:
    """Without E_NL w = ∫ c/A dA is 4 (c - c0) for β and 4 (c0 - c) for regression, to round-off (2e-15 c0)."""
    zero = np.zeros_like(STRETCH)
    for name, sign in (("beta", 1.0), ("regression", -1.0)):
        law = ELASTIC_LAWS[name]
        c = wave_speed(law, STRETCH, K, zero, DENSITY)
        c0 = wave_speed(law, np.ones_like(STRETCH), K, zero, DENSITY)
        w = riemann_velocity(law, STRETCH, K, zero, DENSITY)
        np.testing.assert_allclose(w, sign * 4.0 * (c - c0), rtol=0.0, atol=3e-15 * c0[0])
        np.testing.assert_allclose(law.simple_wave(STRETCH, c0), sign * 4.0 * (c - c0), rtol=0.0, atol=3e-15 * c0[0])


@every_elastic_law
@every_ENL
def test_riemann_velocity_is_the_integral(law: ElasticLaw, e: float) -> None:
    """w = ∫ c/A dA = ∫₁ˢ 2c/s ds against adaptive quadrature, strains -0.4 to 0.6, to round-off (1e-15 c)."""

    def integrand(s: float) -> float:
        return 2.0 * float(wave_speed(law, np.array(s), K[0], np.array(e), np.array(RHO))) / s

    exact = [quad(integrand, 1.0, s, epsabs=1e-13, epsrel=1e-13)[0] for s in STRETCH]
    all_e = np.full_like(STRETCH, e)
    c = wave_speed(law, STRETCH, K, all_e, DENSITY)
    np.testing.assert_allclose(riemann_velocity(law, STRETCH, K, all_e, DENSITY) / c, exact / c, rtol=0.0, atol=2e-15)


# --- viscous laws -------------------------------------------------------------------------------------------------

X = np.linspace(-2.0, 2.0, 41)


@every_elastic_law
@every_ENL
def test_columns_span_the_law(law: ElasticLaw, e: float) -> None:
    """P_el = Σ cᵢ columnᵢ(R) exactly (4e-14 K), and ``solve`` gives K, R0 and e of c back (4e-13; conditioning)."""
    R = R0 * STRETCH
    columns = np.stack(law.columns(R), axis=-1)[:, : 3 if e else 2]
    P = law.pressure(STRETCH, K, np.array(e))
    c = np.linalg.lstsq(columns / columns[0], P, rcond=None)[0] / columns[0]
    np.testing.assert_allclose(columns @ c, P, atol=1e-13 * K[0], rtol=0.0)
    found = law.solve(np.array([*c, 0.0][:3]))
    np.testing.assert_allclose(found, (K[0], R0, e), rtol=1e-12, atol=1e-12)


@every_elastic_law
def test_columns_without_a_wall(law: ElasticLaw) -> None:
    """A pressure that is constant, or that never vanishes, belongs to no wall: R0 is NaN or 0."""
    assert not law.solve(np.array([1e3, 0.0, 0.0]))[1] > 0.0
    assert math.isnan(law.solve(np.array([1.0, 1.0, 1.0]))[1])


@pytest.mark.parametrize("law", VISCOUS_LAWS.values(), ids=VISCOUS_LAWS)
def test_viscous_slope_is_that_of_the_stress(law: Quadratic | Monotone) -> None:
    """slope(x) = d(x factor(x))/dx for |r ε̇| <= 2, to round-off (1e-15 of the largest term)."""
    slope = derivative(lambda x: x * law.factor(x), X)
    np.testing.assert_allclose(law.slope(X), slope, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("law", VISCOUS_LAWS.values(), ids=VISCOUS_LAWS)
def test_viscous_bend_is_that_of_the_factor(law: Quadratic | Monotone) -> None:
    """bend = d factor/dx, for x = r ε̇ in ±1; 1e-11 where the series ends (x = 0.01) and the difference begins."""
    x = np.concatenate([np.linspace(-1.0, 1.0, 41), [0.0099, 0.0101, -0.0099, -0.0101]])
    step = 1e-4
    low, high = law.factor(x - step), law.factor(x + step)
    far_low, far_high = law.factor(x - 2 * step), law.factor(x + 2 * step)
    slope = (8.0 * (high - low) - (far_high - far_low)) / (12.0 * step)
    np.testing.assert_allclose(law.bend(x), slope, rtol=0.0, atol=2e-11)


@pytest.mark.parametrize("law", VISCOUS_LAWS.values(), ids=VISCOUS_LAWS)
def test_factor_is_exactly_one_at_rest(law: Quadratic | Monotone) -> None:
    """factor(±0) = slope(±0) = 1, bit for bit: φ_NL = 0 is the linear model; and it is continuous there."""
    zero = np.array([0.0, -0.0])
    assert (law.factor(zero) == 1.0).all() and (law.slope(zero) == 1.0).all()
    tiny = np.array([1e-300, -1e-20, 1e-16])
    np.testing.assert_allclose(law.factor(tiny), 1.0 + tiny, rtol=3e-16)


def test_monotone_equals_quadratic_to_second_order() -> None:
    """(e^{2x} - 1)/2 - (x + x²) = 2x³/3 + O(x⁴): the observed order tends to 3 and the coefficient to 2/3."""
    x = 0.02 / 2.0 ** np.arange(4)
    difference = x * (Monotone().factor(x) - Quadratic().factor(x))
    order = np.log2(difference[:-1] / difference[1:])
    np.testing.assert_allclose(order, 3.0, atol=0.008)  # 3 + x/(4 ln 2): 3.0072 at x = 0.02
    assert order[-1] == pytest.approx(3.0, abs=0.002)
    assert difference[-1] / x[-1] ** 3 == pytest.approx(2.0 / 3.0, rel=0.0013)  # next term: x/2


def test_effective_viscosity_changes_sign_only_for_quadratic() -> None:
    """Quadratic: 1 + 2x, zero at x = -1/2, that is ε̇ = -1/(2r). Monotone: e^{2x} > 0 everywhere."""
    x = np.array([-0.5 - 1e-12, -0.5, -0.5 + 1e-12])
    assert np.sign(Quadratic().slope(x)).tolist() == [-1.0, 0.0, 1.0]
    assert (Monotone().slope(np.linspace(-50.0, 50.0, 101)) > 0.0).all()


# --- the wall of a vessel -----------------------------------------------------------------------------------------


def aorta(elastic: str, viscous: str, e: float = 0.0, r: float = 0.0, P_ref: float = 0.0) -> Wall:
    values = {"A0": A0, "K": E * K_H, "e": e, "K_h": K_H, "phi0": PHI0, "r": r, "P_ref": P_ref, "rho": RHO}
    arrays = {key: np.full_like(STRETCH, value) for key, value in values.items()}
    return Wall(ELASTIC_LAWS[elastic], VISCOUS_LAWS[viscous], **arrays, nonlinear=r != 0.0, bent=e != 0.0)


@pytest.mark.parametrize("r", [0.0, -0.915], ids=["linear", "nonlinear"])
def test_wall_is_the_constitutive_law_of_the_paper(r: float) -> None:
    """P = β(√A - √A0) + ν_s ∂A/∂t + ν_NL (∂A/∂t)² with the paper's coefficients (`sheep_constitutive`), to 2e-15 K."""
    wall = aorta("beta", "quadratic", r=r)
    A = A0 * STRETCH**2
    A_t = 2.0 * A0 * np.linspace(-0.3, 0.5, len(A))
    beta = math.sqrt(math.pi) * E * H / ((1.0 - ETA**2) * A0)
    nu_s = math.sqrt(math.pi) * PHI0 * H / (2.0 * (1.0 - ETA**2) * A * math.sqrt(A0))
    nu_NL = 0.25 * r * PHI0 * H / (1.0 - ETA**2) * math.sqrt(math.pi) / (A**1.5 * A0)
    paper = beta * (np.sqrt(A) - math.sqrt(A0)) + nu_s * A_t + nu_NL * A_t**2
    np.testing.assert_allclose(wall.pressure(A, A_t), paper, rtol=0.0, atol=2e-15 * K[0])
    np.testing.assert_allclose(wall.viscosity(A, A_t), nu_s + 2.0 * nu_NL * A_t, rtol=2e-15)


def test_wall_is_the_regression_law_of_the_paper() -> None:
    """P = Eh/(1-η²) (1/R0 - 1/R) + φ0 h/((1-η²)R0) R'/R + φ_NL h/((1-η²)R0²) R'²/R (`sheep_pressure_radius`), 2e-15 K.

    The last coefficient carries the 1/R0² that the paper's printed vector C misses.
    """
    r = -0.915
    R, R_t = R0 * STRETCH, R0 * np.linspace(-0.3, 0.5, len(STRETCH))
    a = H / (1.0 - ETA**2)
    paper = a * (E * (1.0 / R0 - 1.0 / R) + PHI0 / R0 * R_t / R + r * PHI0 / R0**2 * R_t**2 / R)
    P = aorta("regression", "quadratic", r=r).pressure(math.pi * R**2, 2.0 * math.pi * R * R_t)
    np.testing.assert_allclose(P, paper, rtol=0.0, atol=2e-15 * K[0])


@pytest.mark.parametrize("elastic", ELASTIC_LAWS)
@pytest.mark.parametrize("viscous", VISCOUS_LAWS)
def test_wall_derivatives_and_inverse(elastic: str, viscous: str) -> None:
    """stiffness = dP/dA at rest, viscosity = dP/d(∂A/∂t), area inverts P, c² = (A/ρ) dP/dA; to round-off (2e-15)."""
    wall = aorta(elastic, viscous, e=0.3, r=-0.915, P_ref=1e4)
    A = A0 * STRETCH**2
    A_t = 2.0 * A0 * np.linspace(-0.3, 0.5, len(A))
    rest = np.zeros_like(A)
    np.testing.assert_allclose(derivative(lambda a: wall.pressure(a, rest), A), wall.stiffness(A), rtol=2e-15)
    np.testing.assert_allclose(derivative(lambda a: wall.pressure(A + 0j, a), A_t), wall.viscosity(A, A_t), rtol=2e-15)
    np.testing.assert_allclose(wall.area(wall.pressure(A, rest)), A, rtol=2e-15)
    np.testing.assert_allclose(wall.wave_speed(A) ** 2, A / RHO * wall.stiffness(A), rtol=2e-15)
    assert wall.pressure(np.full_like(A, A0), rest) == pytest.approx(1e4, abs=1e-9)


@pytest.mark.parametrize("elastic", ELASTIC_LAWS)
@pytest.mark.parametrize("viscous", VISCOUS_LAWS)
@pytest.mark.parametrize("r", [0.0, -0.915, 1.4], ids=["linear", "falling", "rising"])
@pytest.mark.parametrize("memory", [False, True], ids=["at once", "memory"])
def test_viscous_slope_is_that_of_the_pressure(elastic: str, viscous: str, r: float, memory: bool) -> None:
    """∂P/∂A at fixed ∂A/∂t is stiffness + viscous_slope, of a wall with memory too; to round-off (4e-16 of K/A0)."""
    wall = aorta(elastic, viscous, e=0.3, r=r, P_ref=1e4)
    if memory:
        tau, share = np.linspace([0.0, 0.01], [0.05, 0.1], len(STRETCH)).T, np.outer([0.7, 0.4], np.ones(len(STRETCH)))
        past = np.linspace([-5e3, 1e3], [9e3, -2e3], len(STRETCH)).T
        wall = replace(wall, tau=tau, share=share).remembering(past, 4e-4)
    A = A0 * STRETCH**2
    A_t = 2.0 * A0 * np.linspace(-0.3, 0.5, len(A))
    slope = derivative(lambda a: wall.pressure(a, A_t), A)
    found = wall.stiffness(A) + wall.viscous_slope(A, A_t)
    np.testing.assert_allclose(found, slope, rtol=0.0, atol=2e-15 * K[0] / A0)


def test_an_unknown_past_is_that_of_a_heart_beat() -> None:
    """The stresses of a wall with memory, of which no past is known, are those of a rate that has lasted 0.1 s from no
    stress: θ/(τ + θ) φ0 ε̇, and all of it where τ = 0."""
    tau, share = np.outer([0.0, 0.05, 0.4], np.ones(len(STRETCH))), np.outer([0.7, 0.2, 0.1], np.ones(len(STRETCH)))
    wall = replace(aorta("beta", "quadratic", e=0.0, r=0.0), tau=tau, share=share)
    A, A_t = A0 * STRETCH**2, 2.0 * A0 * np.linspace(-0.3, 0.5, len(STRETCH))
    lasted = wall.remembering(np.zeros_like(tau), 0.1).carried(A, A_t)
    np.testing.assert_allclose(wall.carried(A, A_t), lasted, rtol=1e-14)
    np.testing.assert_allclose(lasted, np.outer([1.0, 2.0 / 3.0, 0.2], PHI0 * wall.strain_rate(A, A_t)), rtol=1e-14)
