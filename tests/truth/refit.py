"""Least squares under priors, and residuals in units of their noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .bench import NoPeriodicRadius
from .network import NoPeriodicFlow
from .records import FITTED, Made

Array = np.ndarray
Predict = Callable[[Array], Array]


class _Point(NamedTuple):
    x: Array
    r: Array
    cost: float


def refit(predict: Predict, x0: Array, step: Array, prior: Array, rounds: int = 8, keep: bool = False) -> float:
    """√ of the smallest |r(x)|² + |(x - x0)/prior|², by Gauss-Newton with halved steps. r real, whitened.

    keep : the derivatives at x0 serve all steps.
    """

    def at(x: Array) -> _Point:
        r = np.concatenate([predict(x), (x - x0) / prior])
        return _Point(x, r, float(r @ r))

    here, J = at(x0), None
    for _ in range(rounds):
        if here.cost < 1e-6:
            break
        if J is None or not keep:
            try:
                columns = [(at(here.x + row).r - here.r) / h for row, h in zip(np.diag(step), step, strict=True)]
            except (NoPeriodicFlow, NoPeriodicRadius):
                break  # at the edge of what has a periodic state
            J = np.stack(columns, axis=1)
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0.0] = 1.0
        move = -np.linalg.lstsq(J / scale, here.r, rcond=1e-10)[0] / scale
        there = _shortened(at, here, move)
        if there is None:
            break
        gain, here = here.cost - there.cost, there
        if gain < 2e-3 * here.cost + 1e-6:
            break
    return float(np.sqrt(here.cost))


def _shortened(at: Callable[[Array], _Point], here: _Point, move: Array) -> _Point | None:
    """The first of a few shorter and shorter moves that lowers the cost."""
    for share in (1.0, 0.5, 0.2, 0.05):
        try:
            there = at(here.x + share * move)
        except (NoPeriodicFlow, NoPeriodicRadius):
            continue
        if there.cost < here.cost:
            return there
    return None


# variance of the drift's mean over the fitted beats, of the white noise's: measured over 4000 drifts of sensors.py
DRIFT = 0.0209


def weights(made: Made, harmonics: int) -> Array:
    """√(N w_k) per harmonic : (K + 1,). The mean is known no better than it drifts: 1/(1/N + DRIFT) for its N w_0."""
    samples = FITTED * made.beat.T / made.dt
    precision = np.full(harmonics, 2.0 * samples)
    precision[0] = 1.0 / (1.0 / samples + DRIFT)
    return np.sqrt(precision)


def whitened(delta: Array, noise: Array, response: Array, drive_noise: float, weight: Array) -> Array:
    """Δ : (channels, K + 1) as real numbers of unit variance, for white noise and that of the driving channel.

    noise : (channels,); response : (channels, K + 1), of each channel to the driving one.
    """
    h = response.T * drive_noise  # (K + 1, channels)
    covariance = h[:, :, None] * h[:, None, :].conj() + np.diag(noise**2)
    root = np.linalg.cholesky(covariance)
    z = weight[:, None] * np.linalg.solve(root, delta.T[..., None])[..., 0]
    return np.concatenate([z.real.ravel(), z.imag.ravel()])
