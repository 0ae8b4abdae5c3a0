"""One period of a heart beat as a Fourier series."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Beat:
    """x(t) = c_0 + 2 Re Σ c_k e^{iωkt}, k = 1 … K, sampled ``samples`` times a period ``T`` [s].

    More than 3K samples, so that quadratic products do not fold back onto the harmonics that are kept.
    """

    T: float
    K: int = 80
    samples: int = 256

    @cached_property
    def omega(self) -> Array:
        """Angular frequency of each harmonic : (K + 1,) [rad/s]."""
        return 2.0 * np.pi * np.arange(self.K + 1) / self.T

    @cached_property
    def phase(self) -> Array:
        """t/T at the samples : (samples,)."""
        return np.arange(self.samples) / self.samples

    def values(self, c: Array) -> Array:
        """Samples (…, samples) of coefficients (…, K + 1)."""
        return np.fft.irfft(c, self.samples, axis=-1) * self.samples

    def coefficients(self, x: Array) -> Array:
        """Coefficients (…, K + 1) of samples (…, samples)."""
        return np.fft.rfft(x, axis=-1)[..., : self.K + 1] / self.samples

    def filtered(self, x: Array, multiplier: Array) -> Array:
        """Samples of x after a filter with the frequency response ``multiplier`` : (…, K + 1)."""
        return self.values(multiplier * self.coefficients(x))


def at_phase(c: Array, phase: Array) -> Array:
    """x at any phases t/T : (n,) of coefficients (K + 1,)."""
    k = np.arange(1, len(c))
    return c[0].real + 2.0 * np.real(np.exp(2j * np.pi * np.outer(phase, k)) @ c[1:])
