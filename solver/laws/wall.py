"""The arterial wall: elastic laws, Kelvin–Voigt viscosity and its nonlinear forms, and the memory of its stress.

The wall is written in the stretch s = R/R0 = √(A/A0), with strain ε = s - 1 and strain rate
ε̇ = ∂A/∂t / (2 A0 s). The transmural pressure is (`eq:general`, `sheep_constitutive`)

    P = P_ref + P_el(ε) + K_h/s σ_v(ε̇),    K_h = h/((1 - η²) R0)

:mod:`~solver.laws.wall_laws` defines P_el and σ_v. A stress with a memory is that of Maxwell elements in parallel,

    σ_v = Σ share_j σ_j,     τ_j dσ_j/dt + σ_j = φ0 ε̇

In the first element the stress of the viscous law replaces φ0 ε̇; the others are linear. An element with τ = 0
is a damper. Source: R. M. Christensen, Theory of Viscoelasticity (2nd ed. 1982), ch. 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from .wall_laws import ElasticLaw, LearnedStress, ViscousLaw, riemann_velocity, wave_speed

Array = np.ndarray

_USUAL = 0.1  # s: typical duration of a strain rate in a heart beat


def weights(tau: Array, theta: Any) -> Array:
    """Share of the stress that elements with relaxation times τ reach under a rate that lasts θ [s]: θ/(τ + θ).

    1/(1 + iωτ) for θ = 1/iω, and exactly 1 where τ = 0.
    """
    off = tau == 0.0
    return np.where(off, 1.0, theta / (np.where(off, 1.0, tau) + theta))


@dataclass(frozen=True)
class Moment:
    """The elements at the end of an implicit stage: σ_v = direct σ_law + linear φ0 ε̇ + faded.

    weight [-], rest [Pa] : (m, …) of each element, σ_j = weight_j (its stress without memory) + rest_j.
    direct, linear [-], faded [Pa] : (…) their sums.
    """

    weight: Array
    rest: Array
    direct: Array
    linear: Array
    faded: Array

    @classmethod
    def of(cls, tau: Array, share: Array, past: Array, theta: Any) -> Moment:
        """θ [s] after the stresses were ``past`` : (m, …) [Pa], by one backward Euler step, implicit in the
        relaxation."""
        weight = weights(tau, theta)
        rest, shared = (1.0 - weight) * past, share * weight
        return cls(weight, rest, shared[0], shared[1:].sum(axis=0), (share * rest).sum(axis=0))

    @classmethod
    def present(cls, stress: Array) -> Moment:
        """A moment with known stress σ_v : (…) [Pa], independent of the strain rate."""
        none = np.zeros((1, 1))
        return cls(none[None], stress[None], none, none, stress)


@dataclass(frozen=True)
class Wall:
    """The walls of a set of points: laws, and coefficient arrays that broadcast against A.

    A0 [m²]; K = E h/((1-η²) R0) [Pa]; e = E_NL/E; K_h = h/((1-η²) R0) [-]; phi0 [Pa·s]; r = φ_NL/φ0 [s];
    P_ref [Pa]; rho [kg/m³]. ``nonlinear``: whether any r differs from 0; ``bent``: whether any e does.
    leak [m²/(Pa·s)] : leakage per length and pressure. tau [s], share [-] : (m, …) relaxation times and shares of the
    elements of the viscous stress. learned : (7, …) the numbers of
    :class:`~solver.laws.wall_laws.LearnedStress`, which adds to the stress of the viscous law. None if no wall has it.

    For a wall with memory :meth:`remembering` gives the law at one instant; its ``moment`` contains the past stress.
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
    leak: Array | None = None
    tau: Array | None = None
    share: Array | None = None
    learned: Array | None = None
    moment: Moment | None = None

    # the axis of the members of a batch, if it is not the first
    MEMBER_AXIS: ClassVar[Mapping[str, int | None]] = {"tau": 1, "share": 1, "learned": 1}

    def at(self, index: Array | slice) -> Wall:
        """The walls at some of the points: last axis indexed."""
        return self._with(lambda array: array[..., index].copy())

    def picked(self, member: Array | int, index: Array) -> Wall:
        """The walls at points : (B, n) of members that broadcast against it."""
        return self._with(lambda array: array[..., member, index])

    def shaped(self, shape: tuple[int, ...]) -> Wall:
        """The same walls with the last axis in this shape."""
        return self._with(lambda array: array.reshape(*array.shape[:-1], *shape).copy())

    def _with(self, change: Callable[[Array], Array]) -> Wall:
        arrays = {name: getattr(self, name) for name in _WALL_ARRAYS}
        changed: dict[str, Any] = {name: change(array) for name, array in arrays.items() if array is not None}
        return replace(self, **changed)

    @property
    def bend(self) -> Array | None:
        """e, or None if all walls have e = 0: the laws are then shorter, and identical to the last bit."""
        return self.e if self.bent else None

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
        P = self.elastic.pressure(s, self.K, self.bend)
        P += self.P_ref
        viscous = self.viscosity_area * A_t / A
        if self.nonlinear or self.moment is not None:
            viscous = viscous * self._weighted(self._factor(A, A_t))
        if self.moment is not None:
            viscous += self.K_h / s * self.moment.faded
        if self.learned is not None:
            viscous += self.K_h / s * self._kept * self._further.stress(s - 1.0, self.strain_rate(A, A_t))
        P += viscous
        return P

    def viscous_stress(self, A: Array, A_t: Array) -> Array:
        """σ_v [Pa] of a wall without memory: φ0 ε̇ with the nonlinear factor."""
        rate = self.strain_rate(A, A_t)
        stress = self.phi0 * rate
        stress = stress * self._factor(A, A_t) if self.nonlinear else stress
        return stress if self.learned is None else stress + self._further.stress(np.sqrt(A / self.A0) - 1.0, rate)

    @property
    def _further(self) -> LearnedStress:
        assert self.learned is not None
        return LearnedStress(*self.learned)

    @property
    def _kept(self) -> Array | float:
        """The weight of the viscous law's stress at this moment."""
        return 1.0 if self.moment is None else self.moment.direct

    def stress_by_strain(self, A: Array, A_t: Array) -> Array | float:
        """∂σ_v/∂ε [Pa] of a wall without memory at fixed ε̇."""
        if self.learned is None:
            return 0.0
        return self._further.by_strain(np.sqrt(A / self.A0) - 1.0, self.strain_rate(A, A_t))

    def _factor(self, A: Array, A_t: Array) -> Array | float:
        return self.viscous.factor(self.r * self.strain_rate(A, A_t)) if self.nonlinear else 1.0

    def _weighted(self, of_law: Array | float) -> Array | float:
        """The weighted sum of the viscous law and of φ0 ε̇ at this moment."""
        return of_law if self.moment is None else self.moment.direct * of_law + self.moment.linear

    # --- memory ---------------------------------------------------------------------------------------------------

    @property
    def remembers(self) -> bool:
        """Whether the viscous stress of any wall has a memory."""
        return self.tau is not None

    @property
    def elements(self) -> tuple[Array, Array]:
        """τ [s] and shares : (m, …) of the elements of the viscous stress; one damper where no wall has a memory."""
        if self.tau is None or self.share is None:
            return np.zeros((1, *self.A0.shape)), np.ones((1, *self.A0.shape))
        return self.tau, self.share

    @property
    def forgets(self) -> Array:
        """Where the viscous stress has no memory, like A0."""
        tau, share = self.elements
        none: Array = (tau[0] == 0.0) & (share[0] == 1.0) & np.all(share[1:] == 0.0, axis=0)
        return none

    def remembering(self, past: Array, theta: float) -> Wall:
        """The wall at an instant: θ [s] ago the stresses of its elements were ``past`` : (m, …) [Pa], and ε̇ has been
        constant since. The wall itself if no wall has memory."""
        if not self.remembers:
            return self
        return replace(self, moment=Moment.of(*self.elements, past, theta))

    def stresses(self, A: Array, A_t: Array) -> Array:
        """The stress [Pa] of every element if it had no memory : (m, …)."""
        linear = self.phi0 * self.strain_rate(A, A_t)
        return np.stack([self.viscous_stress(A, A_t), *[linear] * (len(self.elements[0]) - 1)])

    def carried(self, A: Array, A_t: Array) -> Array:
        """The stresses [Pa] that the elements of walls with memory carry on : (m, …), m = 0 where no wall has one.

        If the past is unknown, it is assumed to be that of a strain that varies as in a heart beat.
        """
        if not self.remembers:
            return np.zeros((0, *A.shape))
        now = self.stresses(A, A_t)
        if self.moment is None:
            return weights(self.elements[0], _USUAL) * now
        return self.moment.weight * now + self.moment.rest

    def combined(self, stresses: Array) -> Array:
        """σ_v [Pa] of the stresses of the elements : (m, …)."""
        stress: Array = (self.elements[1] * stresses).sum(axis=0)
        return stress

    def responses(self, iw: Array) -> Array:
        """σ_v of every element over its stress without memory, share/(1 + iωτ), at iω : (n, 1) [1/s];
        (m, B, n, n_points)."""
        tau, share = self.elements
        return share[:, :, None] / (1.0 + iw * tau[:, :, None])

    def loss(self, A: Array, omega: Array) -> Array:
        """Re ∂P/∂(∂A/∂t) [Pa·s/m²] of small waves of frequency ω [1/s] about A, like A."""
        tau, share = self.elements
        found: Array = self.viscosity(A, np.zeros_like(A)) * (share / (1.0 + (omega * tau) ** 2)).sum(axis=0)
        return found

    def differs(self, other: Wall) -> Array:
        """(n,) where two sets of n walls differ in any number."""
        pairs = ((getattr(self, name), getattr(other, name)) for name in _WALL_ARRAYS)
        return np.any([np.any(a != b, axis=tuple(range(a.ndim - 1))) for a, b in pairs if a is not None], axis=0)

    def varies(self, n: int) -> bool:
        """Whether any of n walls is not the same at all places, of walls by place: (places · n) points."""
        arrays = (getattr(self, name) for name in _WALL_ARRAYS)
        return any((a.reshape(*a.shape[:-1], -1, n) != a[..., None, :n]).any() for a in arrays if a is not None)

    @property
    def learns(self) -> bool:
        """Whether any wall has a learned stress."""
        return self.learned is not None

    @property
    def leaks(self) -> bool:
        """Whether any wall leaks."""
        return self.leak is not None

    @property
    def leakage(self) -> Array:
        """The leakage of the walls per length and pressure [m²/(Pa·s)], like A0."""
        return np.zeros_like(self.A0) if self.leak is None else self.leak

    def stiffness(self, A: Array) -> Array:
        """dP_el/dA [Pa/m²]."""
        s = np.sqrt(A / self.A0)
        return self.elastic.derivative(s, self.K, self.bend) / (2.0 * self.A0 * s)

    def viscosity(self, A: Array, A_t: Array) -> Array:
        """∂P/∂(∂A/∂t) [Pa·s/m²]: ν_s + 2 ν_NL ∂A/∂t for the paper's law."""
        nu_s = self.viscosity_area / A
        if self.nonlinear or self.moment is not None:
            nu_s = nu_s * self._weighted(self.relative_viscosity(A, A_t) if self.nonlinear else 1.0)
        if self.learned is not None:
            further = self._further.by_rate(np.sqrt(A / self.A0) - 1.0, self.strain_rate(A, A_t))
            nu_s = nu_s + self.K_h * self._kept * further / (2.0 * A)
        return nu_s

    def viscous_slope(self, A: Array, A_t: Array) -> Array:
        """∂P/∂A [Pa/m²] of the viscous part at fixed ∂A/∂t, where x = r ε̇ falls with √A.

        ∂(factor(x)/A)/∂A = -(factor + x factor'/2)/A² = -(factor + slope)/(2A²), since slope = factor + x factor'.
        """
        nu_s = self.viscosity_area / A
        if self.nonlinear:
            x = self.r * self.strain_rate(A, A_t)
            nu_s = nu_s * self._weighted((self.viscous.factor(x) + self.viscous.slope(x)) / 2.0)
        elif self.moment is not None:
            nu_s = nu_s * self._weighted(1.0)
        slope = -nu_s * A_t / A
        if self.moment is not None:
            slope -= 0.5 * self.K_h / np.sqrt(A / self.A0) * self.moment.faded / A
        if self.learned is not None:  # ds/dA = s/(2 A), and ε̇ falls as 1/s
            s, rate = np.sqrt(A / self.A0), self.strain_rate(A, A_t)
            law = self._further
            change = s * law.by_strain(s - 1.0, rate) - rate * law.by_rate(s - 1.0, rate) - law.stress(s - 1.0, rate)
            slope += 0.5 * self.K_h / s * self._kept * change / A
        return slope

    def relative_viscosity(self, A: Array, A_t: Array) -> Array:
        """Effective viscosity dσ_v/dε̇ / φ0 [-], which must stay positive."""
        return self.viscous.slope(self.r * self.strain_rate(A, A_t))

    def strain_rate(self, A: Array, A_t: Array) -> Array:
        """ε̇ = ∂A/∂t / (2 √(A A0)) [1/s]."""
        return A_t / (2.0 * np.sqrt(A * self.A0))

    def area(self, P: Array) -> Array:
        """A [m²] with P_ref + P_el(A) = P; NaN where no wall can carry P."""
        s = self.elastic.stretch(P - self.P_ref, self.K, self.bend)
        return self.A0 * s * s

    def wave_speed(self, A: Array) -> Array:
        """c [m/s] at area A."""
        return wave_speed(self.elastic, np.sqrt(A / self.A0), self.K, self.bend, self.rho)

    def riemann_velocity(self, A: Array) -> Array:
        """w = ∫ c/A dA from A0 to A [m/s], the velocity behind a simple wave."""
        return self._velocity_at(np.sqrt(A / self.A0))

    def riemann_flow(self, P: Array) -> Array:
        """A w [m³/s], the flow behind a simple wave, where P_ref + P_el(A) = P; NaN where no wall can carry P."""
        s = self.elastic.stretch(P - self.P_ref, self.K, self.bend)
        return self.A0 * s * s * self._velocity_at(s)

    def _velocity_at(self, s: Array) -> Array:
        simple = self.elastic.simple_wave(s, self.c0)
        if not self.bent:
            return simple
        # where e = 0 the closed form stays, so that E_NL = 0 is the model without E_NL to the last bit
        return np.where(self.e == 0.0, simple, riemann_velocity(self.elastic, s, self.K, self.e, self.rho))


_WALL_ARRAYS = ("A0", "K", "e", "K_h", "phi0", "r", "P_ref", "rho", "leak", "tau", "share", "learned")
