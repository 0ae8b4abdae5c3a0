"""One period of a heart beat as a Fourier series."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Beat:
    """x(t) = c_0 + 2 Re Σ c_k e^{iωkt}, k = 1 … K, sampled ``samples`` times a period ``T`` [s].

    More than 3K samples, so that quadratic products do not fold back onto the harmonics that are kept. heart [s]: the
    period of the heart, where T is many unlike beats; T if 0.
    """

    T: float
    K: int = 80
    samples: int = 256
    heart: float = 0.0

    @property
    def share(self) -> float:
        """The heart's period, of T."""
        return self.heart / self.T if self.heart else 1.0

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
    """x at any phases t/T : (n,) of coefficients (K + 1,), or (n, m) of (K + 1, m)."""
    return c[0].real + 2.0 * np.real(_powers(phase, len(c))[:, 1:] @ c[1:])


def _powers(phase: Array, count: int) -> Array:
    """e^{2πik phase}, k < count : (n, count), as products of few: an exponential costs as much as ten of these."""
    few = 32
    low, high = (np.exp(2j * np.pi * np.outer(phase, k)) for k in (np.arange(few), few * np.arange(-(-count // few))))
    return (high[:, :, None] * low[:, None, :]).reshape(len(phase), -1)[:, :count]


def anderson(states: list[Array], steps: list[Array]) -> Array:
    """Anderson's next iterate: the affine combination of the last ones with the smallest correction."""
    if len(steps) == 1:
        return states[0] + steps[0]
    dS = np.stack([(b - a).ravel().view(float) for a, b in zip(steps[:-1], steps[1:], strict=True)], axis=1)
    dX = np.stack([(b - a).ravel().view(float) for a, b in zip(states[:-1], states[1:], strict=True)], axis=1)
    scale = np.linalg.norm(dS, axis=0)
    scale[scale == 0.0] = 1.0
    weights = np.linalg.lstsq(dS / scale, steps[-1].ravel().view(float), rcond=1e-10)[0] / scale
    change = steps[-1].ravel().view(float) - (dX + dS) @ weights
    return states[-1] + change.view(complex).reshape(states[-1].shape)
