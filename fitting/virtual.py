"""Virtual animals: synthetic bench recordings of pressure and radius. No public recording of the paper's sheep exists.

An artificial heart imposes the pressure; the radius follows from the wall law, solved as an ordinary differential
equation by scipy with formulas of its own: nothing here is shared with the regression that it tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

Array = np.ndarray

# Table 1 and the ratios φ_NL/φ0 of the text: R0 [m], h [m], E [Pa], φ0 [Pa·s], φ_NL/φ0 [s]
SITES: dict[str, tuple[float, float, float, float, float]] = {
    "AA": (0.948e-2, 0.38e-3, 1.539e6, 25.451e3, -0.915),
    "PD": (0.880e-2, 0.91e-3, 0.842e6, 12.746e3, -0.999),
    "MD": (0.855e-2, 1.26e-3, 0.617e6, 11.651e3, -0.888),
    "DD": (0.828e-2, 1.10e-3, 1.427e6, 24.514e3, -0.975),
    "BT": (0.900e-2, 1.06e-3, 0.683e6, 12.048e3, -1.380),
    "CA": (0.406e-2, 0.78e-3, 4.142e6, 77.082e3, 0.524),
    "FA": (0.282e-2, 0.31e-3, 2.260e6, 43.426e3, -0.395),
}
"""The seven arteries of the paper. The spread between animals is not in its text; see :func:`virtual_cohort`."""


@dataclass(frozen=True)
class VirtualWall:
    """A wall to make loops of: SI; the law names are those of network files."""

    R0: float
    h: float
    E: float
    phi0: float
    phiNL: float = 0.0
    ENL: float = 0.0
    eta: float = 0.5
    elastic: str = "regression"
    viscous: str = "monotone"


def table_wall(site: str, **changes: float | str) -> VirtualWall:
    """The mean wall of a site of the paper, with some fields changed."""
    R0, h, E, phi0, ratio = SITES[site]
    fields: dict = {"R0": R0, "h": h, "E": E, "phi0": phi0, "phiNL": ratio * phi0, **changes}
    return VirtualWall(**fields)


def jarvik_pressure(T: float, mean: float = 11e3, pulse: float = 4e3, harmonics: int = 48) -> Array:
    """Coefficients p_k (k = 0 … harmonics) of a bench pressure P(t) = Re Σ p_k e^{2πikt/T} [Pa].

    A half-sine ejection during 0.36 T into a Windkessel of time constant 0.7 T, smoothed by e^{-(k/9)²/2}, scaled to
    the mean and the pulse (maximum less minimum): "as close as possible to a physiological waveform". Ours.
    """
    k = np.arange(harmonics + 1)
    tau = np.linspace(0.0, 1.0, 4001)[:-1]
    ejection = np.where(tau < 0.36, np.sin(np.pi * np.minimum(tau / 0.36, 1.0)), 0.0)
    c = np.fft.rfft(ejection)[: harmonics + 1] / len(tau) * np.where(k > 0, 2.0, 1.0)
    c = c / (1.0 + 2j * np.pi * k * 0.7) * np.exp(-((k / 9.0) ** 2) / 2.0)
    shape = pressure_at(np.where(k > 0, c, 0.0), 1.0, tau)
    c *= pulse / np.ptp(shape)
    c[0] = mean
    return c


def pressure_at(p: Array, T: float, t: Array | float) -> Array:
    """P(t) = Re Σ p_k e^{2πikt/T} at times t of any shape."""
    return np.polynomial.polynomial.polyval(np.exp(2j * np.pi * np.asarray(t) / T), p).real


def solve_radius(wall: VirtualWall, p: Array, T: float, N: int, beats: int = 3) -> Array:
    """R at N evenly spaced times of the periodic beat [m] under the pressure with coefficients p.

    dε/dt is the strain rate whose viscous stress is (1-η²)(R/h) P - σ_el(ε) (`eq:general`), integrated by an implicit
    Runge–Kutta method to 1e-12 for ``beats`` beats; the wall forgets its start in φ0/E. Raises ValueError where the
    quadratic law has no strain rate for the stress: beyond its monotone range.
    """

    def rate(t: float, strain: Array) -> Array:
        stretch = 1.0 + strain
        R = wall.R0 * stretch
        stress = wall.E * strain + wall.ENL * strain**2
        if wall.elastic == "beta":
            stress = stress * stretch
        return _strain_rate(wall, (1.0 - wall.eta**2) * R / wall.h * pressure_at(p, T, t) - stress)

    times = (beats - 1 + np.arange(N) / N) * T
    start = _rest(wall, float(pressure_at(p, T, 0.0)))
    done = solve_ivp(rate, (0.0, beats * T), [start], "DOP853", times, rtol=1e-12, atol=1e-14, max_step=T / 50)
    if not done.success:
        raise ValueError(f"the virtual wall could not be integrated: {done.message}")
    return wall.R0 * (1.0 + done.y[0])


def _rest(wall: VirtualWall, P: float) -> float:
    """The strain at which the elastic wall alone carries P."""

    def excess(strain: float) -> float:
        stress = (wall.E * strain + wall.ENL * strain**2) * (1.0 + strain if wall.elastic == "beta" else 1.0)
        return stress - (1.0 - wall.eta**2) * wall.R0 * (1.0 + strain) / wall.h * P

    return float(brentq(excess, -0.5, 2.0, xtol=1e-15))


def _strain_rate(wall: VirtualWall, stress: Array) -> Array:
    """ε̇ with σ_v(ε̇) = stress."""
    if wall.phiNL == 0.0:
        return stress / wall.phi0
    if wall.viscous == "monotone":
        r = wall.phiNL / wall.phi0
        # a trial step may ask for more than the law's largest stress φ0/(2|r|): a huge rate makes the step shorter
        return np.log(np.maximum(1.0 + 2.0 * r * stress / wall.phi0, 1e-9)) / (2.0 * r)
    root = wall.phi0**2 + 4.0 * wall.phiNL * stress
    if np.any(root <= 0.0):
        raise ValueError(
            f"virtual wall: phiNL = {wall.phiNL:g} Pa.s^2 has no strain rate for the viscous stress "
            f"{float(np.ravel(stress)[0]):g} Pa; use the monotone law or a smaller pulse."
        )
    return 2.0 * stress / (wall.phi0 + np.sqrt(root))


def pulsatile_sd(x: Array) -> float:
    """Standard deviation without the mean: what decibels are relative to."""
    return float(np.std(x))


def measured(clean: Array, rng: np.random.Generator, dB: float, drift: float = 0.0, bits: int | None = None) -> Array:
    """A channel as a sensor would give it: clean + drift + white noise, quantised.

    Noise of 10^(-dB/20) and drift of ``drift`` times the pulsatile standard deviation; the drift is a slow sine of
    random phase, half to one and a half periods over the record; ``bits`` converts over twice the range.
    """
    size = pulsatile_sd(clean)
    phase, cycles = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 1.5)
    x = clean + drift * size * np.sqrt(2.0) * np.sin(phase + cycles * np.linspace(0.0, 2.0 * np.pi, len(clean)))
    x = x + rng.normal(0.0, size * 10.0 ** (-dB / 20.0), len(clean))
    if bits is not None:
        step = 2.0 * np.ptp(clean) / 2**bits
        x = step * np.round(x / step)
    return x
