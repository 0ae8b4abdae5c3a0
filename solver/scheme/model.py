"""The discrete equations of one network on one mesh, with the conditions at its inlets: from a network to a frozen
:class:`Model`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import InputError
from ..laws.effect import Drag, Points
from ..laws.wall import Wall
from ..mesh.mesh import Index, Layout, Mesh, as_slice, build_mesh
from ..mesh.sources import Tables
from ..network.coefficients import Coefficients, Parameters, changes, coefficients
from ..network.description import Network
from ..network.validation import check_parameters
from ..quantities.quantity import quantities, quantity
from .damping import Damping, damping, undamped
from .drag_and_leak import DragForce, Force, Leaking, NoForce, Storage, Tight
from .sdirk import INFLOW_AT_STAGES, INFLOW_TIMES, VALUES_AT_STAGES

Array = np.ndarray

_ROUND_OFF = 1e-13  # of A0 c0 and of the wall stiffness: smaller corrections are round-off of a network at rest


@dataclass(frozen=True)
class Settings:
    """Numerical settings, which do not depend on the wall, so that solutions are continuous in φ0.

    dt : time step [s]. element_length : longest element [m]. degree : N of the flow polynomial. tolerance : last
    correction of the flows in a stage, relative to the largest; ten times that for the nodal pressures.
    """

    dt: float = quantity(1e-3, "s", "internal time step", 1e-7, 0.1, nominal=1e-3, display="ms", tunable=False)
    element_length: float = quantity(0.05, "m", "longest element", 1e-4, 10.0, nominal=0.1, display="cm", tunable=False)
    degree: int = 3
    tolerance: float = quantity(3e-5, "1", "tolerance of the iterations", 1e-13, 0.1)

    def __post_init__(self) -> None:
        for name, allowed in quantities(Settings).items():
            allowed.check(f"settings: {name}", getattr(self, name))
        if not isinstance(self.degree, (int, np.integer)) or not 1 <= self.degree <= 12:
            raise InputError(f"settings: degree = {self.degree!r} must be an integer from 1 to 12.")


@dataclass(frozen=True)
class Inlets:
    """The condition at each inlet, 0 = scale ΣQ + gain drive - slope H, all (B, n_inlets).

    A given flow enters the node: 0 = ΣQ + Q. A given pressure: 0 = (P - H)/Z with Z = ρ c0/A0 of the artery, so that it
    has the unit of flow, as at other nodes. by_flow, first : (n_inlets,) True for a given flow, and the columns of the
    state vector with the flow there.
    """

    by_flow: Array
    scale: Array
    gain: Array
    slope: Array
    first: Array

    @staticmethod
    def of(by_flow: Array, Y: Array, first: Array) -> Inlets:
        """For inlets with or without given flow : (n_inlets,), in arteries of admittance Y = 1/Z : (B, n_inlets)."""
        scale = np.where(by_flow, 1.0, np.zeros_like(Y))
        return Inlets(by_flow, scale, np.where(by_flow, 1.0, Y), np.where(by_flow, 0.0, Y), first)

    def each(self, drive: Array) -> Array:
        """The drive of each inlet at the times of a step, (n_inlets, 4, B or 1); a single inlet may omit its axis."""
        return np.reshape(drive, (len(self.by_flow), len(INFLOW_TIMES), -1))

    def at_stages(self, drive: Array) -> Array:
        """gain drive at the stages of a step : (STAGES, B, n_inlets) [m³/s], from drive : (n_inlets, 4, B or 1)."""
        return self.gain * np.matmul(self._at_stages, drive).transpose(1, 2, 0)

    def begin(self, y: Array, drive: Array) -> None:
        """Start a step from y : (B, n) with drive : (n_inlets, B or 1). If a given inflow jumps (a held input with a
        new value), so does the flow at the inlet; if a given pressure jumps, the flow follows by its inertia.

        Spread over the step, the jump would appear in the inlet pressure as its inertia divided by dt.
        """
        inlets, columns = self._set
        y[:, columns] = drive[inlets].T

    def flow(self, given: Array, H: Array) -> Array:
        """The condition without ΣQ, for given = gain drive and the pressures H : (B, n_inlets) [m³/s]."""
        return given - self.slope * H

    @cached_property
    def _at_stages(self) -> Array:
        return np.where(self.by_flow[:, None, None], INFLOW_AT_STAGES, VALUES_AT_STAGES)

    @cached_property
    def _set(self) -> tuple[Index, Index]:
        """The inlets with given flows, and their columns."""
        return as_slice(np.flatnonzero(self.by_flow)), as_slice(self.first[self.by_flow])


@dataclass(frozen=True, eq=False)
class Model:
    """A network, or a batch of B parameter sets of it, as the arrays of its equations. Made by :func:`build`.

    parameters : values that replace the network's own. layout : of the state vector: A (n_e, N) [m²]; Q (n_e, N+1)
    [m³/s]; P_C (n_outlets,) [Pa]; stress (m, n_e, N) [Pa], of the elements of walls with memory; history (m, n_e, N+1)
    [m/s], of a force with memory.
    wall : (B, n_e, N). outlet_wall : (B, n_outlets). site_wall : (B, n_sites). on_parts : (n_sites,)
    whether parts of the wall begin and end in the segment. minus_J_inverse, kinetic : (B, n_e, N)
    -1/J and ½ρα. mass, friction : (B, n_e, N+1) ρ w J and ρ w J C_f. end_kinetic : (B, n_e, N+1) ½ρ(α - k) at the
    element ends, times the outward normal there. A_rest : (B, n_e, N). flow_floor, pressure_floor : (B,) corrections
    that are round-off; impedance : (B,) ρ c0/A0, which converts flow into pressure. All are per member, so that a batch
    does not change a member's solution.
    memo : operators by dt, made by :func:`~solver.scheme.stage.operators`.
    """

    network: Network
    settings: Settings
    parameters: Parameters
    coefficients: Coefficients
    mesh: Mesh
    layout: Layout
    wall: Wall
    outlet_wall: Wall
    minus_J_inverse: Array
    mass: Array
    friction: Array
    kinetic: Array
    end_kinetic: Array
    damping: Damping
    force: Force
    storage: Storage
    inlets: Inlets
    tables: Tables
    A_rest: Array
    flow_floor: Array
    pressure_floor: Array
    impedance: Array
    site_wall: Wall
    on_parts: Array
    memo: dict[float, Any] = field(default_factory=dict, repr=False)

    def with_parameters(self, changed: Parameters) -> Model:
        """The same model on the same mesh, with some parameters changed; only their owners are checked.

        Raises ValueError as :func:`build`.
        """
        parameters = {**self.parameters, **changed}
        owners = {name.rpartition(".")[0] for name in changed}
        check_parameters(self.network, {n: v for n, v in parameters.items() if n.rpartition(".")[0] in owners})
        c = coefficients(self.network, parameters, checked=False)
        return _possible(lay_out(self.network, parameters, self.settings, c, self.mesh))

    def members(self, index: Array) -> Model:
        """The model of some of its parameter sets. Effects that are 0 in these stay, so that the equations are those of
        the whole batch, and one program solves both."""
        B = self.coefficients.B
        own = {name: np.broadcast_to(value, B)[index] for name, value in self.parameters.items()}

        def some(x: Array, axis: int | None) -> Array:
            batched = axis is not None and x.dtype == float and x.ndim > axis and x.shape[axis] == B
            return x.take(index, axis) if batched else x

        return replace(rebuilt(replace(self, parameters={}, memo={}), some), parameters=own)

    def repeated(self, times: int) -> Model:
        """A batch with all parameter sets repeated ``times`` times, one after the other."""
        return self.members(np.tile(np.arange(self.coefficients.B), times))

    @property
    def damps_itself(self) -> bool:
        """True if the viscosity of all walls damps the waves that the elements do not resolve."""
        Z = undamped(self.mesh, self.wall, self.A_rest, -2.0 / self.minus_J_inverse[..., :1])
        return bool((Z <= 0.0).all())

    def at_rest(self) -> Array:
        """The state vector of a fluid at rest under P_0, with walls that have always been at rest."""
        y = np.zeros_like(self.A_rest, shape=(self.coefficients.B, self.layout.size))
        self.layout.part(y, "A")[:] = self.A_rest
        self.layout.part(y, "P_C")[:] = self.coefficients.P_0
        return y


def build(
    network: Network, parameters: Parameters | None = None, settings: Settings | None = None,
    lengths: Sequence[float] | None = None,
) -> Model:  # fmt: skip
    """The model of a network with some parameters replaced by numbers or by arrays of B numbers.

    lengths : (n_segments,) [m] by which segments are cut into elements; default: the longest of the B.
    Raises ValueError for parameters that are not allowed.
    """
    settings = settings or Settings()
    c = coefficients(network, parameters)
    L = c.L.max(axis=0) if lengths is None else np.array(lengths, float)
    mesh = build_mesh(network, L, settings.element_length, settings.degree, c.cuts)
    return _possible(lay_out(network, dict(parameters or {}), settings, c, mesh))


def rebuilt(
    x: Any, array: Callable[[Array, int | None], Any], other: Callable[[Any], None] = lambda x: None,
    axis: int | None = 0,
) -> Any:  # fmt: skip
    """Frozen objects with ``array(x, axis)`` in place of each of their arrays. axis : of the members of a batch, by
    MEMBER_AXIS of its class; None if all members share it. other : is called with everything else that the objects
    consist of, in its order: classes, keys, and values without arrays."""
    if isinstance(x, np.ndarray):
        return array(x, axis)
    if isinstance(x, tuple):
        parts = [rebuilt(part, array, other) for part in x]
        return type(x)(*parts) if hasattr(x, "_fields") else tuple(parts)
    if isinstance(x, Mapping):
        other(tuple(x))
        return {key: rebuilt(value, array, other) for key, value in x.items()}
    if not is_dataclass(x) or isinstance(x, (type, Network, Settings, Mesh, Layout)):
        other(x)
        return x
    other(type(x))
    axes: Mapping[str, int | None] = getattr(x, "MEMBER_AXIS", {})
    each = [(f.name, getattr(x, f.name)) for f in fields(x) if f.init]
    return replace(x, **{name: rebuilt(value, array, other, axes.get(name, 0)) for name, value in each})


def lay_out(
    network: Network, parameters: Parameters, settings: Settings, c: Coefficients, mesh: Mesh, every: bool = False
) -> Model:
    """Distribute the numbers from segments (B, n_segments) to points (B, n_e, N) and (B, n_e, N+1). every : include the
    damping of high degrees even if it is 0."""
    el, ends = mesh.element, mesh.topology.outlet_segment
    wall = _walls(c, mesh, el.x_gauss)
    # full contiguous arrays: broadcasting over a last axis of length N is several times slower
    gauss, lobatto = (c.B, mesh.n_elements, el.N), (c.B, mesh.n_elements, el.N + 1)
    J = (c.L[:, mesh.segment] / mesh.parts)[..., None] / 2.0
    rho, alpha = c.rho[..., None], c.alpha[..., None]
    mass = np.broadcast_to(rho * el.w_lobatto * J, lobatto).copy()
    force = _force(c, mesh, mass)
    node_kinetic = np.zeros_like(c.L, shape=(c.B, mesh.n_nodes))
    node_kinetic[:, : mesh.topology.n_nodes] = 0.5 * c.rho * c.alpha
    node_kinetic[:, mesh.topology.junctions] = 0.5 * c.rho * (c.alpha - c.k)
    layout = _layout(c, mesh, wall, force)
    A_rest = np.broadcast_to(wall.area(c.P_0[..., None]), gauss).copy()
    return Model(
        network=network,
        settings=settings,
        parameters=parameters,
        coefficients=c,
        mesh=mesh,
        layout=layout,
        wall=wall,
        outlet_wall=c.wall_at(ends, np.ones(len(ends))),
        minus_J_inverse=np.broadcast_to(-1.0 / J, gauss).copy(),
        mass=mass,
        friction=mass * c.C_f[..., None],
        kinetic=np.broadcast_to(0.5 * rho * alpha, gauss).copy(),
        end_kinetic=node_kinetic[:, mesh.outer_nodes] * mesh.outward,
        damping=damping(mesh, wall, A_rest, 2.0 * J, every),
        force=force,
        storage=Leaking(wall.leakage, mesh.sink, wall, wall.A0) if wall.leaks else Tight(),
        inlets=_inlets(network, wall, mesh, layout),
        tables=Tables.of(network, mesh),
        A_rest=A_rest,
        flow_floor=_ROUND_OFF * np.min(wall.A0 * wall.c0, axis=(1, 2)),
        pressure_floor=_ROUND_OFF * np.max(np.abs(wall.K), axis=(1, 2)),
        impedance=np.min(wall.rho * wall.c0 / wall.A0, axis=(1, 2)),
        site_wall=c.wall_at(*sites_of(network)),
        on_parts=_on_parts(c)[sites_of(network)[0]],
    )


def sites_of(network: Network) -> tuple[Array, Array]:
    """Segment and x/L of every site : (n_sites,)."""
    index = {segment.name: i for i, segment in enumerate(network.segments)}
    sites = network.sites
    return np.array([index[site.segment] for site in sites], int), np.array([site.position for site in sites])


def _on_parts(c: Coefficients) -> Array:
    """(n_segments,) whether an effect acts on a part of the segment's wall."""
    terms = [t for t in c.terms if t.effect.owner == "segment" and changes(t.effect, "wall")]
    return np.array([any(bool(t.effect.cut_at(t.at(s))) for t in terms) for s in range(c.L.shape[1])], bool)


