"""The elastic and viscous laws of an arterial wall, by name.

They are functions of the stretch s = R/R0 = √(A/A0), with strain ε = s - 1 and strain rate ε̇. There are two elastic
laws (the paper's fit and its network differ by R0/R) and two viscous ones, each a small frozen object, and one that is
learned from a record. Tests check pressure, derivative and integral of a law against each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

Array = np.ndarray

# Gauss–Legendre nodes for the velocity integral: nine digits more than needed for strains up to 0.5
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class ElasticLaw(Protocol):
    """P_el as a function of the stretch s, for stiffness K = E h/((1 - η²) R0) [Pa] and e = E_NL/E [-], None where all
    of them are 0."""

    @property
    def name(self) -> str:
        """The name in network files."""

    def pressure(self, s: Array, K: Array, e: Array | None) -> Array:
        """P_el(s) [Pa]; zero at s = 1."""

    def derivative(self, s: Array, K: Array, e: Array | None) -> Array:
        """dP_el/ds [Pa]."""

    def stretch(self, P: Array, K: Array, e: Array | None) -> Array:
        """s with P_el(s) = P; NaN where no wall can carry P."""

    def energy(self, s: Array, K: Array, e: Array) -> Array:
        """∫₁ˢ P_el s ds [Pa]; 2 A0 times it is the stored energy per length ∫ P_el dA."""

    def simple_wave(self, s: Array, c0: Array) -> Array:
        """w = ∫ c/A dA from A0 [m/s] when e = 0, in closed form; c0 is the wave speed at s = 1."""

    def columns(self, R: Array) -> tuple[Array, Array, Array]:
        """Functions of R of which P_el is a linear combination whatever E, R0 and E_NL; the last one for E_NL only."""

    def solve(self, c: Array) -> tuple[float, float, float]:
        """K [Pa], R0 [m] and e of the combination P_el = Σ cᵢ columnᵢ; NaN where no wall has it."""


@dataclass(frozen=True)
class Beta:
    """P_el = K (ε + e ε²): the network's law β(√A - √A0) of `sheep_constitutive`, β = √π E h/((1-η²) A0), K = β √A0."""

    name: str = "beta"

    def pressure(self, s: Array, K: Array, e: Array | None) -> Array:
        strain = s - 1.0
        P = K * strain
        return P if e is None else P * (1.0 + e * strain)

    def derivative(self, s: Array, K: Array, e: Array | None) -> Array:
        return K if e is None else K * (1.0 + 2.0 * e * (s - 1.0))

    def stretch(self, P: Array, K: Array, e: Array | None) -> Array:
        p = P / K
        with np.errstate(invalid="ignore"):  # a wall that softens bears no more than -K/(4 e)
            s = 1.0 + (p if e is None else 2.0 * p / (1.0 + np.sqrt(1.0 + 4.0 * e * p)))
        return np.where(s > 0.0, s, np.nan)  # below -K the vessel has collapsed

    def energy(self, s: Array, K: Array, e: Array) -> Array:
        x = s - 1.0
        return K * x * x * (0.5 + (1.0 + e) * x / 3.0 + e * x * x / 4.0)

    def simple_wave(self, s: Array, c0: Array) -> Array:
        return 4.0 * c0 * (np.sqrt(s) - 1.0)  # 4 (c - c0)

    def columns(self, R: Array) -> tuple[Array, Array, Array]:
        return np.ones_like(R), R, R * R

    def solve(self, c: Array) -> tuple[float, float, float]:
        # K (e - 1), K (1 - 2e)/R0, K e/R0²: R0 is where P_el vanishes
        R0 = _root(c[2], c[1], c[0])
        K = c[1] * R0 + 2.0 * c[2] * R0 * R0
        return K, R0, c[2] * R0 * R0 / K


