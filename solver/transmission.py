"""Small waves along segments: pressure and flow at a place relative to those at the middle of its segment.

With time dependence e^{iωt} about a state at rest, `momentumConserv_AQ` and `sheep_constitutive` become

    dP'/dx = -Z' Q,     Z' = (ρ/A_rest)(iω + C_f/A_rest + Σ weight_i iω/(iω + rate_i))
    dQ/dx = -Y' P',     Y' = iω/(dP_el/dA + iω ν_s Σ share_j/(1 + iωτ_j)) + g

with waves e^{±γx}, γ² = Z'Y', and characteristic impedance Z_c² = Z'/Y'. A segment is described by the pressure and the
flow at its middle (s = x - L/2), which is regular at ω = 0, without friction, at resonance and for large γL alike:

    P'(x) = P'_mid cosh γs - Q_mid Z_c sinh γs,     Q(x) = Q_mid cosh γs - P'_mid sinh(γs)/Z_c

The sums belong to the effects unsteady_friction, stress_relaxation and fractional_viscosity, g to side_branch of
:mod:`~solver.laws.effects`; a stenosis vanishes at rest. Where walls vary along a segment, the way
from the middle to x is a chain of pieces: the error falls with the fourth power of their length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError
from .laws.effect import Points
from .laws.wall import Wall
from .network.coefficients import Coefficients, changes
from .network.description import Network

Array = np.ndarray

_PIECES = 4  # from the middle of a segment to any place in it, where a wall varies
_OF_PARTS = 64  # the same where parts of a wall begin and end: 7e-6 of P and R for 20 E (measured), 3e-2 with four
_GAUSS = 0.5 + np.array([-1.0, 1.0]) * np.sqrt(3.0) / 6.0  # points of a piece
_NEAR = 1e-2  # of x, below which (1 - e^{-x})/x is a series: either way it is exact to 1e-13


@dataclass(frozen=True)
class Places:
    """Places in the segments of a network, equal ones of several members of a batch once: members often differ in few
    parameters.

    c : one member with the segment of each of the n places. segment : (n,) which of the network that is. x : (n,) x/L.
    """

    network: Network
    c: Coefficients
    segment: Array
    x: Array

    @staticmethod
    def of(network: Network, c: Coefficients, segment: Array, x: Array) -> tuple[Places, Array]:
        """Places of all members, and which of them each point x/L of a segment is : (B, n_points)."""
        numbers = c.numbers[:, segment]
        whole = np.concatenate([numbers, np.broadcast_to(x[:, None], (*numbers.shape[:2], 1))], axis=-1)
        rows = whole.view((np.void, whole.itemsize * whole.shape[-1])).ravel().tolist()
        found: dict[bytes, int] = {}  # the first that is equal
        like = np.array([found.setdefault(row, i) for i, row in enumerate(rows)])
        first = np.fromiter(found.values(), int)
        member, point = np.divmod(first, len(x))
        places = Places(network, c.picked(member, segment[point]), segment[point], x[point])
        return places, np.searchsorted(first, like).reshape(-1, len(x))


@dataclass(frozen=True)
class Ways:
    """From the middles of segments to n places in them.

    matrix : (2, 2, n, n_omega), P' and Z Q there from those at the middle, times e^{-γL/2} with γ of the middle, so
    that nothing overflows however large γL is. Z : (n,) [Pa·s/m³], which gives flows the scale of pressures.
    wall : at the places, arrays (1, n); stiffness : P'/A' [Pa/m²] of them, (n, n_omega).
    """

    matrix: Array
    Z: Array
    wall: Wall
    stiffness: Array


def ways(places: Places, omega: Array) -> Ways:
    """The ways to places as products of e^Ω over pieces of length d. With 1 and 2 at (1/2 ∓ √3/6) d of a piece (fourth
    order: S. Blanes et al., Phys. Rep. 470 (2009) 151),

        Ω = | -a  -b |     a = √3 d²/12 (Z'_1 Y'_2 - Z'_2 Y'_1)     b = d (Z'_1 + Z'_2)/2     c = d (Y'_1 + Y'_2)/2
            | -c   a |     e^Ω = cosh μ + Ω sinh(μ)/μ     μ² = a² + b c
    """
    n, base, L, pieces = len(places.x), places.c.base, places.c.L[0], _PIECES
    along = (term for term in places.c.terms if term.effect.owner == "segment" and changes(term.effect, "wall"))
    if any(term.effect.cut_at(term.values) for term in along):
        pieces = _OF_PARTS
    gauss = (np.arange(pieces)[:, None] + _GAUSS) / pieces
    parts = np.concatenate([[0.0, 1.0], gauss.ravel()])  # of the way: middle, place, and the points of all pieces
    x, own = (0.5 + np.outer(parts, places.x - 0.5)).ravel(), np.tile(np.arange(n), len(parts))
    wall = places.c.wall_at(own, x)
    if not wall.varies(n):
        pieces, used = 1, slice(4 * n)
        wall, x, own = wall.at(used), x[used], own[used]
    Z, Y, stiffness = line(places, wall, own, x, omega)
    half = 0.5 * L[:, None] * np.sqrt(Z[:n] * Y[:n])  # γL/2
    Z0 = base.rho[0] * base.c0[0] / base.A0[0]
    back, shape = L * (0.5 - places.x) / pieces, (pieces, 2, n, len(omega))  # -d
    z = (0.5 * back / Z0)[:, None] * Z[2 * n :].reshape(shape)
    y = (0.5 * back * Z0)[:, None] * Y[2 * n :].reshape(shape)
    b, c, a = z.sum(axis=1), y.sum(axis=1), (z[:, 0] * y[:, 1] - z[:, 1] * y[:, 0]) / np.sqrt(3.0)  # -b, -c, a
    mu = np.sqrt(a * a + b * c)
    even, odd = _modes(mu)
    step = np.empty((2, 2, *mu.shape), complex)
    a *= odd
    np.subtract(even, a, out=step[0, 0])
    np.multiply(odd, b, out=step[0, 1])
    np.multiply(odd, c, out=step[1, 0])
    np.add(even, a, out=step[1, 1])
    whole = step[:, :, 0]
    for k in range(1, pieces):
        whole = step[:, :1, k] * whole[0] + step[:, 1:, k] * whole[1]
    there = slice(n, 2 * n)
    return Ways(whole * np.exp(mu.sum(axis=0) - half), Z0, wall.at(there), stiffness[there])


def line(places: Places, wall: Wall, own: Array, x: Array, omega: Array) -> tuple[Array, Array, Array]:
    """Z', Y' and the dynamic stiffness P'/A' [Pa/m²], (n_points, n_omega), of walls at points x/L of the places' own
    segments.

    Raises InputError for a wall that is unstable at P_0, the mean flow of a leak, and a linear drag on a part of a
    segment.
    """
    network, c = places.network, places.c
    P_0 = c.P_0[:, own]
    with np.errstate(invalid="ignore"):
        A = wall.area(P_0)
        stiffness = wall.stiffness(A)
    for i in np.flatnonzero(~(stiffness[0] > 0.0))[:1]:
        raise InputError(
            f"segment {network.segments[places.segment[own[i]]].name}: its wall is unstable at P_0 = {P_0[0, i]:g} Pa "
            f"(dP_el/dA = {stiffness[0, i]:g} Pa/m^2, must be positive); change E, ENL or P_0."
        )
    if wall.leakage.any() and np.any(omega == 0.0):
        raise InputError(
            f"network {network.name}: the mean flow of a leak depends on the mean pressure; leave out omega = 0."
        )
    iw = 1j * omega
    viscosity = wall.viscosity(A, np.zeros_like(A))[0, :, None]  # with a learned stress
    if wall.remembers:
        first, *others = wall.responses(iw[:, None])[:, 0].swapaxes(1, 2)
        viscosity = viscosity * first + (wall.viscosity_area / A)[0, :, None] * sum(others)
    dynamic = stiffness[0, :, None] + iw * viscosity
    Z = (c.rho[:, own] / A)[0, :, None] * ((c.C_f[:, own] / A)[0, :, None] + iw + _history(c, wall, own, x, iw))
    Y = iw / dynamic
    return Z, Y + wall.leakage[0, :, None] if wall.leaks else Y, dynamic


def _history(c: Coefficients, wall: Wall, own: Array, x: Array, iw: Array) -> Array | float:
    """Σ weight iω/(iω + rate) [1/s] of the drag of all effects : (n_points, n_omega), at points x/L of segments.

    Raises InputError for a linear drag on a part of a segment.
    """
    found: Array | float = 0.0
    for term in (term for term in c.terms if changes(term.effect, "drag")):
        # every point as a whole element
        each = Points(
            x=x[:, None],
            left=np.zeros((len(x), 1)),
            right=np.ones((len(x), 1)),
            R0=np.sqrt(wall.A0 / np.pi)[..., None],
            L=c.L[:, own, None],
            nu=c.nu[:, own, None],
            integral=np.array([[0.5, 0.5]]),
        )
        drag = term.effect.drag({key: value[..., None] for key, value in term.at(own).items()}, each)
        if drag is not None:
            if drag.weight.any() and term.effect.cut_at(term.at(own)):
                raise InputError(
                    f"{term.effect.name}: the linear theory knows a linear drag along a whole segment only, and this "
                    "acts on a part; use beat_harmonics with a small inflow."
                )
            weight, poles = drag.weight[:, 0], iw + drag.rate[:, 0]  # 0 of a steady flow without relaxation: y = U
            found = found + (weight * np.divide(iw, poles, out=np.ones_like(poles), where=poles != 0.0)).sum(axis=0)
    return found


def _modes(mu: Array) -> tuple[Array, Array]:
    """e^{-μ} cosh μ and e^{-μ} sinh(μ)/μ: exact at μ = 0, no overflow however large μ."""
    x = 2.0 * mu
    e = np.exp(-x)
    near = np.abs(x) < _NEAR
    odd = (1.0 - e) / np.where(near, 1.0, x)
    small = x[near]
    odd[near] = 1.0 - small / 2.0 * (1.0 - small / 3.0 * (1.0 - small / 4.0 * (1.0 - small / 5.0)))
    return 0.5 * (1.0 + e), odd
