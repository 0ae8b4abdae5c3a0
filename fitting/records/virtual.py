"""Virtual animals: synthetic bench recordings of pressure and radius. No public recording of the paper's sheep exists.

An artificial heart imposes the pressure; the radius follows from the wall law, solved as an ordinary differential
equation by scipy with formulas of its own: nothing here is shared with the regression that it tests. Whoever writes
such a recording to a file lets the file's name begin with ``virtual``: figures and tables show it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from solver.errors import InputError

from ..results.parameter_set import read_set

Array = np.ndarray


def _table1(site: str) -> tuple[float, float, float, float, float]:
    """R0 [m], h [m], E [Pa], φ0 [Pa·s] and φ_NL/φ0 [s] of the paper: Table 1 and its text, which has three decimals."""
    R0, h, E, phi0, phiNL = (_PAPER[f"{site}.{key}"].value for key in ("R0", "h", "E", "phi0", "phiNL"))
    return R0, h, E, phi0, round(phiNL / phi0, 3)


_PAPER = read_set("sheep_table1_nonlinear").values
SITES = {site: _table1(site) for site in ("AA", "PD", "MD", "DD", "BT", "CA", "FA")}
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


def solve_radius(wall: VirtualWall, p: Array, T: float, N: int) -> Array:
    """R : (N,) [m] of one wall, as :func:`solve_radii`, to 1e-11 of the pulse.

    p : (K + 1,) coefficients of the pressure, T : period [s]. Raises ValueError as it does.
    """
    return np.asarray(solve_radii([wall], p[None, :], np.array([T]), N, rtol=1e-13)[0])


def solve_radii(walls: Sequence[VirtualWall], p: Array, T: Array, N: int, rtol: float = 1e-9) -> Array:
    """R : (n, N) [m] of n walls at N even points of their periodic beats, all in one integration.

    p : (n, K + 1) coefficients of the pressures, T : (n,) periods [s], as :func:`pressure_at` has them.
    ε̇ is the strain rate whose viscous stress is (1-η²)(R/h) P - σ_el(ε) (`eq:general`), integrated over the phase t/T
    by an explicit Runge–Kutta method of order 8 with this relative tolerance; the wall forgets its start in φ0/E, a
    twentieth of a beat, so the third beat is the periodic one. Raises ValueError where the quadratic law has no strain
    rate for the stress (beyond its monotone range), or where the integration fails.
    """
    R0, h, E, phi0, phiNL, ENL, eta = np.array([[getattr(wall, name) for name in _NUMBERS] for wall in walls]).T
    beta = np.array([wall.elastic == "beta" for wall in walls])
    strain_rate = _strain_rates(phi0, phiNL, np.array([wall.viscous == "monotone" for wall in walls]))
    orders, plate = 2j * np.pi * np.arange(p.shape[1]), (1.0 - eta**2) * R0

    def viscous_stress(strain: Array, P: Array) -> Array:
        stretch = 1.0 + strain
        stress = (E + ENL * strain) * strain
        if beta.any():
            stress = stress * np.where(beta, stretch, 1.0)
        return plate * stretch / h * P - stress

    def rate(phase: float, strain: Array) -> Array:
        P = (p @ np.exp(orders * phase)).real
        return T * strain_rate(viscous_stress(strain, P))

    done = solve_ivp(
        rate,
        (0.0, 3.0),
        _at_rest(viscous_stress, p.sum(axis=1).real),
        "DOP853",
        2.0 + np.arange(N) / N,
        rtol=rtol,
        atol=1e-2 * rtol,
        max_step=0.02,
    )
    if not done.success:
        raise InputError(f"the virtual walls could not be integrated: {done.message}")
    return np.asarray(R0[:, None] * (1.0 + done.y))


_NUMBERS = ("R0", "h", "E", "phi0", "phiNL", "ENL", "eta")


def _at_rest(viscous_stress: Callable[[Array, Array], Array], P: Array) -> Array:
    """The strains at which the elastic walls alone carry P, by bisection: the viscous stress is nought."""
    low, high = np.full(len(P), -0.5), np.full(len(P), 2.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        more = viscous_stress(middle, P) > 0.0
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return 0.5 * (low + high)


def _strain_rates(phi0: Array, phiNL: Array, monotone: Array) -> Callable[[Array], Array]:
    """ε̇ by σ_v(ε̇), of walls with the monotone or the quadratic law; only the laws that occur are computed."""
    r = phiNL / phi0
    straight, quadratic = r == 0.0, not monotone.all()
    twice, fourfold, divisor = 2.0 * r, 4.0 * r, np.where(straight, 1.0, 2.0 * r)

    def rate(stress: Array) -> Array:
        linear = stress / phi0
        # a trial step may ask for more than the law's largest stress φ0/(2|r|): a huge rate makes the step shorter
        found = np.log(np.maximum(1.0 + twice * linear, 1e-9)) / divisor
        if quadratic:
            root = np.where(monotone, 1.0, 1.0 + fourfold * linear)
            if np.any(root <= 0.0):
                worst = int(np.argmin(root))
                raise InputError(
                    f"virtual wall: phiNL = {phiNL[worst]:g} Pa.s^2 has no strain rate for the viscous stress "
                    f"{stress[worst]:g} Pa; use the monotone law or a smaller pulse."
                )
            found = np.where(monotone, found, 2.0 * linear / (1.0 + np.sqrt(root)))
        return np.where(straight, linear, found) if straight.any() else found

    return rate


def measured(clean: Array, rng: np.random.Generator, dB: float, drift: float = 0.0, bits: int | None = None) -> Array:
    """A channel as a sensor would give it: clean + drift + white noise, quantised.

    Noise of 10^(-dB/20) and drift of ``drift`` times the pulsatile standard deviation; the drift is a slow sine of
    random phase, half to one and a half periods over the record; ``bits`` converts over twice the range.
    """
    size = float(np.std(clean))  # what decibels are relative to
    phase, cycles = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.5, 1.5)
    x = clean + drift * size * np.sqrt(2.0) * np.sin(phase + cycles * np.linspace(0.0, 2.0 * np.pi, len(clean)))
    x = x + rng.normal(0.0, size * 10.0 ** (-dB / 20.0), len(clean))
    if bits is not None:
        step = 2.0 * np.ptp(clean) / 2**bits
        x = step * np.round(x / step)
    return x