@dataclass(frozen=True)
class Regression:
    """P_el = K (ε + e ε²)/s: the law of `sheep_pressure_radius`, E h/(1-η²) (1/R0 - 1/R) when e = 0."""

    name: str = "regression"

    def pressure(self, s: Array, K: Array, e: Array | None) -> Array:
        strain = s - 1.0
        P = K * strain
        return (P if e is None else P * (1.0 + e * strain)) / s

    def derivative(self, s: Array, K: Array, e: Array | None) -> Array:
        # d/ds [(ε + e ε²)/s] = (1 + e (s² - 1))/s²
        return (K if e is None else K * (1.0 + e * (s * s - 1.0))) / (s * s)

    def stretch(self, P: Array, K: Array, e: Array | None) -> Array:
        # K (ε + e ε²) = P (1 + ε): the root that vanishes with P; none for P >= K when e = 0
        b = K - P
        with np.errstate(invalid="ignore"):  # a wall that softens bears no more than K (1 - 2 e - 2 √(e² - e))
            root = 2.0 * b if e is None else b + np.sqrt(b * b + 4.0 * K * e * P)
        return np.where(root > 0.0, 1.0 + 2.0 * P / np.where(root > 0.0, root, 1.0), np.nan)

    def energy(self, s: Array, K: Array, e: Array) -> Array:
        x = s - 1.0
        return K * x * x * (0.5 + e * x / 3.0)

    def simple_wave(self, s: Array, c0: Array) -> Array:
        return 4.0 * c0 * (1.0 - 1.0 / np.sqrt(s))  # 4 (c0 - c)

    def columns(self, R: Array) -> tuple[Array, Array, Array]:
        return np.ones_like(R), 1.0 / R, R

    def solve(self, c: Array) -> tuple[float, float, float]:
        # K (1 - 2e), K (e - 1) R0, K e/R0: R0 is where P_el vanishes
        R0 = _root(c[2], c[0], c[1])
        K = c[0] + 2.0 * c[2] * R0
        return K, R0, c[2] * R0 / K


def _root(a: float, b: float, c: float) -> float:
    """The root of a x² + b x + c with b + 2 a x > 0, where pressure rises with radius: -c/b when a = 0; NaN if none."""
    discriminant = b * b - 4.0 * a * c
    if discriminant < 0.0:
        return math.nan
    denominator = b + math.sqrt(discriminant)
    if b > 0.0 and denominator > 0.0:
        return -2.0 * c / denominator  # without cancellation where a is small
    return (-b + math.sqrt(discriminant)) / (2.0 * a) if a != 0.0 else math.nan


ELASTIC_LAWS: dict[str, ElasticLaw] = {law.name: law for law in (Beta(), Regression())}


def wave_speed(law: ElasticLaw, s: Array, K: Array, e: Array | None, rho: Array) -> Array:
    """Elastic wave speed c = √(A/ρ dP/dA) = √(s/(2ρ) dP_el/ds) [m/s]; NaN where the law is not stable."""
    return np.sqrt(s / (2.0 * rho) * law.derivative(s, K, e))


def riemann_velocity(law: ElasticLaw, s: Array, K: Array, e: Array, rho: Array) -> Array:
    """w = ∫ c/A dA from A0 to A0 s² [m/s], the velocity behind a simple wave.

    w = ∫₁ˢ √(2 (dP_el/ds)/(ρ s)) ds, by Gauss–Legendre quadrature. Equals 4 (c - c0) for the β-law and 4 (c0 - c)
    for the regression law, both without E_NL.
    """
    half = 0.5 * (s - 1.0)[..., None]
    x = 1.0 + half * (1.0 + _NODES)
    slope = law.derivative(x, K[..., None], e[..., None])
    integrand = np.sqrt(2.0 * slope / (np.expand_dims(rho, -1) * x))
    return half[..., 0] * (integrand @ _WEIGHTS)


class ViscousLaw(Protocol):
    """σ_v(ε̇) = φ0 ε̇ factor(r ε̇) [Pa], r = φ_NL/φ0 [s]; ``factor`` is exactly 1 where r ε̇ = 0."""

    @property
    def name(self) -> str:
        """The name in network files."""

    def factor(self, x: Array) -> Array:
        """σ_v/(φ0 ε̇) at x = r ε̇."""

    def slope(self, x: Array) -> Array:
        """dσ_v/dε̇ / φ0 at x = r ε̇: the effective viscosity, which must stay positive."""

    def bend(self, x: Array) -> Array:
        """d factor/dx at x = r ε̇: ∂σ_v/∂φ_NL / ε̇²."""


