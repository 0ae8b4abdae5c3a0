"""Ports: how pressure and flow at an end of the network answer each other over the next communication step.

An artery answers a flow at once, through its impedance. A partner that sends a flow and reads the pressure back one
step later closes a loop whose gain does not fall with the step. One that solves its own law together with

    P(t + h) = P_0 + Z_0 Q(t) + Z Q(t + h)                at the inlet,
    P_venous(t + h) = P_0 - Z Q_venous(t + h)             at an outlet, Q_venous the flow to P_venous,

is coupled implicitly. P_0 is exact at an extrapolated flow, by a trial of the step that is thrown away; Z is the answer
of the network at rest, made once for each length of step. An error ΔZ makes an error of ΔZ times the difference between
the flow and the extrapolated one, which is of second order in h.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.network import Network
from solver.outputs import venous_flow
from solver.scheme.failure import NonPhysicalState

from .stretch import Position, Stretch

Array = np.ndarray

_SMALL = 1e-3  # of A0 c0, the flow at the wave speed: a flow that is small, yet far above round-off
_CLOSED = 1e15  # Pa·s/m³, of an outlet that no pressure opens


@dataclass(frozen=True)
class Impedances:
    """Z and Z_0 of the inlet, Z : (n_outlets,) of the outlets [Pa·s/m³]."""

    Z: float
    Z_0: float
    outlets: Array


def port_names(network: Network) -> list[str]:
    """The variables of the ports, in the order of :func:`port_values`."""
    outlets = [f"{outlet.segment}.outlet.{key}" for outlet in network.outlets for key in ("P_0", "Z")]
    return ["inlet.P_0", "inlet.Z", "inlet.Z_0", *outlets]


def is_port(name: str) -> bool:
    """Whether an output is a variable of a port, which costs a trial step when it is read."""
    return name.rsplit(".", 1)[-1] in ("P_0", "Z", "Z_0")


def impedances(stretch: Stretch, rest: Position, interpolation: str) -> Impedances:
    """The answers of a network at rest to small changes of its inflow and of each P_venous."""
    model, hold = stretch.model, interpolation == "hold"
    wall = model.outlet_wall
    small = _SMALL * float(np.min(wall.A0 * wall.c0))
    alone = stretch.run(rest, 0.0, 0.0)
    driven = stretch.run(rest, small if hold else 0.0, small)
    Z, Z_0 = (_inlet_pressure(driven) - _inlet_pressure(alone)) / small, 0.0
    if interpolation == "smooth":  # the flow at the start of the step is not known yet: its triangle over two steps
        after = _inlet_pressure(stretch.run(driven, small, 0.0))
        Z_0 = (after - _inlet_pressure(stretch.run(alone, 0.0, 0.0))) / small
    change = small * float(np.max(wall.rho * wall.c0 / wall.A0))
    flows = venous_flow(model, alone.state, stretch.P_venous)[0]
    outlets = np.empty(len(flows))
    for i in range(len(flows)):
        raised = replace(stretch, P_venous=stretch.P_venous + change * (np.arange(len(flows)) == i))
        less = flows[i] - venous_flow(model, raised.run(rest, 0.0, 0.0).state, raised.P_venous)[0, i]
        outlets[i] = change / max(less, change / _CLOSED)
    return Impedances(Z, Z_0, outlets)


def port_values(stretch: Stretch, at: Position, slope: float, interpolation: str, found: Impedances) -> list[float]:
    """The values of :func:`port_names` over a communication step from a position.

    slope : of the inflow before it [m³/s²]. Where the trial breaks down, the pressures of the position are taken.
    """
    Q = at.Q + slope * stretch.h
    Q_start = Q if interpolation == "hold" else at.Q
    try:
        tried = stretch.run(at, Q_start, Q)
    except NonPhysicalState:
        tried = at
    inlet = _inlet_pressure(tried) - found.Z * tried.Q - found.Z_0 * at.Q
    outlets = stretch.P_venous + found.outlets * venous_flow(stretch.model, tried.state, stretch.P_venous)[0]
    return [inlet, found.Z, found.Z_0, *np.column_stack([outlets, found.outlets]).ravel().tolist()]


def _inlet_pressure(at: Position) -> float:
    return float(at.state.H[0, 0])
