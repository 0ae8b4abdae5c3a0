"""Physiological indices of a fitted wall: stiffness, distensibility, wave velocity, losses, with 95 % intervals.

All are at the mean pressure of the beat, from the elastic part of the law (dP/dA, dP/dR below are of P_el), so they do
not depend on the strain rate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import ndtri

from solver.errors import InputError
from solver.laws.wall import Wall
from solver.network.description import Segment
from solver.quantities.legible import rounded
from solver.quantities.quantity import quantities
from solver.quantities.units import readable

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients
from ..results.estimate import Estimate, mixture
from .site_fit import without_lag
from .wall_fit import WallFit

Values = Mapping[str, float]

_STEP = 1e-5  # relative, of the central differences: their error is then 1e-10
_ABOVE_NOISE = 3.0  # standard deviations: threshold for harmonics of a measured loop


def read_in(unit: str) -> tuple[str, float]:
    """The display unit of an index, and its factor from SI; an index in Pa is a modulus."""
    return readable(unit, "MPa" if unit == "Pa" else None)


def modulus(estimate: Estimate) -> str:
    """ "0.29108 MPa (0.29089 to 0.29127)"."""
    unit, factor = read_in(estimate.unit)
    half = 0.5 * factor * (estimate.ci95[1] - estimate.ci95[0])
    value, low, high = (rounded(factor * x, half) for x in (estimate.value, *estimate.ci95))
    return f"{value} {unit} ({low} to {high})"


def indices(fit: WallFit, beats: Beats, rho: float = 1060.0) -> dict[str, Estimate]:
    """The indices of a site, by name. rho : density of blood [kg/m³].

    ====================  ====================================================================================
    E_inc                 (1 - η²) (R²/h) dP/dR [Pa], incremental elastic modulus; thin wall, isotropic (Bergel 1961);
                          h is the unstressed thickness, as in the wall law
    distensibility        D = (1/A) dA/dP [1/Pa]
    compliance            dA/dP [m²/Pa], per length of vessel
    wave_velocity         c = √(A/ρ dP/dA) = 1/√(ρ D) [m/s] (Bramwell and Hill 1922)
    loss                  ∮ P dA [J/m], energy lost in a beat per length of vessel; of the fitted law
    loss_measured         the same of the mean beats of P and R themselves, by harmonics above their noise
    loss_ratio            loss over the pulse's stored energy ∫ (P_el - P_el(A_min)) dA from A_min to A_max [-];
                          (π/2) tan δ for a small sine with loss angle δ
    relaxation_time       φ0/E [s]
    ====================  ====================================================================================

    Intervals follow from the fit's covariance by the delta method (derivatives by central differences), with the loop
    and its mean pressure treated as exact, averaged over the fitted elastic laws; that of loss_measured from the noise
    of the harmonics.
    Raises ValueError if the beats lack the site's channels, or the fitted wall cannot carry their mean pressure.
    Sources: D. H. Bergel, J. Physiol. 156 (1961) 445; J. C. Bramwell and A. V. Hill, Proc. R. Soc. B 93 (1922) 298.
    """
    P_mean = float(beats.mean(f"{fit.site}.P").mean())
    weighted = [(p, *_with_sd(law, P_mean, rho), law.dof) for p, law in fit.laws]
    of_law = {name: _averaged(weighted, i) for i, (name, _) in enumerate(OF_LAW)}
    return of_law | {"loss_measured": measured_loss(without_lag(beats, fit), fit.site)}


def E_inc(fit: WallFit) -> Estimate:
    """The incremental elastic modulus of :func:`indices`, at the mean pressure of the loop that was fitted."""
    P_mean = float(fit.loop.P.mean())
    return _averaged([(p, *_with_sd(law, P_mean, 1.0), law.dof) for p, law in fit.laws], 0)


def _averaged(weighted: Sequence[tuple[float, Array, Array, int]], i: int) -> Estimate:
    """One of ``OF_LAW`` by the first law, with the interval by all: probability, values, deviations, their freedom."""
    interval = mixture([(p, float(x[i]), float(sd[i]), n) for p, x, sd, n in weighted])
    return Estimate(float(weighted[0][1][i]), OF_LAW[i][1], interval)


def _with_sd(fit: WallFit, P_mean: float, rho: float) -> tuple[Array, Array]:
    """The indices of ``OF_LAW`` by one law, and their standard deviations."""
    made = _of_law(fit, P_mean, rho)
    value = made(fit.values)
    if not np.isfinite(value).all():
        raise InputError(
            f"site {fit.site}: the fitted wall cannot carry the mean pressure of {P_mean:g} Pa; fit it to these beats."
        )
    slope = _slope(fit, made)
    return value, np.sqrt(np.einsum("ip,pq,iq->i", slope, fit.covariance, slope))


# name, unit of the indices that the wall law has
OF_LAW = (
    ("E_inc", "Pa"),
    ("distensibility", "1/Pa"),
    ("compliance", "m^2/Pa"),
    ("wave_velocity", "m/s"),
    ("loss", "J/m"),
    ("loss_ratio", "1"),
    ("relaxation_time", "s"),
)


def of_wall(wall: Wall, A: Array, loss: Array, ends: tuple[Array, Array]) -> Array:
    """The indices of ``OF_LAW`` of some walls, as the last axis.

    A : area of evaluation [m²]. loss : ∮ P dA [J/m]. ends : smallest and largest area of the beat [m²].
    """
    stiffness = wall.stiffness(A)  # dP/dA = dP/dR/(2πR)
    s_low, s_high = (np.sqrt(end / wall.A0) for end in ends)
    law, K, e = wall.elastic, wall.K, wall.e
    stored = 2.0 * wall.A0 * (law.energy(s_high, K, e) - law.energy(s_low, K, e))
    stored = stored - law.pressure(s_low, K, e) * (ends[1] - ends[0])
    # (1 - η²) R²/h dP/dR = R²/(K_h R0) 2πR dP/dA
    E_inc = 2.0 * A * np.sqrt(A / wall.A0) * stiffness / wall.K_h
    relaxation = wall.phi0 * wall.K_h / wall.K
    found = (E_inc, 1.0 / (A * stiffness), 1.0 / stiffness, wall.wave_speed(A), loss, loss / stored, relaxation)
    return np.stack(np.broadcast_arrays(*found), axis=-1)


def estimates(values: Array, half: Array) -> dict[str, Estimate]:
    """The indices of ``OF_LAW`` by name; values, half of their intervals : (7,)."""
    return {
        name: Estimate(float(x), unit, (float(x - d), float(x + d)))
        for (name, unit), x, d in zip(OF_LAW, values, half, strict=True)
    }


def plain(found: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    """Indices of a site, ready for JSON: value and 95 % interval in SI, unit."""
    return {name: x.plain for name, x in found.items()}


def _of_law(fit: WallFit, P_mean: float, rho: float) -> Callable[[Values], Array]:
    """The indices of ``OF_LAW`` as a function of the wall's parameters, on the fitted loop."""
    R, R_t, T = fit.solution.R, fit.solution.R_t, fit.loop.T
    A, A_t = np.pi * R * R, 2.0 * np.pi * R * R_t

    def made(values: Values) -> Array:
        wall = fit.wall(values, rho)
        loss = T * np.mean(wall.pressure(A, A_t) * A_t)
        return of_wall(wall, wall.area(np.array(P_mean)), loss, (A.min(), A.max()))

    return made


