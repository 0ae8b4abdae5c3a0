"""The limits of the equations: conditions on a solution, and the sentences for their violation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NoReturn

import numpy as np

from ..errors import NonPhysicalState, NotConverged
from .model import Model

Array = np.ndarray

VISCOSITY_REASON = "the effective wall viscosity turned negative: the strain rate passed {:.3g} 1/s"
BARE_REMEDY = ", or use shorter elements: a wall without viscosity damps no short waves"
UNSOLVED = ("the step did not converge", "use a smaller dt or check the parameters there")


def check(model: Model, A: Array, A_t: Array, Q: Array, t: float) -> None:
    """Raise NonPhysicalState unless A > 0, effective viscosity > 0, dP/dA > 0 and |U| < c everywhere."""
    # without area or stiffness, the last margin is not positive either
    *first, _, _, last = margins(model, A, A_t, Q)
    if all(margin.item(margin.argmin()) > 0.0 for margin, _, _ in (*first, last)):
        return
    for margin, reason, remedy in margins(model, A, A_t, Q):
        if not margin.min() > 0.0:
            _fail(NonPhysicalState, model, margin, t, reason(), remedy)


def physical(model: Model, A: Array, A_t: Array, Q: Array) -> Array:
    """The members that meet the conditions of :func:`check` : (B,)."""
    hold = [(margin > 0.0).all(axis=(1, 2)) for margin, _, _ in margins(model, A, A_t, Q)]
    return np.logical_and.reduce(hold)


def refuse(
    model: Model, A: Array, A_t: Array, Q: Array, H: Array, changes: Array, venous: Array, done: Array, t: float
) -> NoReturn:
    """Raise NotConverged for a stage that did not converge; the reason is from outlets or :func:`check`, if any.

    A, A_t, Q, H : the last finite iterate. changes : (B, n_e) of Q in it. ``done`` members have converged.
    """
    nodes = model.mesh.topology
    for ends in model.coefficients.outlets:
        numbers = {**ends.numbers, "P_venous": venous[..., ends.index]}
        P = H[:, nodes.outlets][:, ends.index]
        lost = ends.kind.unreachable(numbers, model.outlet_wall.at(ends.index), P)
        for b, o in np.argwhere(~done[:, None] & lost):
            s = nodes.outlet_segment[ends.index[o]]
            name = model.network.segments[s].name
            raise NotConverged(
                "the wall at the outlet cannot carry the pressure P - P_venous" + _member(model, int(b)),
                name,
                _length(model, int(b), s),
                t,
                f"check {name}.outlet.P_venous and the elastic law",
            )
    innocent = np.where(done, np.inf, 0.0)[:, None, None]
    for margin, reason, remedy in margins(model, A, A_t, Q):
        if not np.min(margin + innocent) > 0.0:
            _fail(NotConverged, model, margin + innocent, t, reason(), remedy)
    margin = innocent - changes[..., None] / model.wall.A0
    _fail(NotConverged, model, margin, t, *UNSOLVED)


def margins(model: Model, A: Array, A_t: Array, Q: Array) -> Iterator[tuple[Array, Callable[[], str], str]]:
    """Quantities that must stay positive : (B, n_e, N), the sentence if not, and the remedy; in the order of the
    test."""
    wall = model.wall
    if wall.nonlinear:
        # tested first: if it is negative, the iteration diverges, and so does the area
        relative = np.nan_to_num(wall.relative_viscosity(A, A_t), nan=np.inf)
        remedy = 'use viscous_law = "monotone", a smaller |phiNL/phi0| or a lower inflow'
        yield relative, lambda: _viscosity_reason(model, relative), remedy
    yield A, lambda: "the area fell to zero or below", "lower the inflow or check R0, E and h there"
    speed = wall.wave_speed(A)
    yield speed, lambda: "the wall has no stiffness left (dP/dA <= 0)", "lower the pressure, or |ENL/E|"
    subcritical = speed - np.abs((Q @ model.mesh.element.at_gauss) / A)
    yield subcritical, lambda: "the flow is supercritical (|Q/A| >= c)", "lower the inflow or stiffen the wall"


def _viscosity_reason(model: Model, relative: Array) -> str:
    r = np.broadcast_to(model.wall.r, relative.shape)[_worst(relative)]
    return VISCOSITY_REASON.format(-0.5 / r)


def _member(model: Model, b: int) -> str:
    return f" in parameter set {b} of the batch" if model.coefficients.batched else ""


def _length(model: Model, b: int, s: int) -> float:
    """The length of a segment [m]; several states may share one parameter set."""
    return float(model.coefficients.L[b if model.coefficients.batched else 0, s])


def _worst(margin: Array) -> tuple[int, int, int]:
    """The point (b, e, g) where a margin : (B, n_e, N) is smallest, in the first member where it is not positive.

    Members may be equal to round-off, which must not choose among them.
    """
    margin = np.nan_to_num(margin, nan=-np.inf)
    b = int(np.argmin(margin.min(axis=(1, 2)) > 0.0))
    e, g = map(int, np.unravel_index(int(np.argmin(margin[b])), margin.shape[1:]))
    return b, e, g


def _fail(error: type[NonPhysicalState], model: Model, margin: Array, t: float, reason: str, remedy: str) -> NoReturn:
    """Raise the error at the worst point of ``margin`` : (B, n_e, N)."""
    b, e, g = _worst(margin)
    s = int(model.mesh.segment[e])
    x = float(model.mesh.positions(model.mesh.element.x_gauss)[e, g]) * _length(model, b, s)
    if model.wall.phi0[b if model.coefficients.batched else 0, e, g] == 0.0:
        remedy += BARE_REMEDY
    raise error(reason + _member(model, b), model.network.segments[s].name, x, t, remedy)
