"""Waveforms of one beat: ejection of the heart, and arterial pressure. Smooth, band-limited, another one each time.

Both are made of bumps exp(κ (cos 2π(θ - c) - 1)) over the phase θ = t/T, whose harmonics fall as exp(-k²/2κ): nothing
is left beyond the 40 harmonics that are kept.
"""

from __future__ import annotations

import numpy as np

from .beat import Beat

Array = np.ndarray

HARMONICS = 40
MMHG = 133.322387415


def _bump(phase: Array, centre: float, sharpness: float) -> Array:
    return np.exp(sharpness * (np.cos(2.0 * np.pi * (phase - centre)) - 1.0))


def _limited(beat: Beat, x: Array) -> Array:
    c = beat.coefficients(x)
    c[HARMONICS + 1 :] = 0.0
    return c


def ejection(rng: np.random.Generator, beat: Beat, Q_max: float) -> Array:
    """Inflow, coefficients (K + 1,) [m³/s]: a skewed ejection, a notch with backflow, a rebound; peak near Q_max."""
    u = rng.uniform
    start, width, phase = u(0.08, 0.12), u(0.05, 0.075), beat.phase
    x = u(0.6, 0.95) * _bump(phase, start, u(16.0, 26.0))
    x += _bump(phase, start + width, u(12.0, 20.0))
    x += u(0.35, 0.75) * _bump(phase, start + 2.0 * width, u(14.0, 24.0))
    notch = start + 2.0 * width + u(0.09, 0.13)
    x -= u(0.12, 0.35) * _bump(phase, notch, u(50.0, 80.0))
    x += u(0.0, 0.06) * _bump(phase, notch + 0.06, u(40.0, 70.0))
    return _limited(beat, x * u(0.85, 1.05) * Q_max / x.max())


def arterial_pressure(rng: np.random.Generator, beat: Beat) -> Array:
    """Pressure, coefficients (K + 1,) [Pa]: mean 80-110 mmHg, pulse 30-50 mmHg.

    An ejection into a Windkessel of time constant 0.2-0.45 s, with a reflected wave that comes back later.
    """
    u, iw = rng.uniform, 1j * beat.omega
    flow = ejection(rng, beat, 1.0)
    tau = u(0.2, 0.45)
    c = flow * (u(0.04, 0.1) + 1.0 / (1.0 + iw * tau))
    c = c * (1.0 + u(0.1, 0.4) * np.exp(-iw * u(0.06, 0.14) * beat.T) / (1.0 + iw * 0.02))
    pulse = np.ptp(beat.values(c))
    c = c * u(30.0, 50.0) * MMHG / pulse
    c[0] = u(80.0, 110.0) * MMHG
    return c
