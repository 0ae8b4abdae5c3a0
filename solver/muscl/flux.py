"""The hyperbolic part: limited slopes, Rusanov's fluxes, and the source of a wall that changes along its segment."""

from __future__ import annotations

import numpy as np

from ..laws.wall import Wall
from .model import MusclModel
from .slopes import SLOPES

Array = np.ndarray


def rates(model: MusclModel, A: Array, Q: Array, Q_end: Array, P_end: Array) -> tuple[Array, Array]:
    """∂A/∂t and ∂Q/∂t : (B, n_cells) without friction and viscosity.

    Q_end, P_end : (B, 2, n_segments) flow [m³/s] and elastic pressure [Pa] at the starts and ends of segments.
    """
    P = pressure_elastic(model.wall, A)
    P_face, Q_face = _at_faces(model, P), _at_faces(model, Q)
    s = stretch(model.faces, P_face)
    A_face = model.faces.A0 * s * s
    carried, root = speeds(model, model.faces, s, Q_face / A_face)
    flux_A = _rusanov(Q_face, A_face, np.abs(carried) + root)
    flux_Q = _rusanov(carried * Q_face + momentum(model.faces, s), Q_face, np.abs(carried) + root)
    _put_ends(model, flux_A, Q_end)
    s = stretch(model.ends, P_end)
    U = Q_end / (model.ends.A0 * s * s)
    _put_ends(model, flux_Q, model.coefficients.alpha[..., None] * U * Q_end + momentum(model.ends, s))
    gain = flux_Q[:, 0] - flux_Q[:, 1]
    if model.tapered:
        at_rest = momentum(model.faces, stretch(model.faces, P[:, None]))
        gain += at_rest[:, 1] - at_rest[:, 0]
    return (flux_A[:, 0] - flux_A[:, 1]) / model.dx, gain / model.dx


def pressure_elastic(wall: Wall, A: Array) -> Array:
    """P_ref + P_el(A) [Pa]."""
    return wall.elastic.pressure(np.sqrt(A / wall.A0), wall.K, wall.e) + wall.P_ref


def stretch(wall: Wall, P: Array) -> Array:
    """s = √(A/A0) under the elastic pressure P [Pa]."""
    return wall.elastic.stretch(P - wall.P_ref, wall.K, wall.e)


def momentum(wall: Wall, s: Array) -> Array:
    """Π = ∫ A/ρ dP_el = (A P_el - ∫ P_el dA)/ρ from A0 [m⁴/s²]; β/(3ρ) (A^1.5 - A0^1.5) for the β-law."""
    work = 2.0 * wall.elastic.energy(s, wall.K, wall.e)
    return wall.A0 / wall.rho * (s * s * wall.elastic.pressure(s, wall.K, wall.e) - work)


def speeds(model: MusclModel, wall: Wall, s: Array, U: Array) -> tuple[Array, Array]:
    """αU and √(c² + α(α-1)U²) [m/s], whose sum and difference are the speeds of the waves."""
    alpha = model.coefficients.alpha if s.ndim == 2 else model.coefficients.alpha[..., None]
    squared = s / (2.0 * wall.rho) * wall.elastic.derivative(s, wall.K, wall.e)
    return alpha * U, np.sqrt(squared + alpha * (alpha - 1.0) * U * U)


def _at_faces(model: MusclModel, x: Array) -> Array:
    """Values at the left and right face of every cell : (B, 2, n_cells), from those of the cells.

    The slope is the settings' mean of the differences to both neighbours, or the difference to the only neighbour at an
    end of a segment.
    """
    grid, difference = model.mesh, np.diff(x, axis=-1)
    a, b = np.empty_like(x), np.empty_like(x)
    a[:, 1:], b[:, :-1] = difference, difference
    a[:, grid.first], b[:, grid.last] = b[:, grid.first], a[:, grid.last]
    half = 0.5 * SLOPES[model.settings.slopes](a, b)
    return np.stack([x - half, x + half], axis=1)


def _rusanov(flux: Array, value: Array, speed: Array) -> Array:
    """The flux of a value : (B, 2, n_cells) through both faces of each cell, between two cells.

    F = (F_left + F_right)/2 - a/2 (right - left), a the larger speed on both sides.
    """
    left, right = (..., 1, slice(None, -1)), (..., 0, slice(1, None))
    found = np.empty_like(flux)
    a = np.maximum(speed[left], speed[right])
    found[left] = 0.5 * (flux[left] + flux[right] - a * (value[right] - value[left]))
    found[right] = found[left]
    return found


def _put_ends(model: MusclModel, flux: Array, at_ends: Array) -> None:
    """Insert the fluxes : (B, 2, n_segments) at the starts and ends of segments into those of the faces."""
    flux[:, 0, model.mesh.first] = at_ends[:, 0]
    flux[:, 1, model.mesh.last] = at_ends[:, 1]