def _inlets(network: Network, wall: Wall, mesh: Mesh, layout: Layout) -> Inlets:
    """The conditions at the first nodes."""
    at = (..., mesh.inlet_element, 0)
    by_flow = np.array([inlet.causality == "flow" for inlet in network.inlets])
    return Inlets.of(by_flow, wall.A0[at] / (wall.rho[at] * wall.c0[at]), layout.columns("Q")[mesh.inlet_element, 0])


def _layout(c: Coefficients, mesh: Mesh, wall: Wall, force: Force) -> Layout:
    """The state vector; without any memory it contains only A and Q."""
    gauss, lobatto = (mesh.n_elements, mesh.element.N), (mesh.n_elements, mesh.element.N + 1)
    remembers = wall.remembers or force.memories > 0 or any(ends.kind.stores for ends in c.outlets)
    return Layout(
        {
            "A": gauss,
            "Q": lobatto,
            "P_C": (len(mesh.topology.outlet_segment) if remembers else 0,),
            "stress": (len(wall.elements[0]) if wall.remembers else 0, *gauss),
            "history": (force.memories, *lobatto),
        }
    )


def _walls(c: Coefficients, mesh: Mesh, xi: Array) -> Wall:
    """The walls at points ξ of every element : (B, n_e, len(xi))."""
    x = mesh.positions(xi)
    return c.wall_at(np.repeat(mesh.segment, len(xi)), x.ravel()).shaped(x.shape)


