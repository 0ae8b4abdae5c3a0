"""What a first model is fitted to: harmonics of the mean beat, each with its weight."""

from __future__ import annotations

import numpy as np

from solver.quantities.units import INFLOW

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients, resample
from .waves import heard

_HARMONICS = 16  # at most: they hold the pulse
# Of the pulsation: the error of the model at each harmonic, in its fit and in a study. Judgement: above the 0.04 to
# 0.46 % (rms over harmonics) that first models leave of 15 virtual animals in which nothing is hidden
ACCURACY = 0.005


class Data:
    """root : the channel of the pressure at the root, the one whose mean counts. k : (K+1,) of the harmonics. Q :
    (K+1,) of the inflow [m³/s]. names : the pressures and flows. X, sigma : (K+1,) of each, with the standard deviation
    √(noise² + (error of the model)²). n : how many real numbers count."""

    def __init__(self, beats: Beats, root: str) -> None:
        self.beats, self.root = beats, root
        most = min(_HARMONICS, max(int(heard(beats, name).max(initial=1)) for name in beats.values))
        self.k = np.arange(most + 1)
        self.Q = coefficients(resample(beats.mean(INFLOW), 2 * most + 2))[: most + 1]
        self.names = [name for name in beats.values if name[-2:] in (".P", ".Q") and name != INFLOW]
        self.X = {name: coefficients(beats.mean(name))[: most + 1] for name in self.names}
        self.sigma = {name: self._sigma(name) for name in self.names}
        self.n = sum(2 * int(np.sum(np.isfinite(each))) for each in self.sigma.values())

    def _sigma(self, name: str) -> Array:
        noise = np.zeros(len(self.k))
        if self.beats.n_beats > 1:
            noise = np.sqrt(self.beats.covariance((name,))[: len(self.k), 0, 0].real)
        noise[0] = 0.0 if name == self.root else np.inf  # breathing moves single beats; zeros elsewhere may be off
        size = self.size(name)
        return np.asarray(np.hypot(noise, ACCURACY * size) + 1e-12 * size)

    def size(self, name: str) -> float:
        """rms of the pulsation of a channel."""
        return rms(self.X[name])


def rms(X: Array) -> float:
    """Of the pulsation with harmonics X."""
    return float(np.sqrt(2.0 * np.sum(np.abs(X[1:]) ** 2)))