def _slope(fit: WallFit, made: Callable[[Values], Array]) -> Array:
    """Derivatives by the free parameters : (indices, p)."""
    # a parameter with a relative scale may itself be 0
    ratios = {name: q.ratio_to for name, q in quantities(Segment).items() if q.ratio_to}
    columns = []
    for name in fit.model.free:
        step = _STEP * fit.values[ratios.get(name, name)]
        up, down = (made({**fit.values, name: fit.values[name] + sign * step}) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * step))
    return np.stack(columns, axis=1)


def loop_area(P: Array, A: Array, harmonics: int | None = None) -> Array:
    """∮ P dA [J/m] of beats P [Pa], A [m²] : (…, N): the energy dissipated in the wall per beat and length of vessel.

    With Fourier coefficients, ∮ P dA = -4π Σ k Im(P_k* A_k), over all harmonics of N samples or over the first few.
    """
    last = (P.shape[-1] - 1) // 2 if harmonics is None else harmonics
    k = np.arange(last + 1)
    p, a = (coefficients(x)[..., : last + 1] for x in (P, A))
    return -4.0 * np.pi * np.sum(k * (p.conj() * a).imag, axis=-1)


def measured_loss(beats: Beats, site: str) -> Estimate:
    """∮ P dA of the mean beats of P and R [J/m] with its 95 % interval.

    Independent noise of P and R does not bias it. Harmonics beyond the last one with both above their noise are
    excluded.
    """
    names = (f"{site}.P", f"{site}.R")
    P, R = (beats.mean(name) for name in names)
    noise = beats.covariance(names)
    size = np.stack([np.abs(coefficients(x)) for x in (P, R)], axis=1)
    variance = np.einsum("kii->ki", noise).real
    above = np.flatnonzero((size > _ABOVE_NOISE * np.sqrt(variance)).all(axis=1))
    last = min(max(1, int(above[-1]) if len(above) else 1), (beats.N - 1) // 2)
    A = np.pi * R * R
    k = np.arange(1, last + 1)
    p, a = (coefficients(x)[1 : last + 1] for x in (P, A))
    # Im(a p'* + p* a') = Im(c · (p', r')), of variance c† S c/2 up to conjugation; a' = 2π R r'
    c = np.stack([-a.conj(), p.conj() * 2.0 * np.pi * R.mean()], axis=1)
    spread = np.einsum("ki,kij,kj->k", c, noise[1 : last + 1], c.conj()).real / 2.0
    loss, sd = float(loop_area(P, A, last)), 4.0 * np.pi * float(np.sqrt(np.sum(k**2 * spread)))
    half = float(ndtri(0.975)) * sd
    return Estimate(loss, "J/m", (loss - half, loss + half))
