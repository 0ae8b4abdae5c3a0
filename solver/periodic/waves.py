"""Waves of a period, as amplitudes of its harmonics; and beats near which others are sought."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..scheme.step import State

Array = np.ndarray

SAMPLES = 4  # per harmonic in a period, to resolve products of harmonics
_MEAN = 1e4  # s, the mean as a wave so slow that everything follows it; a longer one has rounding errors


class Waves(NamedTuple):
    """Amplitudes of e^{iωt}, the mean first: y (K+1, B, n) of the state vector, H (K+1, B, n_nodes) [Pa]."""

    omega: Array
    y: Array
    H: Array

    def at(self, t: float, derivative: bool = False) -> tuple[Array, Array]:
        """y and H, or their time derivatives, t [s] after the start."""
        turn = np.where(self.omega == 0.0, 1.0, 2.0) * np.exp(1j * self.omega * t)
        turn = turn * (1j * self.omega) if derivative else turn
        y, H = (np.tensordot(turn, x, 1).real for x in (self.y, self.H))
        return y, H

    @property
    def rates(self) -> Array:
        """Amplitudes of dy/dt."""
        return 1j * self.omega[:, None, None] * self.y

    def where(self, members: Array, other: Waves) -> Waves:
        """These waves for some members : (B,), ``other`` for the rest."""
        own = members[:, None]
        return Waves(self.omega, np.where(own, self.y, other.y), np.where(own, self.H, other.H))

    @staticmethod
    def joined(parts: Sequence[Waves]) -> Waves:
        """The waves of the members of all parts."""
        return Waves(
            parts[0].omega, *(np.concatenate(each, axis=1) for each in zip(*(p[1:] for p in parts), strict=True))
        )

    def members(self, which: Array | slice) -> Waves:
        """The waves of some members."""
        return Waves(self.omega, self.y[:, which], self.H[:, which])


class Near(NamedTuple):
    """The beats near which others are sought: waves about their own steady state, with the amplitudes of the residuals
    that they leave of momentum (K+1, B, n_e, N+1) [Pa] and of ΣQ at the nodes (K+1, B, n_nodes).

    Others leave the same residuals, so that the difference of two beats is more accurate than each.
    """

    waves: Waves
    momentum: Array
    nodes: Array

    @staticmethod
    def of(waves: Waves, rest: State, momentum: Array, nodes: Array) -> Near:
        n = len(waves.omega)
        about = Waves(waves.omega, waves.y - constant(rest.y, n), waves.H - constant(rest.H, n))
        return Near(about, momentum, nodes)

    @staticmethod
    def joined(parts: Sequence[Near]) -> Near:
        """Those of the members of all parts."""
        return Near(
            Waves.joined([p.waves for p in parts]),
            np.concatenate([p.momentum for p in parts], axis=1),
            np.concatenate([p.nodes for p in parts], axis=1),
        )

    def members(self, which: Array | slice) -> Near:
        """Those of some members."""
        return Near(self.waves.members(which), self.momentum[:, which], self.nodes[:, which])


def taus_of(omega: Array) -> list[Any]:
    """The stage lengths with the Jacobians of waves e^{iωt}; the mean is a very slow one."""
    return [1.0 / (1j * w) if w else _MEAN for w in omega]


def constant(x: Array, n: int) -> Array:
    """Amplitudes (n, …) of a constant x."""
    return np.concatenate([x[None], np.zeros((n - 1, *x.shape))]).astype(complex)


def samples(x: Array) -> Array:
    """Values over a period : (4 K, …) of amplitudes x : (K+1, …)."""
    return np.fft.irfft(x, SAMPLES * (len(x) - 1), axis=0, norm="forward")


def amplitudes(x: Array, like: Array) -> Array:
    """Amplitudes : (K+1, B, …) of the values of all members, time after time; K and B are those of ``like``."""
    K, B = len(like) - 1, like.shape[1]
    return np.fft.rfft(x.reshape(SAMPLES * K, B, *x.shape[1:]), axis=0, norm="forward")[: K + 1]