def _force(c: Coefficients, mesh: Mesh, mass: Array) -> Force:
    """The sum of the forces on the flow of all active effects."""
    el, found = mesh.element, list[Drag]()
    terms = [term for term in c.terms if changes(term.effect, "drag")]
    if terms:
        R0 = np.sqrt(_walls(c, mesh, el.x_lobatto).A0 / np.pi)
        ends = mesh.positions(np.array([-1.0, 1.0]))
        points = Points(
            x=mesh.positions(el.x_lobatto),
            left=ends[:, :1],
            right=ends[:, 1:],
            R0=R0,
            L=c.L[:, mesh.segment, None],
            nu=c.nu[..., None],
            integral=el.integral,
        )
    for term in terms:
        values: Mapping[str, Array] = term.at(mesh.segment) if term.effect.owner == "segment" else term.values
        drag = term.effect.drag({key: value[..., None] for key, value in values.items()}, points)
        found += [] if drag is None else [drag]
    return DragForce.of(sum(found[1:], found[0]), mass, el.at_lobatto) if found else NoForce()


def _possible(model: Model) -> Model:
    """The model, if its walls can carry the start pressure. Raises ValueError otherwise."""
    c, law = model.coefficients, model.network.elastic_law
    for _, e in np.argwhere(~(model.A_rest[..., 0] > 0.0)):
        name = model.network.segments[model.mesh.segment[e]].name
        raise InputError(
            f"network.P_0: the wall of segment {name} cannot carry the start pressure under the "
            f"{law} law; bring network.P_0 nearer to the pressure at which R = R0, or raise {name}.E or {name}.h."
        )
    for ends in c.outlets:
        for _, o in np.argwhere(ends.kind.unreachable(ends.numbers, model.outlet_wall.at(ends.index), c.P_0)):
            name = model.network.outlets[ends.index[o]].segment
            raise InputError(
                f"{name}.outlet.P_venous: the wall at the outlet cannot carry P_0 - P_venous under the {law} law; "
                f"bring {name}.outlet.P_venous nearer to network.P_0."
            )
    return model
