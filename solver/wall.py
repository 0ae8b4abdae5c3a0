"""The arterial wall: elastic laws, Kelvin–Voigt viscosity and its nonlinear forms.

The wall is written in the stretch s = R/R0 = √(A/A0), with strain ε = s - 1 and strain rate
ε̇ = ∂A/∂t / (2 A0 s). The transmural pressure is (`eq:general`, `sheep_constitutive`)

    P = P_ref + P_el(ε) + K_h/s σ_v(ε̇),    K_h = h/((1 - η²) R0)

Two elastic laws (the paper's fit and its network differ by R0/R) and three viscous stresses exist, each a small frozen
object in a table by name. Pressure, derivative and integral of a law are tied together by tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

Array = np.ndarray

# Gauss–Legendre nodes for the velocity integral: nine digits more than needed for strains up to 0.5
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class ElasticLaw(Protocol):
    """P_el as a function of the stretch s, for stiffness K = E h/((1 - η²) R0) [Pa] and e = E_NL/E [-]."""

    @property
    def name(self) -> str:
        """The name in network files."""

    def pressure(self, s: Array, K: Array, e: Array) -> Array:
        """P_el(s) [Pa]; zero at s = 1."""

    def derivative(self, s: Array, K: Array, e: Array) -> Array:
        """dP_el/ds [Pa]."""

    def stretch(self, P: Array, K: Array, e: Array) -> Array:
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

    def pressure(self, s: Array, K: Array, e: Array) -> Array:
        strain = s - 1.0
        return K * strain * (1.0 + e * strain)

    def derivative(self, s: Array, K: Array, e: Array) -> Array:
        return K * (1.0 + 2.0 * e * (s - 1.0))

    def stretch(self, P: Array, K: Array, e: Array) -> Array:
        p = P / K
        s = 1.0 + 2.0 * p / (1.0 + np.sqrt(1.0 + 4.0 * e * p))
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

    def pressure(self, s: Array, K: Array, e: Array) -> Array:
        strain = s - 1.0
        return K * strain * (1.0 + e * strain) / s

    def derivative(self, s: Array, K: Array, e: Array) -> Array:
        # d/ds [(ε + e ε²)/s] = (1 + e (s² - 1))/s²
        return K * (1.0 + e * (s * s - 1.0)) / (s * s)

    def stretch(self, P: Array, K: Array, e: Array) -> Array:
        # K (ε + e ε²) = P (1 + ε): the root that vanishes with P; none for P >= K when e = 0
        b = K - P
        root = b + np.sqrt(b * b + 4.0 * K * e * P)
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


def wave_speed(law: ElasticLaw, s: Array, K: Array, e: Array, rho: Array) -> Array:
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
    integrand = np.sqrt(2.0 * slope / (np.asarray(rho)[..., None] * x))
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
class Wall:
    """The walls of a set of points: laws, and coefficient arrays that broadcast against A.

    A0 [m²]; K = E h/((1-η²) R0) [Pa]; e = E_NL/E; K_h = h/((1-η²) R0) [-]; phi0 [Pa·s]; r = φ_NL/φ0 [s];
    P_ref [Pa]; rho [kg/m³]. ``nonlinear`` tells whether any r differs from 0, ``bent`` whether any e does.
    tau [s] : relaxation time of the viscous stress, τ dσ_v/dt + σ_v = σ_v(ε̇); leak [m²/(Pa·s)] : what the wall lets
    through per length and pressure. None where no wall has it.

    For a wall with memory :meth:`remembering` gives the law at one instant: its viscous stress is
    weight σ_v(ε̇) + (1 - weight) past, ``past`` : like A [Pa].
    """

    elastic: ElasticLaw
    viscous: ViscousLaw
    A0: Array
    K: Array
    e: Array
    K_h: Array
    phi0: Array
    r: Array
    P_ref: Array
    rho: Array
    nonlinear: bool
    bent: bool
    tau: Array | None = None
    leak: Array | None = None
    weight: Array | None = None
    past: Array | None = None

    def at(self, index: Array | slice) -> Wall:
        """The walls at some of the points: last axis indexed."""
        return self._with(lambda array: np.ascontiguousarray(array[..., index]))

    def shaped(self, shape: tuple[int, ...]) -> Wall:
        """The same walls with the last axis in this shape."""
        return self._with(lambda array: np.ascontiguousarray(array.reshape(*array.shape[:-1], *shape)))

    def _with(self, change: Callable[[Array], Array]) -> Wall:
        held = {name: getattr(self, name) for name in _WALL_ARRAYS}
        changed: dict[str, Any] = {name: change(array) for name, array in held.items() if array is not None}
        return replace(self, **changed)

    @cached_property
    def viscosity_area(self) -> Array:
        """ν_s A = φ0 K_h/2 [Pa·s] (`sheep_constitutive`)."""
        return self.phi0 * self.K_h / 2.0

    @cached_property
    def c0(self) -> Array:
        """Wave speed at R0 [m/s]: c0² = K/(2ρ), 2Eh/(3ρR0) for η = 1/2."""
        return np.sqrt(self.K / (2.0 * self.rho))

    def pressure(self, A: Array, A_t: Array) -> Array:
        """P [Pa] = P_ref + P_el + ν_s ∂A/∂t + ν_NL (∂A/∂t)² (`sheep_constitutive`), with A_t = ∂A/∂t [m²/s]."""
        s = np.sqrt(A / self.A0)
        P = self.elastic.pressure(s, self.K, self.e)
        P += self.P_ref
        viscous = self.viscosity_area * A_t / A
        if self.nonlinear:
            viscous = viscous * self.viscous.factor(self.r * self.strain_rate(A, A_t))
        if self.past is not None:
            viscous = self.weight * viscous + self._faded(s)
        P += viscous
        return P

    def remembering(self, past: Array, theta: float) -> Wall:
        """The wall of a moment: θ [s] ago its viscous stress was ``past`` [Pa], and ε̇ has been since what it is now.

        σ_v = past + θ (σ_v(ε̇) - σ_v)/τ: exactly the stress without memory where τ = 0. Itself where no wall has one.
        """
        if self.tau is None:
            return self
        off = self.forgets
        return replace(self, past=past, weight=np.where(off, 1.0, theta / np.where(off, 1.0, self.tau + theta)))

    def viscous_stress(self, A: Array, A_t: Array) -> Array:
        """σ_v [Pa]: φ0 ε̇ with the nonlinear factor, and memory if the wall is one of a moment."""
        rate = self.strain_rate(A, A_t)
        stress = self.phi0 * rate
        if self.nonlinear:
            stress = stress * self.viscous.factor(self.r * rate)
        if self.past is None or self.weight is None:
            return stress
        return self.weight * stress + (1.0 - self.weight) * self.past

    def carried(self, A: Array, A_t: Array) -> Array:
        """The stress [Pa] that a wall with memory carries on; (len(A), 0) where no wall has one."""
        return np.zeros((len(A), 0)) if self.tau is None else self.viscous_stress(A, A_t)

    def _faded(self, s: Array) -> Array:
        """What memory adds to P [Pa]: K_h/s of the stress that is left of the past; exactly 0 without memory."""
        assert self.weight is not None and self.past is not None
        return (1.0 - self.weight) * self.K_h / s * self.past

    def differs(self, other: Wall) -> Array:
        """(n,) where any number of a wall is another one, of two sets of n walls."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in _WALL_ARRAYS)
        return np.any([np.any(a != b, axis=0) for a, b in pairs if a is not None], axis=0)

    @property
    def remembers(self) -> bool:
        """Whether the viscous stress of any wall has a memory."""
        return self.tau is not None

    @property
    def forgets(self) -> Array | bool:
        """Where the viscous stress has no memory, like A0."""
        return self.tau is None or self.tau == 0.0

    def memory(self, iw: Array) -> Array:
        """σ_v over that of a wall without memory, 1/(1 + iωτ), at iω : (n, 1) [1/s]; (B, n, n_points), or 1."""
        return np.ones((1, 1, 1)) if self.tau is None else 1.0 / (1.0 + iw * self.tau[..., None, :])

    @property
    def leaks(self) -> bool:
        """Whether any wall lets something through."""
        return self.leak is not None

    @property
    def leakage(self) -> Array:
        """What the walls let through per length and pressure [m²/(Pa·s)], like A0."""
        return np.zeros_like(self.A0) if self.leak is None else self.leak

    def stiffness(self, A: Array) -> Array:
        """dP_el/dA [Pa/m²]."""
        s = np.sqrt(A / self.A0)
        return self.elastic.derivative(s, self.K, self.e) / (2.0 * self.A0 * s)

    def viscosity(self, A: Array, A_t: Array) -> Array:
        """∂P/∂(∂A/∂t) [Pa·s/m²]: ν_s + 2 ν_NL ∂A/∂t for the paper's law."""
        nu_s = self.viscosity_area / A
        if self.past is not None:
            nu_s = nu_s * self.weight
        return nu_s * self.relative_viscosity(A, A_t) if self.nonlinear else nu_s

    def viscous_slope(self, A: Array, A_t: Array) -> Array:
        """∂P/∂A [Pa/m²] of the viscous part at fixed ∂A/∂t, where x = r ε̇ falls with √A.

        ∂(factor(x)/A)/∂A = -(factor + x factor'/2)/A² = -(factor + slope)/(2A²), since slope = factor + x factor'.
        """
        nu_s = self.viscosity_area / A
        if self.past is not None:
            nu_s = nu_s * self.weight
        if self.nonlinear:
            x = self.r * self.strain_rate(A, A_t)
            nu_s = nu_s * (self.viscous.factor(x) + self.viscous.slope(x)) / 2.0
        slope = -nu_s * A_t / A
        return slope if self.past is None else slope - 0.5 * self._faded(np.sqrt(A / self.A0)) / A

    def relative_viscosity(self, A: Array, A_t: Array) -> Array:
        """Effective viscosity dσ_v/dε̇ / φ0 [-], which must stay positive."""
        return self.viscous.slope(self.r * self.strain_rate(A, A_t))

    def strain_rate(self, A: Array, A_t: Array) -> Array:
        """ε̇ = ∂A/∂t / (2 √(A A0)) [1/s]."""
        return A_t / (2.0 * np.sqrt(A * self.A0))

    def area(self, P: Array) -> Array:
        """A [m²] with P_ref + P_el(A) = P; NaN where no wall can carry P."""
        s = self.elastic.stretch(P - self.P_ref, self.K, self.e)
        return self.A0 * s * s

    def wave_speed(self, A: Array) -> Array:
        """c [m/s] at area A."""
        return wave_speed(self.elastic, np.sqrt(A / self.A0), self.K, self.e, self.rho)

    def riemann_velocity(self, A: Array) -> Array:
        """w = ∫ c/A dA from A0 to A [m/s], the velocity behind a simple wave."""
        s = np.sqrt(A / self.A0)
        simple = self.elastic.simple_wave(s, self.c0)
        if not self.bent:
            return simple
        # where e = 0 the closed form stays, so that E_NL = 0 is the model without E_NL to the last bit
        return np.where(self.e == 0.0, simple, riemann_velocity(self.elastic, s, self.K, self.e, self.rho))


_WALL_ARRAYS = ("A0", "K", "e", "K_h", "phi0", "r", "P_ref", "rho", "tau", "leak", "weight", "past")
