"""The network linearised at rest, one harmonic at a time: a reference for the solvers and a first guess for fits.

With P = P_0 + P', A = A_rest + A', small Q and time dependence e^{iωt} each segment carries waves
(:mod:`~solver.transmission`). Joined ends share one pressure and have ΣQ = 0, in trees and loops alike. Valid for small
strain and U/c; the nonlinear wall viscosity and convection vanish. Source: linear one-dimensional theory, Alastruey,
Parker and Sherwin, ICPS (2012), with the Kelvin–Voigt walls of Wang, Fullana and Lagrée, Comput. Methods Biomech.
Biomed. Engng 18 (2015) 1704.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .errors import InputError
from .laws.wall import Wall
from .mesh.mesh import Topology, topology
from .network.coefficients import Coefficients, Parameters, coefficients
from .network.description import Network
from .network.table_source import refuse
from .scheme.model import sites_of
from .transmission import Places, ways

Array = np.ndarray
Inflows = Array | Mapping[str, Array]


@dataclass(frozen=True)
class Harmonics:
    """Complex amplitudes at angular frequencies omega : (n,) [rad/s]. A batch has a leading axis B on all other arrays.

    P_node : (n_nodes, n) [Pa], nodes as in :class:`~solver.mesh.mesh.Topology`. Q_inlet : (n,) [m³/s], for several
    inlets (n_inlets, n).
    Q_outlet : (n_outlets, n) [m³/s].
    P_site [Pa], Q_site [m³/s], R_site [m] : (n_sites, n). At ω = 0 they are means: absolute pressure, whole radius.
    """

    omega: Array
    P_node: Array
    Q_inlet: Array
    Q_outlet: Array
    P_site: Array
    Q_site: Array
    R_site: Array


def solve(network: Network, Q: Inflows, omega: Array, parameters: Parameters | None = None) -> Harmonics:
    """The response of the whole network to harmonics of the inflow.

    Q : (n,) or (B, n) [m³/s], complex amplitude at each ω, the mean at ω = 0; for a pressure-driven inlet that of the
    pressure [Pa]; for several inlets by driving variable, {"inlet.Q": …, "LSA.inlet.Q": …}. omega : (n,) [rad/s], not
    negative.
    parameters : replaced by name, scalars or arrays of B, as in :func:`~solver.network.coefficients.coefficients`.
    Raises ValueError if the shapes do not fit, a wall is unstable at P_0, the mean pressure or the mean flow round a
    loop is undetermined, or ω is a resonance without damping.
    """
    refuse(network.sources, "the linear theory")
    omega = _frequencies(omega)
    c = coefficients(network, parameters)
    given = [np.asarray(each, complex) for each in _of_inlets(network, Q).values()]
    for each in given:
        other_batch = each.ndim == 2 and c.batched and len(each) != c.B
        if each.ndim not in (1, 2) or each.shape[-1:] != omega.shape or other_batch:
            raise InputError(
                f"Q has shape {each.shape} with {len(omega)} frequencies and a batch of {c.B}: "
                "give Q as (n,) or (B, n)."
            )
    batched = c.batched or any(each.ndim == 2 for each in given)
    nodes = topology(network)
    n = c.L.shape[1]
    site, position = sites_of(network)
    segment = np.concatenate([np.tile(np.arange(n), 2), site])
    places, which = Places.of(network, c, segment, np.concatenate([np.repeat([0.0, 1.0], n), position]))
    found = ways(places, omega)
    # flows are expressed in Pa, as Z_ref Q, so that all equations have one scale
    Z, way = found.Z[which], found.matrix[:, :, which]
    way[1] *= (Z[:, :1] / Z)[..., None]
    way, Z_ref = np.swapaxes(way, -1, -2), Z[:, :1, None]
    outlet, at_site = n + nodes.outlet_segment, slice(2 * n, None)
    drives = np.broadcast_arrays(*map(np.atleast_2d, given))
    conditions = _conditions(network, c, nodes, found.wall.picked(0, which[:, outlet]), drives, omega, Z_ref)
    elastic = np.all(found.wall.phi0[0, which[:, :n]] == 0.0, axis=1, keepdims=True)
    lossless = bool(np.any((c.C_f == 0.0) & elastic))
    P_mid, Q_mid = (x[..., segment] for x in _middles(nodes, conditions, way[..., : 2 * n], lossless))
    P = way[0, 0] * P_mid + way[0, 1] * Q_mid
    flow = (way[1, 0] * P_mid + way[1, 1] * Q_mid) / Z_ref

    steady = np.where(omega == 0.0, 1.0, 0.0)[:, None]
    R_rest = np.sqrt(found.wall.area(places.c.P_0) / np.pi)[0, which[:, None, at_site]]
    stiffness = np.swapaxes(found.stiffness[which[:, at_site]], -1, -2)
    R = R_rest * steady + P[..., at_site] / (2.0 * np.pi * R_rest * stiffness)
    P += c.P_0[:, None] * steady
    parts = P[..., _ends(nodes)[1]], flow[..., outlet], P[..., at_site], flow[..., at_site], R
    P_node, *others = (_things_first(x, batched) for x in parts)
    Q_inlet = _things_first(flow[..., nodes.inlet_segment], batched)
    return Harmonics(omega, P_node, Q_inlet if len(given) > 1 else Q_inlet[..., 0, :], *others)


def amplitudes(network: Network, Q: Inflows, omega: Array, parameters: Parameters | None = None) -> dict[str, Array]:
    """The harmonics of :func:`solve`, (n,) or (B, n) each, by the FMU's names: ``inlet.P`` [Pa] or ``inlet.Q``,
    ``<site>.P``, ``.Q`` [m³/s] and ``.R`` [m], ``<segment>.outlet.P`` and ``.Q``."""
    h = solve(network, Q, omega, parameters)
    at_sites = {"P": h.P_site, "Q": h.Q_site, "R": h.R_site}
    at_outlets = {"P": h.P_node[..., topology(network).outlets, :], "Q": h.Q_outlet}
    at_inlets = {"P": h.P_node, "Q": h.Q_inlet if network.further_inlets else h.Q_inlet[..., None, :]}
    result = {inlet.answer: at_inlets[inlet.answer[-1]][..., i, :] for i, inlet in enumerate(network.inlets)}
    for i, site in enumerate(network.sites):
        result |= {f"{site.name}.{key}": x[..., i, :] for key, x in at_sites.items()}
    for i, outlet in enumerate(network.outlets):
        result |= {f"{outlet.segment}.outlet.{key}": x[..., i, :] for key, x in at_outlets.items()}
    return result


def waveforms(network: Network, Q: Inflows, T: float, parameters: Parameters | None = None) -> dict[str, Array]:
    """The periodic waveforms for n samples of inflow, evenly spaced over one period without its end.

    Q : (n,) or (B, n) [m³/s], or the pressure [Pa] that drives the inlet, for several as in :func:`solve`. T : period
    [s]. Returns arrays (n,) or (B, n) by the names of :func:`amplitudes`. Raises ValueError as :func:`solve`.
    """
    given = {name: np.asarray(each, float) for name, each in _of_inlets(network, Q).items()}
    for each in given.values():
        if each.ndim not in (1, 2) or each.shape[-1] == 0 or not np.all(np.isfinite(each)):
            raise InputError(
                f"Q of shape {each.shape}: must hold finite samples [m^3/s] over one period, (n,) or (B, n)."
            )
    if not (np.isfinite(T) and T > 0.0):
        raise InputError(f"T = {T:g} s: the period must be positive.")
    n = next(iter(given.values())).shape[-1]
    omega = 2.0 * np.pi / T * np.arange(n // 2 + 1)
    drive = {name: np.fft.rfft(each, norm="forward") for name, each in given.items()}
    # for even n the samples determine only the cosine of the last (Nyquist) harmonic: the mean of the responses at
    # ±ω, the real part, which irfft uses
    found = amplitudes(network, drive, omega, parameters)
    return {name: np.fft.irfft(x, n, norm="forward") for name, x in found.items()}


def _of_inlets(network: Network, Q: Inflows) -> dict[str, Array]:
    """The drive of each inlet, by name. Raises ValueError if one is missing or unknown."""
    names = [inlet.drive for inlet in network.inlets]
    if not isinstance(Q, Mapping):
        if len(names) > 1:
            raise InputError(f"Q: network {network.name} has {len(names)} inlets; give {', '.join(names)} by name.")
        return {names[0]: Q}
    if set(Q) != set(names):
        raise InputError(f"Q: it names {', '.join(Q)}; give what drives the inlets, {', '.join(names)}.")
    return {name: Q[name] for name in names}


# --- segments -----------------------------------------------------------------------------------------------------


def _frequencies(omega: Array) -> Array:
    omega = np.asarray(omega, float)
    if omega.ndim != 1 or not np.all(np.isfinite(omega)) or np.any(omega < 0.0):
        raise InputError(f"omega of shape {omega.shape}: must be a list of finite angular frequencies >= 0 rad/s.")
    return omega


def _things_first(x: Array, batched: bool) -> Array:
    """(B, n, things) -> (B, things, n), without B for a single parameter set."""
    x = np.swapaxes(x, -1, -2)
    return x if batched else x[0]


# --- the network --------------------------------------------------------------------------------------------------


def _ends(nodes: Topology) -> tuple[Array, Array]:
    """The node of every end of a segment, first all starts and then all ends; and one of the ends of every node."""
    node = np.concatenate([nodes.start, nodes.end])
    first = np.empty(nodes.n_nodes, int)
    first[node[::-1]] = np.arange(len(node))[::-1]
    return node, first


def _conditions(
    network: Network, c: Coefficients, nodes: Topology, wall: Wall, Q: Sequence[Array], omega: Array, Z_ref: Array
) -> tuple[Array, Array, Array]:
    """Coefficients (B, n, n_nodes) of a F + b P' = r at each node, F = Z_ref · flow from the node into segments.

    Inlets, Q : (B, n) of each: F = Z_ref Q, or P' given. Junction: F = 0. Outlets, with these walls: each kind's own
    (:mod:`solver.laws.outlets`).
    Raises ValueError if this leaves the mean undetermined.
    """
    _refuse_unreachable(network, c, wall)
    shape = (max(c.B, len(Q[0])), len(omega), nodes.n_nodes)
    a, b, r = np.ones(shape, complex), np.zeros(shape, complex), np.zeros(shape, complex)
    for i, (inlet, given) in enumerate(zip(network.inlets, Q, strict=True)):
        if inlet.causality == "flow":
            r[..., i] = Z_ref[..., 0] * given
        else:
            a[..., i], b[..., i], r[..., i] = 0.0, 1.0, given - c.P_0 * (omega == 0.0)
    for ends in c.outlets:
        at = nodes.outlets.start + ends.index
        a[..., at], b[..., at], r[..., at] = ends.condition(wall.at(ends.index), c.P_0, omega, Z_ref)
    if np.any(omega == 0.0):
        _check_mean(network, c, nodes, a, b)
    return a, b, r


def _refuse_unreachable(network: Network, c: Coefficients, wall: Wall) -> None:
    for ends in c.outlets:
        bad = ends.kind.unreachable(ends.numbers, wall.at(ends.index), c.P_0)
        for b, i in np.argwhere(bad) if bad.any() else ():
            o = ends.index[i]
            raise InputError(
                f"outlet {network.outlets[o].segment}: no stable wall carries P_0 - P_venous = "
                f"{c.P_0[b, 0] - c.P_venous[b, o]:g} Pa; bring P_venous nearer to P_0 - P_ref."
            )


def _check_mean(network: Network, c: Coefficients, nodes: Topology, a: Array, b: Array) -> None:
    """a, b : of a F + b P' = r at the nodes. A given flow, a closed end and a junction have b = 0, a given pressure
    a = 0."""
    if np.any(np.all(b == 0.0, axis=-1)):
        raise InputError(
            f"network {network.name}: all outlets are closed, so the mean pressure is undetermined; "
            "open one (R_t below 1) or leave out omega = 0."
        )
    # two prescribed pressures close a loop through the ground
    prescribed = int(np.sum(np.all(a == 0.0, axis=(0, 1))))
    loops = len(nodes.start) - nodes.n_nodes + 1 + max(prescribed - 1, 0)
    if loops > 0 and np.any(c.C_f == 0.0):
        raise InputError(
            f"network {network.name}: without friction the mean flow round its {loops} loop(s) is undetermined; "
            "give nu and friction above 0 or leave out omega = 0."
        )


def _middles(
    nodes: Topology, conditions: tuple[Array, Array, Array], way: Array, lossless: bool
) -> tuple[Array, Array]:
    """e^{γL/2} times P' and Z Q at the middle of each segment, (B, n, n_segments): 2 unknowns per segment.

    The equations are the conditions at the nodes, and a common pressure of all ends at a node. way : to the starts and
    to the ends of the segments.
    """
    a, b, r = conditions
    n, n_nodes = len(nodes.start), nodes.n_nodes
    node, first = _ends(nodes)
    others = np.delete(np.arange(2 * n), first)
    same = first[node[others]]
    leaves = np.repeat([1.0, -1.0], n)  # a flow leaves a node at a start
    of_flow, of_pressure, row = a[..., node] * leaves, b[..., node], n_nodes + np.arange(len(others))
    M = np.zeros((*r.shape[:-1], 2 * n, 2 * n), complex)
    for column, (P, F) in zip((np.arange(n), np.arange(n, 2 * n)), np.swapaxes(way, 0, 1), strict=True):
        each = of_flow * F + of_pressure * P  # where b is not 0, one end alone is at the node
        M[..., nodes.start, column] = each[..., :n]
        M[..., nodes.end, column] += each[..., n:]
        M[..., row, column[same % n]] = P[..., same]
        M[..., row, column[others % n]] -= P[..., others]
    right = np.concatenate([r, np.zeros((*r.shape[:-1], len(others)))], axis=-1)
    try:
        x = np.linalg.solve(M, right[..., None])[..., 0]
        singular = not np.all(np.isfinite(x)) or (lossless and np.max(np.linalg.cond(M, 1)) > 1e13)
    except np.linalg.LinAlgError:
        singular = True
    if singular:
        raise InputError(
            "a frequency is a resonance of elastic vessels without friction: the answer is unbounded or not unique; "
            "give nu and friction or phi0 above 0, or move the frequency."
        )
    return x[..., :n], x[..., n:]
