"""Ports: the relation between pressure and flow at an end of the network over the next communication step.

The pressure of an artery responds to a flow at once, through its impedance. A partner that sends a flow and reads the
pressure one step later closes a loop whose gain does not decrease with the step. A partner that solves its own law with

    P(t + h) = P_0 + Z_0 Q(t) + Z Q(t + h)                at an inlet,
    P_venous(t + h) = P_0 - Z Q_venous(t + h)             at an outlet, Q_venous the flow to P_venous,

is coupled implicitly. A pressure-driven inlet responds with its flow instead,

    Q(t + h) = Q_0 + Y_0 P(t) + Y P(t + h),

and the following holds for both. P_0 is exact at an extrapolated flow, by a discarded trial step. Z is the response to
a small change of the flow, recomputed every 10 ms: an error ΔZ makes an error of ΔZ times the difference between the
flow and the extrapolated one, which is of second order in h. With ``smooth`` it must be accurate to about 20 %.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.network.description import Network
from solver.scheme.model import Model
from solver.scheme.outputs import inlet_answers, venous_flow

from .communication_step import CommunicationStep, Position

Array = np.ndarray

INLET_PORTS = {"flow": ("P_0", "Z", "Z_0"), "pressure": ("Q_0", "Y", "Y_0")}  # by its causality
_SMALL = 1e-3  # of A0 c0 and ρ c0², flow and pressure at the wave speed: small, yet far above round-off
# basis of the impedances: the last position with known inflow, that of the outputs, the next communication step
Basis = tuple[Position, Position, CommunicationStep]

_CLOSED = 1e15  # Pa·s/m³, of an outlet that no pressure opens
# Internal steps of the trials for the impedances, at most, but with ``hold``, whose jumps need all. Those of the
# communication step would cost most where it is long. Three differ by 1.6 % at most (sheep and human, steps of 5 to
# 100 ms; adan56, 5 ms), while an impedance varies by 3 to 18 % within a beat.
_STEPS = 3


@dataclass(frozen=True)
class Impedances:
    """Z and Z_0 : (n_inlets,) of the inlets, Z : (n_outlets,) of the outlets [Pa·s/m³]; Y and Y_0 where the pressure is
    given."""

    Z: Array
    Z_0: Array
    outlets: Array


def port_names(network: Network) -> list[str]:
    """The variables of the ports, in the order of :func:`port_values`."""
    outlets = [f"{outlet.segment}.outlet.{key}" for outlet in network.outlets for key in ("P_0", "Z")]
    inlets = [inlet.variable(key) for inlet in network.inlets for key in INLET_PORTS[inlet.causality]]
    return [*inlets, *outlets]


def is_port(name: str) -> bool:
    """True for the variable of a port; reading it costs a trial step."""
    return name.rsplit(".", 1)[-1] in {key for keys in INLET_PORTS.values() for key in keys}


def impedances(basis: Basis, interpolation: str) -> Impedances:
    """The response of the network to small changes of each inflow and of each P_venous.

    Raises NonPhysicalState if the next communication step fails.
    """
    known, shown, step = basis
    step = step if interpolation == "hold" else step.in_at_most(_STEPS)
    model, Q, n, k = step.model, shown.drive[:, None], len(step.P_venous), len(shown.drive)
    small, copies = _SMALL * _sizes_of_drives(model), 1 + k + n
    changes = _SMALL * (model.outlet_wall.rho * model.outlet_wall.c0**2)[0]
    # side by side: no change, each flow changed, and each P_venous changed
    changed = Q + small[:, None] * np.eye(k, copies, 1)
    P_venous = step.P_venous + np.eye(copies, n, -1 - k) * changes
    before = changed if interpolation == "hold" else np.repeat(Q, copies, axis=1)
    tried = replace(step, P_venous=P_venous).run(shown.copies(copies), before, changed)
    Z, Z_0 = _rise(model, tried) / small, np.zeros(k)
    if interpolation == "smooth":  # the flow at the start of the step is not known yet, nor the end of the one before
        ends, far = changed[:, : 1 + k], np.repeat(known.drive[:, None], 1 + k, axis=1)
        after = step.run(step.run(known.copies(1 + k), far, ends), ends, np.repeat(Q, 1 + k, axis=1))
        Z_0 = _rise(model, after) / small
    flows = venous_flow(model, tried.state, P_venous)
    less = flows[0] - flows[1 + k :].diagonal()
    return Impedances(Z, Z_0, changes / np.maximum(less, changes / _CLOSED))


def _rise(model: Model, tried: Position) -> Array:
    """The response of each inlet to a change of its own drive : (n_inlets,); the first copy has no change."""
    answers = inlet_answers(model, tried.state)
    return np.asarray(answers[1:].diagonal() - answers[0])


def endless(model: Model) -> Impedances:
    """The impedances of infinite elastic tubes, ρ c0/A0 [Pa·s/m³], or for a given pressure the inverse; outlets
    closed."""
    wall, at = model.wall, (0, model.mesh.inlet_element, 0)
    Z = wall.rho[at] * wall.c0[at] / wall.A0[at]
    outlets = np.full(len(model.mesh.topology.outlet_segment), _CLOSED)
    return Impedances(np.where(model.inlets.by_flow, Z, 1.0 / Z), 0.0 * Z, outlets)


def port_values(step: CommunicationStep, at: Position, tried: Position, found: Impedances) -> list[float]:
    """The values of :func:`port_names` over a communication step from a position, whose trial step ended at
    ``tried``."""
    inlets = inlet_answers(step.model, tried.state)[0] - found.Z * tried.drive - found.Z_0 * at.drive
    outlets = step.P_venous + found.outlets * venous_flow(step.model, tried.state, step.P_venous)[0]
    both = np.column_stack([inlets, found.Z, found.Z_0]), np.column_stack([outlets, found.outlets])
    return [value for table in both for value in table.ravel().tolist()]


def _sizes_of_drives(model: Model) -> Array:
    """A0 c0 [m³/s] of the artery at each inlet, or ρ c0² [Pa] where the pressure is given : (n_inlets,)."""
    wall, at = model.wall, (0, model.mesh.inlet_element, 0)
    return np.where(model.inlets.by_flow, (wall.A0 * wall.c0)[at], (wall.rho * wall.c0**2)[at])
