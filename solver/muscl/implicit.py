"""The implicit part of a step: wall viscosity and friction in the cells, and the conditions at the nodes.

In the cells, with Q, the flows at the ends of the segment, and the elastic pressure known,

    (w + C_f/A) Q - A/ρ ∂/∂x (ν_s ∂Q/∂x) = w Q_before

a tridiagonal system. It is solved for three right-hand sides: the known terms, and a unit flow at either end. So the
pressure at both ends is linear in the flows there,

    H = P_in + Z (Q_end - Q_in) - ν_s ∂Q/∂x + k ρ/2 U²,        Z = ρ c²/(A λ)

with P_in, Q_in extrapolated from the cells, and λ the speed of the incoming wave: > 0 at the start of a segment, < 0 at
its end. Then ΣQ = 0 at the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..laws.outlets import Load
from .flux import pressure_elastic, speeds, stretch
from .model import MusclModel

Array = np.ndarray

_OUT = np.array([[-1.0], [1.0]])  # sign of the flow into the node, at starts and ends of segments


@dataclass(frozen=True)
class Solved:
    """The flow Q : (B, n_cells), and at the ends of the segments flow and elastic pressure : (B, 2, n_segments);
    H : (B, n_nodes) pressures at the nodes."""

    Q: Array
    Q_end: Array
    P_end: Array
    H: Array


@dataclass(frozen=True)
class Nodes:
    """The conditions at the nodes besides ΣQ. drives : (n_inlets, B) [m³/s] or [Pa]; kinds : outlets, load; behind :
    (B, n_outlets) [Pa] the pressures behind the outlets; H : (B, n_nodes) [Pa], about which loads are linearised."""

    drives: Array
    kinds: tuple[tuple[Array, Load], ...]
    behind: Array
    H: Array


def solve(model: MusclModel, A: Array, Q: Array, known: Array, weight: float, nodes: Nodes) -> Solved:
    """The flow at the end of a step with the area A : (B, n_cells).

    known : (B, n_cells) [m³/s²] is ``weight`` [1/s] times the flow without viscosity and friction; Q : a guess.
    """
    grid, ends = model.mesh, model.ends
    # at both ends, from the outer and the inner cell : (B, 2, 2, n_segments)
    P = pressure_elastic(model.wall.at(grid.at_ends.ravel()), A[:, grid.at_ends.ravel()]).reshape(
        -1, *grid.at_ends.shape
    )
    P_in, Q_guess = _extrapolated(P), _extrapolated(Q[:, grid.at_ends])
    s = stretch(ends, P_in)
    A_in = ends.A0 * s * s
    U = Q_guess / A_in
    carried, root = speeds(model, ends, s, U)
    c_squared = s / (2.0 * ends.rho) * ends.elastic.derivative(s, ends.K, ends.e)
    Z = ends.rho * c_squared / (A_in * (carried - _OUT * root))
    viscous = model.end_viscosity / A_in / (3.0 * model.dx[:, grid.at_ends[:, 0]])

    X = _tridiagonal(model, A, known, weight, viscous)
    outer, inner = (X[..., grid.at_ends[:, i]] for i in range(2))
    Q_in = 1.5 * outer - 0.5 * inner
    kinetic = model.kinetic * U / A_in
    H = -Z * Q_in + viscous * _OUT * (9.0 * outer - inner)  # known terms, flow at the left and right end
    for i in range(2):
        H[1 + i, :, i] += Z[:, i] - 8.0 * viscous[:, i] * _OUT[i] + kinetic[:, i]
    H[0] += P_in - 0.5 * kinetic * Q_guess
    Q_end, H_nodes = _meet(model, H, nodes)
    at_left, at_right = (Q_end[:, i, grid.segment] for i in range(2))
    P_end = P_in + Z * (Q_end - Q_in[0] - Q_in[1] * Q_end[:, :1] - Q_in[2] * Q_end[:, 1:])
    return Solved(X[0] + X[1] * at_left + X[2] * at_right, Q_end, P_end, H_nodes)


def _extrapolated(x: Array) -> Array:
    """From the outer and inner cell to the end, (B, 2, n_segments) of (B, 2, 2, n_segments)."""
    return 1.5 * x[:, :, 0] - 0.5 * x[:, :, 1]


def _tridiagonal(model: MusclModel, A: Array, known: Array, weight: float, viscous: Array) -> Array:
    """The flows for the known terms, and for a unit flow at the left and at the right end : (3, B, n_cells).

    ∂Q/∂x at an end is (-8 Q_end + 9 Q_outer - Q_inner)/(3 dx), of second order; viscous : ν_s/(3 dx) there.
    """
    from scipy.linalg.lapack import dgtsv  # imported only if this scheme is used, unlike in an FMU

    grid, per_length = model.mesh, A / (model.wall.rho * model.dx)
    between = model.viscosity / (0.5 * (A[:, 1:] + A[:, :-1]) * model.dx[:, 1:])
    above, below = np.zeros_like(A), np.zeros_like(A)
    above[:, :-1] = -per_length[:, :-1] * between
    below[:, 1:] = -per_length[:, 1:] * between
    diagonal = weight + model.coefficients.C_f / A - above - below
    right = np.zeros((3, *A.shape))
    right[0] = known
    for i, (cells, inward) in enumerate(((grid.first, above), (grid.last, below))):
        at_end = per_length[:, cells] * viscous[:, i]
        diagonal[:, cells] += 9.0 * at_end
        inward[:, cells] -= at_end
        right[1 + i][:, cells] = 8.0 * at_end
    *_, found, _ = dgtsv(below.ravel()[1:], diagonal.ravel(), above.ravel()[:-1], right.reshape(3, -1).T)
    return np.ascontiguousarray(found.T).reshape(right.shape)


def _meet(model: MusclModel, H: Array, nodes: Nodes) -> tuple[Array, Array]:
    """Flows at the ends of the segments : (B, 2, n_segments), and pressures at the nodes : (B, n_nodes).

    H : (3, B, 2, n_segments) the pressure at an end as H[0] + H[1] Q_left + H[2] Q_right.
    """
    grid, first = model.mesh, model.mesh.topology.outlets.start
    (a, b), (c, d) = ((H[1, :, i], H[2, :, i]) for i in range(2))
    inverse = np.stack([np.stack([d, -b], 1), np.stack([-c, a], 1)], 1) / (a * d - b * c)[:, None, None]
    at_rest = -(inverse * H[0][:, None]).sum(axis=2)  # flow at zero pressure in the nodes
    net = _summed(_OUT * at_rest, grid.nodes, grid.topology.n_nodes)
    scale, less = np.ones_like(net), np.zeros_like(net)
    for node, (inlet, drive) in enumerate(zip(model.network.inlets, nodes.drives, strict=True)):
        if inlet.causality == "flow":
            net[:, node] += drive
        else:
            scale[:, node], less[:, node], net[:, node] = 0.0, 1.0, drive
    for index, load in nodes.kinds:
        at = first + index
        P = nodes.H[:, at] - nodes.behind[:, index]
        scale[:, at], less[:, at] = load.scale, load.slope(P)
        net[:, at] = scale[:, at] * net[:, at] - load.flow(P) + less[:, at] * nodes.H[:, at]
    products = np.moveaxis(_OUT[:, None] * inverse, 3, 1).reshape(len(net), -1)
    found = grid.elimination.factor(products, scale, less).solve(net)
    return at_rest + (inverse * found[:, grid.nodes][:, None]).sum(axis=2), found


def _summed(values: Array, targets: Array, n: int) -> Array:
    """(B, n) sums of values : (B, …) by their targets : (…)."""
    B = len(values)
    everywhere = (n * np.arange(B)[:, None] + targets.ravel()).ravel()
    return np.bincount(everywhere, values.ravel(), B * n).reshape(B, n)
