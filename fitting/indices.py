"""What a physiologist reads from a fitted wall: stiffness, distensibility, wave velocity, losses; with 95 % intervals.

All at the mean pressure of the beat, from the elastic part of the law (dP/dA, dP/dR below are of P_el), so that they do
not depend on how fast the wall moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as t_distribution

from .beats import Beats
from .regression import WallFit

Array = np.ndarray
Values = Mapping[str, float]

MMHG = 133.322387415  # Pa
_STEP = 1e-5  # relative, of the central differences: their error is then 1e-10
_ABOVE_NOISE = 3.0  # standard deviations: harmonics of a measured loop that count


@dataclass(frozen=True)
class Estimate:
    """A number in SI with its 95 % interval; ``shown`` : the unit people read it in, and its size in SI."""

    value: float
    unit: str
    ci95: tuple[float, float]
    shown: tuple[str, float]

    def __str__(self) -> str:
        unit, size = self.shown
        low, high = self.ci95
        return f"{self.value / size:.4g} ({low / size:.4g} to {high / size:.4g}) {unit}".rstrip(" 1")


def indices(fit: WallFit, beats: Beats, rho: float = 1060.0) -> dict[str, Estimate]:
    """The indices of a site, by name. rho : density of blood [kg/m³].

    ====================  ====================================================================================
    E_inc                 (1 - η²) (R²/h) dP/dR [Pa], incremental elastic modulus; thin wall, isotropic (Bergel 1961)
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
    and its mean pressure as they are; that of loss_measured from the noise of the harmonics.
    Raises ValueError if the beats lack the site's channels, or the fitted wall cannot carry their mean pressure.
    Sources: D. H. Bergel, J. Physiol. 156 (1961) 445; J. C. Bramwell and A. V. Hill, Proc. R. Soc. B 93 (1922) 298.
    """
    P_mean = float(beats.mean(f"{fit.site}.P").mean())
    made = _of_law(fit, P_mean, rho)
    value = made(fit.values)
    if not np.isfinite(value).all():
        raise ValueError(
            f"site {fit.site}: the fitted wall cannot carry the mean pressure of {P_mean:g} Pa; fit it to these beats."
        )
    half = float(t_distribution.ppf(0.975, fit.dof)) * np.sqrt(np.einsum("ip,pq,iq->i", *_delta(fit, made)))
    result = {
        name: Estimate(float(x), unit, (float(x - d), float(x + d)), shown)
        for (name, unit, shown), x, d in zip(_OF_LAW, value, half, strict=True)
    }
    loss, sd = measured_loss(beats, fit.site)
    half_measured = float(norm.ppf(0.975)) * sd
    _, unit, shown = _OF_LAW[_LOSS]
    result["loss_measured"] = Estimate(loss, unit, (loss - half_measured, loss + half_measured), shown)
    return result


_OF_LAW = (
    ("E_inc", "Pa", ("MPa", 1e6)),
    ("distensibility", "1/Pa", ("1e-3/mmHg", 1e-3 / MMHG)),
    ("compliance", "m^2/Pa", ("mm^2/mmHg", 1e-6 / MMHG)),
    ("wave_velocity", "m/s", ("m/s", 1.0)),
    ("loss", "J/m", ("mJ/m", 1e-3)),
    ("loss_ratio", "1", ("1", 1.0)),
    ("relaxation_time", "s", ("ms", 1e-3)),
)
_LOSS = 4


def _of_law(fit: WallFit, P_mean: float, rho: float) -> Callable[[Values], Array]:
    """The indices of ``_OF_LAW`` as a function of the wall's parameters, on the fitted loop."""
    R, R_t, T = fit.solution.R, fit.solution.R_t, fit.loop.T
    A, A_t = np.pi * R * R, 2.0 * np.pi * R * R_t

    def made(values: Values) -> Array:
        wall = fit.wall(values, rho)
        A_mean = wall.area(np.array(P_mean))
        stiffness = wall.stiffness(A_mean)  # dP/dA = dP/dR/(2πR)
        R_mean = np.sqrt(A_mean / np.pi)
        loss = T * np.mean(wall.pressure(A, A_t) * A_t)
        s_low, s_high = (np.sqrt(end / wall.A0) for end in (A.min(), A.max()))
        law, K, e = wall.elastic, wall.K, wall.e
        stored = 2.0 * wall.A0 * (law.energy(s_high, K, e) - law.energy(s_low, K, e))
        stored -= law.pressure(s_low, K, e) * np.ptp(A)
        return np.array(
            [
                (1.0 - fit.eta**2) * R_mean**2 / fit.h * stiffness * 2.0 * np.pi * R_mean,
                1.0 / (A_mean * stiffness),
                1.0 / stiffness,
                wall.wave_speed(A_mean),
                loss,
                loss / stored,
                values["phi0"] / values["E"],
            ]
        )

    return made


def _delta(fit: WallFit, made: Callable[[Values], Array]) -> tuple[Array, Array, Array]:
    """Derivatives by the free parameters (indices, p), their covariance (p, p), and the derivatives again."""
    sizes = {"phiNL": fit.values["phi0"], "ENL": fit.values["E"]}  # may be 0 themselves
    columns = []
    for name in fit.model.free:
        step = _STEP * sizes.get(name, fit.values[name])
        up, down = (made({**fit.values, name: fit.values[name] + sign * step}) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * step))
    slope = np.stack(columns, axis=1)
    return slope, fit.covariance, slope


def measured_loss(beats: Beats, site: str) -> tuple[float, float]:
    """∮ P dA of the mean beats of P and R [J/m] and its standard deviation.

    With A = πR² and Fourier coefficients, ∮ P dA = -4π Σ k Im(P_k* A_k). Independent noise of P and R does not bias it.
    Harmonics beyond the last one where both are above their noise are left out.
    """
    names = (f"{site}.P", f"{site}.R")
    P, R = (beats.mean(name) for name in names)
    noise = beats.covariance(names)
    size = np.stack([np.abs(np.fft.rfft(x, norm="forward")) for x in (P, R)], axis=1)
    variance = np.einsum("kii->ki", noise).real
    above = np.flatnonzero((size > _ABOVE_NOISE * np.sqrt(variance)).all(axis=1))
    last = min(max(1, int(above[-1]) if len(above) else 1), (beats.N - 1) // 2)
    k = np.arange(1, last + 1)
    p, a = (np.fft.rfft(x, norm="forward")[1 : last + 1] for x in (P, np.pi * R * R))
    loss = -4.0 * np.pi * float(np.sum(k * (p.conj() * a).imag))
    # Im(a p'* + p* a') = Im(c · (p', r')), of variance c† S c/2 up to conjugation; a' = 2π R r'
    c = np.stack([-a.conj(), p.conj() * 2.0 * np.pi * R.mean()], axis=1)
    spread = np.einsum("ki,kij,kj->k", c, noise[1 : last + 1], c.conj()).real / 2.0
    return loss, 4.0 * np.pi * float(np.sqrt(np.sum(k**2 * spread)))
