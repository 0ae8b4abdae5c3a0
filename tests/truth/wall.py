"""The wall's pressure, in the time domain, at any set of points.

    P = P_ref + P_ext + P_el(ε) + (h/((1-η²) R0)) σ_v/s,     s = √(A/A0), ε = s - 1, ε̇ = ∂A/∂t/(2 A0 s)
    beta: P_el = K (ε + e ε²);   regression: P_el = K (ε + e ε²)/s;   K = E h/((1-η²) R0)
    σ_v = (1-w) M[φ0 (1 + cε) ε̇ f] + w φ0 ω1 (iω/ω1)^a ε + φ3 ε̇³ + σ_c tanh(ε̇/ε̇_c),     M: 1/(1 + iωτ)
    quadratic: f = 1 + rε̇;   monotone: f = (e^{2rε̇} - 1)/(2rε̇)

Tone: E, in all walls at once, is E (1 + tone sin(2π (2 t/T_all + phase))) over a record of unlike beats. ε̇_c = 0.05/s.
ω1 is the heart's angular frequency, so that both shares of the viscous stress have one size at the first harmonic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .anatomy import Anatomy, Vessel
from .beat import Beat

Array = np.ndarray

_SMOOTH = 0.05  # [1/s], strain rate within which Coulomb's friction changes sign
_DESCRIBED = 5.0  # [s], viscosity per Coulomb stress that stands for it where the walls are linearised
_CYCLES = 2  # of the tone over a record
_GAUSS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True)
class Walls:
    """Walls at a set of points; every array broadcasts against (…, points, samples)."""

    elastic: str
    viscous: str
    A0: Array
    K: Array
    e: Array
    K_h: Array
    phi0: Array
    r: Array
    tau: Array
    w: Array
    order: Array
    phi3: Array
    c: Array
    coulomb: Array
    P_level: Array
    beat: Beat
    tone: Array | float = 1.0

    def at_rest(self) -> Walls:
        """The same with the mean tone."""
        return replace(self, tone=1.0)

    def elastic_pressure(self, s: Array) -> Array:
        """P_el(s) [Pa]."""
        bent = self.K * self.tone * ((s - 1.0) + self.e * (s - 1.0) ** 2)
        return bent if self.elastic == "beta" else bent / s

    def elastic_slope(self, s: Array) -> Array:
        """dP_el/ds [Pa]."""
        if self.elastic == "beta":
            return self.K * self.tone * (1.0 + 2.0 * self.e * (s - 1.0))
        return self.K * self.tone * (1.0 + self.e * (s * s - 1.0)) / (s * s)

    def rate_stress(self, rate: Array, s: Array) -> Array:
        """φ0 (1 + cε) ε̇ f [Pa]."""
        return self.phi0 * (1.0 + self.c * (s - 1.0)) * rate * self._bend(rate)

    def rate_slopes(self, rate: Array, s: Array) -> tuple[Array, Array]:
        """Its derivatives by ε̇ [Pa s] and ε [Pa]."""
        x = 2.0 * self.r * rate
        slope = 1.0 + x if self.viscous == "quadratic" else np.exp(x)
        return self.phi0 * (1.0 + self.c * (s - 1.0)) * slope, self.phi0 * self.c * rate * self._bend(rate)

    def _bend(self, rate: Array) -> Array:
        """f."""
        x = self.r * rate
        return 1.0 + x if self.viscous == "quadratic" else _exponential(2.0 * x)

    def further_stress(self, rate: Array) -> Array:
        """φ3 ε̇³ and Coulomb's friction [Pa]."""
        return self.phi3 * rate**3 + self.coulomb * np.tanh(rate / _SMOOTH)

    def further_slope(self, rate: Array) -> Array:
        """Their derivative [Pa s]."""
        return 3.0 * self.phi3 * rate**2 + self.coulomb / (_SMOOTH * np.cosh(rate / _SMOOTH) ** 2)

    def memory(self) -> Array:
        """M(ω) (1 - w) : (…, points, K + 1)."""
        return (1.0 - self.w) / (1.0 + 1j * self.beat.omega * self.tau)

    def springpot(self) -> Array:
        """Stress of a unit strain in the springpot's share, w φ0 ω1 (iω/ω1)^a : (…, points, K + 1) [Pa]."""
        relative = 1j * np.arange(self.beat.K + 1) * self.beat.share
        relative[0] = 1.0  # a springpot forgets the mean: set to zero below
        response = self.w * self.phi0 * (self.beat.omega[1] / self.beat.share) * relative**self.order
        response[..., 0] = 0.0
        return response

    def pressure(self, A: Array, A_t: Array) -> Array:
        """P [Pa] of A [m²] and ∂A/∂t [m²/s] : (…, points, samples)."""
        s = np.sqrt(A / self.A0)
        rate = A_t / (2.0 * self.A0 * s)
        stress = self.rate_stress(rate, s)
        if np.any(self.tau) or np.any(self.w):
            stress = self.beat.filtered(stress, self.memory())
        if np.any(self.w):
            stress = stress + self.beat.filtered(s - 1.0, self.springpot())
        if np.any(self.phi3) or np.any(self.coulomb):
            stress = stress + self.further_stress(rate)
        return self.P_level + self.elastic_pressure(s) + self.K_h * stress / s

    def impedance(self, A: Array) -> Array:
        """dP/dA [Pa/m²] per harmonic at rest at A : (…, points, 1); result (…, points, K + 1)."""
        s = np.sqrt(A / self.A0)
        phi0 = self.phi0 * (1.0 + self.c * (s - 1.0)) + _DESCRIBED * self.coulomb
        stress = self.memory() * phi0 * 1j * self.beat.omega + self.springpot()
        return (self.elastic_slope(s) + self.K_h * stress / s) / (2.0 * self.A0 * s)

    def stretch(self, p: Array) -> Array:
        """s with P_el(s) = p [Pa]."""
        if self.elastic == "beta":
            b, c = self.K * self.tone, -p
        else:
            b, c = self.K * self.tone - p, -p
        # K e ε² + b ε + c = 0, the root that is zero with p, written without cancellation
        return 1.0 - 2.0 * c / (b + np.sqrt(b * b - 4.0 * self.K * self.tone * self.e * c))

    def speed_integral(self, s: Array, rho: float) -> Array:
        """w = ∫ c/A dA from A0 = ∫₁ˢ √(2 P_el'/(ρ s)) ds [m/s], as c = √(s P_el'/(2ρ)); 16 Gauss points."""
        half = 0.5 * (s - 1.0)
        return half * sum(
            w * np.sqrt(2.0 * self.elastic_slope(y) / (rho * y))
            for w, y in ((w, 1.0 + half * (1.0 + x)) for x, w in zip(*_GAUSS, strict=True))
        )


