"""What a bench sees of a wall: its law between the pressure and the radius that two measurement chains make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver import loop as law

Array = np.ndarray
Chain = tuple[Array, Array]


@dataclass(frozen=True)
class Seen:
    """The law of a batch of walls, with the period T [s], between two channels: pressure(r) of a measured radius.

    wall : arrays (B, 1), the first of them the one that is linearised. P, R : of both channels the transfer function
    and the offset, which broadcast to (B, N//2 + 1) and (B, 1).
    """

    wall: law.Wall
    T: float
    P: Chain
    R: Chain

    def true(self, r: Array) -> tuple[Array, Array]:
        """True radius and pressure (B, N) where the measured radius is r : (N,)."""
        transfer, offset = map(np.atleast_2d, self.R)
        R = _filtered(1.0 / transfer, r - offset)
        return R, law.pressure(self.wall, R, R @ law.derivative_matrix(len(r), self.T).T, self.T)

    def pressure(self, r: Array) -> Array:
        """G : (B, N), the measured pressure of a measured radius."""
        transfer, offset = map(np.atleast_2d, self.P)
        return _filtered(transfer, self.true(r)[1]) + offset

    def slope(self, r: Array) -> Array:
        """dG/dr : (N, N) of the first of the batch."""
        N, R = len(r), self.true(r)[0][0]
        to_P, to_R = (np.atleast_2d(transfer)[0] for transfer, _ in (self.P, self.R))
        A = law.slope(self.wall, R, law.derivative_matrix(N, self.T) @ R, self.T)
        if np.any(to_P != 1.0):
            A = law.circulant(to_P, N) @ A
        if np.any(to_R != 1.0):
            A = A @ law.circulant(1.0 / to_R, N)
        return A


def _filtered(h: Array, x: Array) -> Array:
    """Harmonics of x : (…, N) times h : (B, N//2 + 1)."""
    return x if np.all(h == 1.0) else np.fft.irfft(np.fft.rfft(x) * h, x.shape[-1])
