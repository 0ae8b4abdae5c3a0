"""One piece of artery on the bench: the periodic radius under a given periodic pressure.

The wall of ``wall.py`` at one point, solved for the strain at the samples of a beat by Newton's method; derivatives and
memory are circulant matrices, so that the Jacobian is exact.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from .anatomy import Anatomy
from .beat import Beat, anderson
from .wall import Walls, wall_at, walls_of

Array = np.ndarray

_STEPS = 40
_LONG, _SWEEPS = 1e-9, 200  # correction, of the largest harmonic of A, at which a long period is solved; iterations
_DEPTH = 8  # corrections that Anderson's iteration combines


class NoPeriodicRadius(ArithmeticError):
    """Newton's method did not find a periodic radius under this pressure."""


@lru_cache(maxsize=64)
def _derivative(beat: Beat) -> Array:
    return _circulant(beat, 1j * beat.omega)


def _circulant(beat: Beat, multiplier: Array) -> Array:
    """The matrix (samples, samples) of a filter."""
    return beat.filtered(np.eye(beat.samples), multiplier).T


def bench_wall(model: Anatomy, site: str, beat: Beat) -> Walls:
    """The wall at a site."""
    vessel = next(p.vessel for p in model.places if p.name == site)
    return wall_at(walls_of(model, [model.vessel(vessel).at(0.5)], np.array([[0.5]]), beat), 0, 0)


def radius(wall: Walls, P: Array, start: Array | None = None) -> Array:
    """R [m] at the samples of a beat under P [Pa], (samples,) each. start : a radius nearby.

    Raises NoPeriodicRadius if there is none within reach; strong rate nonlinearity is reached in steps.
    """
    R0 = float(np.sqrt(wall.A0[0] / np.pi))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # an iterate may run away; _newton notices
        s = wall.stretch(P - wall.P_level) if start is None else start / R0
        try:
            return R0 * _newton(wall, P, s)
        except NoPeriodicRadius:
            s = wall.stretch(P - wall.P_level)
        for share in (0.0, 0.25, 0.5, 0.75, 0.9, 1.0):
            s = _newton(replace(wall, r=share * wall.r, phi3=share * wall.phi3, coulomb=share * wall.coulomb), P, s)
    return R0 * s


def long_radius(wall: Walls, P: Array) -> Array:
    """R [m], coefficients (K + 1,), under P [Pa] at the samples of a long period: by Anderson's iteration on the wall
    linearised about its mean, as dense matrices are too large. Raises NoPeriodicRadius."""
    beat = wall.beat
    A = beat.coefficients(wall.A0 * wall.stretch(P - wall.P_level) ** 2)
    admittance = 1.0 / wall.at_rest().impedance(A[:1].real)
    states: list[Array] = []
    steps: list[Array] = []
    for _ in range(_SWEEPS):
        area = beat.values(A)
        if not (area > 0.0).all():
            raise NoPeriodicRadius("the area of an iterate is not positive")
        missing = P - wall.pressure(area, beat.values(1j * beat.omega * A))
        states.append(A)
        steps.append(admittance * beat.coefficients(missing))
        A = anderson(states[-_DEPTH:], steps[-_DEPTH:])
        if np.abs(steps[-1]).max() <= _LONG * np.abs(A[1:]).max():
            return beat.coefficients(np.sqrt(beat.values(A) / np.pi))
    raise NoPeriodicRadius(f"after {_SWEEPS} iterations the area still moves by {np.abs(steps[-1]).max():.1g} m²")


def _newton(wall: Walls, P: Array, s: Array) -> Array:
    D = _derivative(wall.beat)
    memory = _circulant(wall.beat, wall.memory()) if np.any(wall.tau) or np.any(wall.w) else None
    springpot = _circulant(wall.beat, wall.springpot()) if np.any(wall.w) else None
    for _ in range(_STEPS):
        rate = D @ s
        by_rate, by_strain = wall.rate_slopes(rate, s)
        stress, slope = wall.rate_stress(rate, s), by_rate[:, None] * D + np.diag(by_strain)
        if memory is not None:
            stress, slope = memory @ stress, memory @ slope
        if springpot is not None:
            stress, slope = stress + springpot @ (s - 1.0), slope + springpot
        stress, slope = stress + wall.further_stress(rate), slope + wall.further_slope(rate)[:, None] * D
        residual = wall.P_level + wall.elastic_pressure(s) + wall.K_h * stress / s - P
        jacobian = (wall.K_h / s)[:, None] * slope
        jacobian[np.diag_indices(len(s))] += wall.elastic_slope(s) - wall.K_h * stress / s**2
        if not np.isfinite(jacobian).all():
            raise NoPeriodicRadius("the strain rate ran away; take a smaller nonlinearity")
        step = np.linalg.solve(jacobian, residual)
        largest = np.abs(step).max()
        s = s - step * min(1.0, 0.02 / max(largest, 1e-30))
        if not (s > 0.1).all():
            raise NoPeriodicRadius("the radius of an iterate is not positive")
        if largest < 1e-12:
            return s
    raise NoPeriodicRadius(f"after {_STEPS} steps the strain still moves by {largest:.1g}")
