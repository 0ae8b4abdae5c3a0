"""The equations of one network on cells: from a network to a frozen :class:`MusclModel`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..laws.wall import Wall
from ..network.coefficients import Coefficients, EffectValues, Parameters, changes, coefficients
from ..network.description import Network
from ..network.table_source import refuse
from .grid import Grid, build_grid
from .settings import MusclSettings

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class MusclModel:
    """A network, or a batch of B parameter sets of it, on cells. Made by :func:`build`.

    parameters : replacements of the network's own numbers. dx : (B, n_cells) [m]. wall : (B, n_cells) at the
    centres; faces : (B, 2, n_cells) at the left and right face of each cell; ends : (B, 2, n_segments) at the starts
    and ends of segments. viscosity : (B, n_cells - 1) ν_s A [Pa·s] between cells of one segment, else 0; end_viscosity
    : (B, 2, n_segments). tapered : whether walls change along a segment. kinetic : (B, 2, n_segments) ρ k of the
    pressure that a junction keeps. A_rest : (B, n_cells).
    """

    network: Network
    settings: MusclSettings
    parameters: Parameters
    coefficients: Coefficients
    mesh: Grid
    dx: Array
    wall: Wall
    faces: Wall
    ends: Wall
    outlet_wall: Wall
    viscosity: Array
    end_viscosity: Array
    tapered: bool
    kinetic: Array
    A_rest: Array


def build(network: Network, parameters: Parameters | None = None, settings: MusclSettings | None = None) -> MusclModel:
    """The model of a network with some parameters replaced by numbers or by arrays of B numbers.

    Raises ValueError for parameters that are not allowed, or for an effect that this scheme does not support.
    """
    settings = settings or MusclSettings()
    c = coefficients(network, parameters)
    _refuse_unsupported(network, c)
    grid, n = build_grid(network, c.L.max(axis=0), settings.cell), len(network.segments)
    faces = _walls(c, np.stack([grid.segment] * 2), np.stack([grid.left, grid.right]))
    ends = _walls(c, np.stack([np.arange(n)] * 2), np.repeat([[0.0], [1.0]], n, axis=1))
    wall, outlets = c.wall_at(grid.segment, grid.middle), grid.topology.outlet_segment
    k = np.zeros((c.B, grid.topology.n_nodes))
    k[:, grid.topology.junctions] = c.k
    model = MusclModel(
        network=network,
        settings=settings,
        parameters=dict(parameters or {}),
        coefficients=c,
        mesh=grid,
        dx=c.L[:, grid.segment] / grid.count[grid.segment],
        wall=wall,
        faces=faces,
        ends=ends,
        outlet_wall=c.wall_at(outlets, np.ones(len(outlets))),
        viscosity=np.where(np.diff(grid.segment) == 0, faces.viscosity_area[:, 1, :-1], 0.0),
        end_viscosity=ends.viscosity_area * (settings.ends == "coupled"),
        tapered=bool(np.any(c.wall_at(grid.segment, grid.left).differs(c.wall_at(grid.segment, grid.right)))),
        kinetic=ends.rho * k[:, grid.nodes],
        A_rest=np.broadcast_to(wall.area(c.P_0), (c.B, grid.n_cells)).copy(),
    )
    _refuse_unreachable_pressure(model)
    return model


def _walls(c: Coefficients, segment: Array, x: Array) -> Wall:
    return c.wall_at(segment.ravel(), x.ravel()).shaped(x.shape)


def _refuse_unsupported(network: Network, c: Coefficients) -> None:
    """Raise ValueError for sources, effects on the viscous stress, leaks, and forces on the fluid."""
    refuse(network.sources, "scheme 'muscl'")
    wall, every = c.base, np.arange(len(network.segments))
    for term in c.terms:
        before, lacking = wall, changes(term.effect, "drag")
        if term.effect.owner == "segment":
            wall = term.effect.wall(wall, term.at(every), np.full(len(every), 0.5))
            lacking |= any(
                getattr(wall, name) != getattr(before, name) for name in ("nonlinear", "leaks", "remembers", "learns")
            )
        if lacking:
            raise InputError(_unsupported(network, term))


def _unsupported(network: Network, term: EffectValues) -> str:
    neutral = ", ".join(f"{key} = {value:g}" for key, value in term.effect.neutral.items() if key in term.values)
    return (
        f"network {network.name}: scheme 'muscl' does not support the effect {term.effect.name}; "
        f"switch it off ({neutral}) or use the default scheme."
    )


def _refuse_unreachable_pressure(model: MusclModel) -> None:
    for _, cell in np.argwhere(~(model.A_rest > 0.0)):
        name = model.network.segments[model.mesh.segment[cell]].name
        raise InputError(
            f"network.P_0: the wall of segment {name} cannot carry the start pressure under the "
            f"{model.network.elastic_law} law; bring network.P_0 nearer to the pressure at which R = R0, or raise "
            f"the stiffness of {name}."
        )
