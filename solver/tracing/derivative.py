"""The program of a step's directional derivative: of its outputs with respect to its drive and its parameters.

A stage solves F(x, p) = 0 for x = (Q, H), so that F_x dx = -F_p dp: one solution with the Jacobian at the end of the
step, exact up to round-off. The values are those of a completed step; each operation is followed by its derivative
(:mod:`~solver.tracing.tangent`).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ..network.description import Network
from ..scheme import terms
from ..scheme.model import Settings
from ..scheme.outputs import volume_weights
from ..scheme.sdirk import GAMMA
from ..scheme.stage import Stage, condense
from ..scheme.step import State
from .array import array, elementwise
from .component import Parts, parts
from .program import Program, Shared, compiled
from .recorder import Slot
from .steps import PHASES, Recording
from .tangent import derivative_of, tangents

# phases of a step, then one for the linear equations; in the order of native/fmu/derivative.c, as the places are
DERIVED = (*PHASES, "solve")
# inputs with a direction, and the phase in which each is given
_GIVEN = {
    "parameters": "bind", "y": "prepare", "drive": "prepare", "venous": "prepare", "start": "start",
    "given_now": "start", "Q": "end", "y_report": "report", "A_t_report": "report", "H_report": "report",
}  # fmt: skip
_LEFT = ("begun", "given", "R", "net", "end", "A_t", "report", "V")
DERIVED_PLACES = (
    "parameters", "dt", "element_length", "y", "H0", "drive", "venous", "g_begin", "start", "given_now", "g", "Q", "H",
    "R_left", "net_left", "y_report", "A_t_report", "H_report", "g_report", "begun", "given", "end", "A_t",
    "Q_change", "H_change", *(f"{name}_by" for name in (*_GIVEN, *_LEFT)),
)  # fmt: skip


def derivative(network: Network, settings: Settings, bent: bool = False, shared: Shared | None = None) -> Program:
    """As :func:`~solver.tracing.component.whole`; the places are :data:`DERIVED_PLACES`."""
    made = parts(network, settings, bent)
    return _Derivative(made.recorder, made.m, GAMMA * made.step).program(made, shared)


class _Derivative(Recording):
    phases: ClassVar[dict[str, int]] = {name: number for number, name in enumerate(DERIVED)}

    def program(self, made: Parts, shared: Shared | None) -> Program:
        state, venous = self.prepare()
        stage = self.start(venous)
        self.solve(stage)
        Q = self.take("Q", "end", *self.shapes["Q"])
        A_t: Any = stage.start.area_rate(Q)
        self.out |= {"A_t": A_t, "end": stage.end(Q, A_t)}
        self.shown(state)
        inputs = {**self.given, **{name: [*each] for name, each in made.places.items()}}
        out = {name: elementwise(self.recorder, "copy", self.out[name]) for name in (*_LEFT, "Q_change", "H_change")}
        seeds = dict[Slot, Slot]()
        for name, phase in _GIVEN.items():
            for x in [x for x in inputs[name] if x.buffer.slot.phase == self.phases[phase]]:
                towards = array(self.recorder, self.phases[phase], x.shape)
                seeds[x.buffer.slot] = towards.buffer.slot
                inputs.setdefault(f"{name}_by", []).append(towards)
        self.recorder.merge()
        slopes = tangents(self.recorder, seeds)
        out |= {f"{name}_by": derivative_of(out[name], slopes) for name in _LEFT}
        return compiled(self.recorder, len(self.phases), self.m.mesh.n_elements, inputs, out, shared=shared)

    def solve(self, stage: Stage) -> None:
        """The residuals of the equations, and the change of Q and H that cancels a given residual."""
        Q, H = self.take("Q", "correct", *self.shapes["Q"]), self.take("H", "correct", self.n_H)
        R = terms.residual(stage.start, Q, H)
        self.m.tables.add_to_momentum(R, stage.g)
        self.out |= {"R": R, "net": stage.node_residual(Q, H)}
        there = condense(self.m, self.o.loads, stage.jacobian(Q), H, stage.behind)
        R_left, net_left = self.take("R_left", "solve", *self.shapes["Q"]), self.take("net_left", "solve", self.n_H)
        change = -np.einsum("beij,bej->bei", there.K_inverse, R_left)
        H_change = there.nodal.solve(net_left + self.m.mesh.net_inflow(change, self.o.loads.signs))
        there.add_to(change, H_change)
        self.out |= {"Q_change": change, "H_change": H_change}

    def shown(self, state: State) -> None:
        """Outputs, and the volume."""
        self.report(state)
        self.out["V"] = (volume_weights(self.m) * self.given["y_report"][0]).sum()