@dataclass(frozen=True)
class Quadratic:
    """σ_v = φ0 ε̇ + φ_NL ε̇² (`eq:general`). Its effective viscosity φ0 (1 + 2 r ε̇) changes sign at ε̇ = -1/(2r)."""

    name: str = "quadratic"

    def factor(self, x: Array) -> Array:
        return 1.0 + x

    def slope(self, x: Array) -> Array:
        return 1.0 + 2.0 * x

    def bend(self, x: Array) -> Array:
        return np.ones_like(x)


@dataclass(frozen=True)
class Monotone:
    """σ_v = φ0 (e^{2rε̇} - 1)/(2r): the paper's to second order, with effective viscosity φ0 e^{2rε̇} > 0."""

    name: str = "monotone"

    def factor(self, x: Array) -> Array:
        y = 2.0 * x
        zero = y == 0.0
        return np.where(zero, 1.0, np.expm1(y) / np.where(zero, 1.0, y))

    def slope(self, x: Array) -> Array:
        return np.exp(2.0 * x)

    def bend(self, x: Array) -> Array:
        # (e^{2x} - factor)/x cancels near 0: there its series 1 + 4x/3 + x² + 8x³/15 + 2x⁴/9
        near = np.abs(x) < 1e-2
        series = 1.0 + x * (4.0 / 3.0 + x * (1.0 + x * (8.0 / 15.0 + x * (2.0 / 9.0))))
        return np.where(near, series, (self.slope(x) - self.factor(x)) / np.where(near, 1.0, x))


VISCOUS_LAWS: dict[str, ViscousLaw] = {law.name: law for law in (Quadratic(), Monotone())}


@dataclass(frozen=True)
class LearnedStress:
    """An additional viscous stress with a form learned from a record, added to that of the viscous law:

        σ_L = (rise u + fall (1 - u)) ε̇ + cubic ε̇³ + friction tanh(4 ε̇/rate),    u = (ε - low)/span

    Outside the learned range it is extrapolated constantly: u is limited to [0, 1], and beyond ±rate the viscosity
    ∂σ_L/∂ε̇ is constant. With non-negative numbers σ_L is odd and does not decrease with ε̇, and σ_L ε̇ >= 0 at any ε: it
    releases no energy over any loop.
    rise, fall [Pa·s]; cubic [Pa·s³]; friction [Pa]; low, span [-]; rate [1/s]; all like the strain.
    """

    rise: Array
    fall: Array
    cubic: Array
    friction: Array
    low: Array
    span: Array
    rate: Array

    def stress(self, strain: Array, rate: Array) -> Array:
        """σ_L [Pa]."""
        x = np.clip(rate, -self.rate, self.rate)
        inside = (self._shear(strain) + self.cubic * x * x) * x + self.friction * np.tanh(_SATURATES * x / self.rate)
        found: Array = inside + self.by_rate(strain, x) * (rate - x)
        return found

    def by_rate(self, strain: Array, rate: Array) -> Array:
        """∂σ_L/∂ε̇ [Pa·s]."""
        x = np.clip(rate, -self.rate, self.rate)
        slope = _SATURATES / self.rate / np.cosh(_SATURATES * x / self.rate) ** 2
        found: Array = self._shear(strain) + 3.0 * self.cubic * x * x + self.friction * slope
        return found

    def by_strain(self, strain: Array, rate: Array) -> Array:
        """∂σ_L/∂ε [Pa]."""
        inside = (strain >= self.low) & (strain <= self.low + self.span)
        return np.where(inside, (self.rise - self.fall) / self.span * rate, 0.0)

    def _shear(self, strain: Array) -> Array:
        u = np.clip((strain - self.low) / self.span, 0.0, 1.0)
        return self.rise * u + self.fall * (1.0 - u)


_SATURATES = 4.0  # rates in the range that it was learned from, after which friction no longer grows
