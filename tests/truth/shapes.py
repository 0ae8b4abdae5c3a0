"""Waveforms of one beat: ejection of the heart, and arterial pressure. Smooth, band-limited, another one each time.

Both are made of bumps exp(κ (cos 2π(θ - c) - 1)) over the phase θ = t/T, whose harmonics fall as exp(-k²/2κ): nothing
is left beyond the 40 harmonics that are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class Arteries:
    """What makes a pressure of an ejection: a Windkessel of ``tau`` [s] behind ``direct``, a wave that comes back.

    The reflected share comes after ``delay`` of a beat T [s], smoothed. pulse : wanted and found; mean [Pa].
    """

    T: float
    direct: float
    tau: float
    reflected: float
    delay: float
    pulse: tuple[float, float]
    mean: float

    def pressure(self, flow: Array, omega: Array) -> Array:
        """Coefficients (K + 1,) [Pa] of those of an ejection at angular frequencies omega."""
        c = self._shape(flow, 1j * omega) * self.pulse[0] * MMHG / self.pulse[1]
        c[0] = self.mean
        return c

    def _shape(self, flow: Array, iw: Array) -> Array:
        c = flow * (self.direct + 1.0 / (1.0 + iw * self.tau))
        return c * (1.0 + self.reflected * np.exp(-iw * self.delay * self.T) / (1.0 + iw * 0.02))


def arteries(rng: np.random.Generator, beat: Beat, flow: Array) -> Arteries:
    """Arteries in which an ejection makes 80-110 mmHg with a pulse of 30-50 mmHg; a time constant of 0.2-0.45 s."""
    u = rng.uniform
    tau, direct = u(0.2, 0.45), u(0.04, 0.1)
    found = Arteries(beat.T, direct, tau, u(0.1, 0.4), u(0.06, 0.14), (1.0, 1.0), 0.0)
    pulse = float(np.ptp(beat.values(found._shape(flow, 1j * beat.omega))))
    return replace(found, pulse=(u(30.0, 50.0), pulse), mean=u(80.0, 110.0) * MMHG)


def arterial_pressure(rng: np.random.Generator, beat: Beat) -> Array:
    """Pressure on an artery, coefficients (K + 1,) [Pa]."""
    flow = ejection(rng, beat, 1.0)
    return arteries(rng, beat, flow).pressure(flow, beat.omega)