def _exponential(y: Array) -> Array:
    """(e^y - 1)/y, 1 at 0."""
    safe = np.where(np.abs(y) < 1e-12, 1.0, y)
    return np.where(np.abs(y) < 1e-12, 1.0, np.expm1(safe) / safe)


def walls_of(model: Anatomy, vessels: list[Vessel], xi: Array, beat: Beat) -> Walls:
    """Walls at positions xi = x/L : (pieces, points) of the vessel of each piece; arrays (pieces, points, 1)."""

    def column(name: str) -> Array:
        return np.array([getattr(v, name) for v in vessels])[:, None, None]

    R0 = column("R0") * (1.0 + column("taper") * (xi[..., None] - 0.5))
    K_h = column("h") / ((1.0 - model.eta**2) * R0)
    return Walls(
        model.elastic_law,
        model.viscous_law,
        A0=np.pi * R0**2,
        K=column("E") * K_h,
        e=column("e"),
        K_h=K_h,
        phi0=column("phi0"),
        r=column("r"),
        tau=column("tau"),
        w=column("springpot"),
        order=column("order"),
        phi3=column("phi3"),
        c=column("c"),
        coulomb=column("coulomb"),
        P_level=model.P_ref + column("P_ext"),
        beat=beat,
        tone=_tone(model, beat),
    )


def _tone(model: Anatomy, beat: Beat) -> Array | float:
    """E over a record, of its mean : (samples,); one beat knows of none."""
    if not model.tone or beat.share == 1.0:
        return 1.0
    return 1.0 + model.tone * np.sin(2.0 * np.pi * (_CYCLES * beat.phase + model.tone_phase))


def wall_at(walls: Walls, piece: int, point: int) -> Walls:
    """The wall at one point, for the load at a vessel's end; arrays (1,)."""

    def pick(x: Array) -> Array:
        return np.broadcast_to(x, walls.A0.shape)[piece, point]

    names = ("A0", "K", "e", "K_h", "phi0", "r", "tau", "w", "order", "phi3", "c", "coulomb", "P_level")
    picked: dict[str, Any] = {name: pick(getattr(walls, name)) for name in names}
    return replace(walls, **picked)
