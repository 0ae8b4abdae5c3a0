"""The inflow that drives a simulation: the reading of the flow meter, or the true flow if the meter has a known filter.

A filter H of the meter that the network file states is inverted, Q = q/H, at the harmonics where |H| is a tenth or
more, or where q is above the scatter of beats. At the others, where 1/H would amplify noise, the reading is used. The
weights include the unknown inflow there: the channels' response to the noise of the meter is also divided by H.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from solver.laws.catalogue import filtered, zero_of
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .. import limits
from ..alignment.beats import Array, Beats
from .spectral import coefficients


@dataclass(frozen=True)
class Inflow:
    """Q(t) = Q_0 + 2 Re Σ Q_k e^{2πikt/T} [m³/s], for one inflow or for each member of a batch.

    X : (…, n) the Q_k, the last with half its weight if it is the Nyquist coefficient. shown : (n,) whether a harmonic
    stands above the noise of the meter.
    """

    T: float
    X: Array
    shown: Array

    @property
    def omega(self) -> Array:
        """(n,) [rad/s]."""
        return 2.0 * np.pi / self.T * np.arange(self.X.shape[-1])

    def __call__(self, t: Array) -> Array:
        """Q : t.shape, or t.shape + (B,) of a batch, at times t [s]."""
        turn = 2j * np.pi * np.mod(np.asarray(t, float) / self.T, 1.0)[..., None]
        n = self.X.shape[-1]
        # e^{ik} = e^{i few a} e^{ib} for k = few a + b: the exponentials of all k are most of a search's simulations
        few = math.isqrt(n) + 1
        k = np.arange(few)
        X = np.where(np.arange(n) > 0, 2.0, 1.0) * self.X
        X = np.concatenate([X, np.zeros((*X.shape[:-1], few**2 - n))], axis=-1).reshape(*X.shape[:-1], few, few)
        by_a = np.tensordot(np.exp(turn * k), X, (-1, -1))  # (…, a), of a batch (…, B, a)
        by_ab = by_a * np.exp(turn * few * k)[..., *[None] * (self.X.ndim - 1), :]
        return np.asarray(by_ab.sum(axis=-1).real)

    def harmonics(self, T: float, K: int) -> Array | None:
        """(…, K+1) Q_0 … Q_K, for its own period only."""
        if self.T != T:
            return None
        X = np.zeros((*self.X.shape[:-1], K + 1), complex)
        n = min(K + 1, self.X.shape[-1])
        X[..., :n] = self.X[..., :n]
        X[..., 0] = X[..., 0].real
        return X

    def true(self, H: Array, offset: Array) -> Inflow:
        """The true flow if this is the reading of a meter with transfer function H : (…, n) and an ``offset`` (…, 1).

        Q = (q - o)/H where q stands above the noise, which 1/H of a slow meter would only enlarge.
        """
        first = np.arange(self.X.shape[-1]) == 0
        return replace(self, X=(self.X - np.where(first, offset, 0.0)) / np.where(self.shown, H, 1.0))


def inflow(beats: Beats, dt: float, network: Network | None = None, channel: str = INFLOW) -> Inflow:
    """Q(t) [m³/s] of the mean beat by Fourier interpolation, with the harmonics that steps of dt [s] can follow;
    periodic.

    network : states the filter of the channel; None: there is none.
    """
    X = coefficients(beats.mean(channel))
    if beats.N % 2 == 0:
        X[-1] *= 0.5  # the Nyquist coefficient is its own conjugate
    shown = np.ones(len(X), bool)
    if beats.n_beats > 1:
        shown[1:] = np.abs(X[1:]) > limits.SURE * np.sqrt(beats.covariance((channel,))[1:, 0, 0].real)
    kept = min(len(X), int(beats.T / (2.0 * dt)) + 1)
    found = Inflow(beats.T, X[:kept], shown[:kept])
    if network is None:
        return found
    X[0] -= zero_of(network, channel)
    return replace(found, X=found.X / undone(network, channel, found))


def undoable(network: Network, channel: str, omega: Array) -> Array:
    """The filter of a channel, bounded so that a flow can be divided by it : (n,) at omega : (n,) [rad/s]."""
    H = filtered(network, channel, omega)
    return np.asarray(H / np.minimum(1.0, np.abs(H) / limits.UNDONE))


def undone(network: Network, channel: str, drive: Inflow) -> Array:
    """The filter by which the flow is divided : (n,), :func:`undoable` or 1.

    ``drive.shown`` marks the harmonics above 3 standard deviations of the mean beat. If beats differ, these are wide;
    all harmonics of which the filter leaves a tenth are therefore taken for signal, too.
    """
    H = undoable(network, channel, drive.omega)
    return np.asarray(np.where(drive.shown | (np.abs(H) >= limits.SAFE), H, 1.0))


def flowed(beats: Beats, network: Network, channel: str = INFLOW) -> Array:
    """(N,) the mean beat of a channel before its filter."""
    if filtered(network, channel, np.array([beats.omega])) == 1.0 and zero_of(network, channel) == 0.0:
        return beats.mean(channel)
    return inflow(beats, 0.5 * beats.T / beats.N, network, channel)(beats.time)
