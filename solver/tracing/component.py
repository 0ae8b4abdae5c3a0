"""The program of a co-simulation component: from parameters and step length to coefficients, steps, and all FMU
outputs.

The program of :mod:`~solver.tracing.steps` belongs to one model and one step length. This one serves every parameter
set on one mesh, because its first phase computes the coefficients, too. It *requires* that the mesh stays the same and
that linear walls do not become nonlinear; otherwise it stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..laws.effects import ALL
from ..mesh.mesh import Mesh, build_mesh
from ..network.coefficients import changes, coefficients
from ..network.description import Network
from ..scheme.guards import VISCOSITY_REASON, margins
from ..scheme.model import Model, Settings, lay_out
from ..scheme.outputs import inlet_answers, venous_flow, volume_weights
from ..scheme.sdirk import GAMMA
from ..scheme.step import State
from .array import Traced, array, later
from .program import Program, Shared, compiled
from .recorder import Known, Untraceable
from .steps import CORE, PHASES, Recording

# phases after those of a model's program, in the order of native/fmu/component.h
MORE = ("explain", "show")
_PHASE = {name: number for number, name in enumerate((*PHASES, *MORE))}
MARGINS = 4  # most margins of the guards
# keys of all walls that are 0 in a wall without the effect
_OF_WALLS = {key for e in ALL if e.always and e.owner == "segment" for key, value in e.neutral.items() if not value}
_BENDS = 1e-3  # any value except 0
# further inputs and outputs beside PLACES, in the order there
FURTHER = (
    "parameters", "dt", "element_length", "y_rest", "A_rest", "lost_at_rest", "small_drives", "small_venous",
    "end_impedance", "viscosity", "A0", "r", "lost", *(f"margin_{i}" for i in range(MARGINS)),
    "venous_show", "V", "answers", "venous_flow", "g_show",
)  # fmt: skip


@dataclass(frozen=True)
class Whole:
    """A program, and the concrete model of the parameters with which it was recorded; its mesh is valid for all."""

    program: Program
    model: Model
    reasons: tuple[tuple[str, str], ...]


def whole(network: Network, settings: Settings, bent: bool = False, shared: Shared | None = None) -> Whole:
    """The program of a network's component. bent : record with nonlinear walls, so that any wall may become nonlinear.
    shared : constants and indices of earlier programs.
    Raises Untraceable with the operation that cannot be recorded.
    """
    made = parts(network, settings, bent)
    recording = _Component(made.recorder, made.m, GAMMA * made.step)
    program = recording.whole(made.places, shared)
    return Whole(program, made.model, tuple(recording.reasons))


class Parts(NamedTuple):
    """A concrete model, a model m of traced coefficients, and its step; places : inputs of the first phase."""

    recorder: Known
    model: Model
    m: Any
    step: Traced
    places: Mapping[str, Sequence[Traced]]


def parts(network: Network, settings: Settings, bent: bool) -> Parts:
    """The common beginning of all programs of a component: from parameters to coefficients."""
    values = network.parameters()
    c = coefficients(network, values, every=True)
    mesh = build_mesh(network, c.L[0], settings.element_length, settings.degree, coefficients(network, values).cuts)
    model = lay_out(network, values, settings, c, mesh)
    recorder = Known()
    given = array(recorder, 0, (len(values),))
    recorder.give(given, [*values.values()])
    traced: dict[str, Any] = {name: given[i] for i, name in enumerate(values)}
    if bent:  # a term that is zero everywhere would be left out
        recorder.lenient = True
        recorder.numbers[given.buffer.slot] = np.array([_bent(name, value) for name, value in values.items()])
    made = coefficients(network, traced, checked=False, every=True)
    m = lay_out(network, traced, settings, made, mesh, every=True)
    m = replace(m, mesh=replace(mesh, core=CORE), parameters={}, memo={})
    step, length = array(recorder, 0, ()), array(recorder, 0, ())
    recorder.give(step, settings.dt)
    recorder.give(length, settings.element_length)
    recorder.lenient = False
    _same_mesh(recorder, mesh, made, length)
    places = {"parameters": [given], "dt": [step], "element_length": [length]}
    return Parts(recorder, model, m, step, places)


def _bent(name: str, value: float) -> float:
    """A wall parameter that is not zero, as in a nonlinear wall."""
    return value or _BENDS if name.rpartition(".")[2] in _OF_WALLS else value


def _same_mesh(recorder: Known, mesh: Mesh, c: Any, length: Traced) -> None:
    """Require the same number of elements with the same ends."""
    for term in c.terms:
        if term.effect.owner == "segment" and (term.effect.cuts or changes(term.effect, "cut_at")):
            for s in range(len(mesh.count)):
                if term.effect.cut_at(term.at(s)):
                    bool(term.on[s])  # evaluated as a bool, and so required
    width = 1.0 / mesh.parts * np.bincount(mesh.piece)[mesh.piece]
    pieces = np.bincount(mesh.piece)[mesh.piece]
    wanted = width * c.L[0][mesh.segment] / length - 1e-9
    fits = (wanted <= pieces) & ((wanted > pieces - 1.0) | (pieces == 1))
    recorder.require(fits, np.ones(len(pieces)))


class _Component(Recording):
    """Steps, and the further requests of an FMU."""

    phases: ClassVar[Mapping[str, int]] = _PHASE

    def __init__(self, recorder: Known, m: Any, tau: Any) -> None:
        super().__init__(recorder, m, tau)
        self.reasons: list[tuple[str, str]] = []

    def whole(self, places: Mapping[str, Sequence[Traced]], shared: Shared | None) -> Program:
        self.rest()
        state, venous = self.steps()
        self.explain(venous)
        self.show(state)
        inputs = {**self.given, **places}
        return compiled(self.recorder, len(self.phases), self.m.mesh.n_elements, inputs, self.out, shared=shared)

    def rest(self) -> None:
        """The state at rest, outlets that cannot reach it, and scales of drive and P_venous."""
        m, wall, at = self.m, self.m.wall, (0, self.m.mesh.inlet_element, 0)
        c = m.coefficients
        H = np.broadcast_to(c.P_0, (1, self.n_H))
        self.out |= {"y_rest": m.at_rest(), "A_rest": m.A_rest[..., 0], "viscosity": self._full(wall.phi0)}
        self.out |= {"A0": self._full(wall.A0), "r": self._full(wall.r)}
        self.out["lost_at_rest"] = self._lost(c.P_venous, H)
        self.out["small_drives"] = np.where(m.inlets.by_flow, (wall.A0 * wall.c0)[at], (wall.rho * wall.c0**2)[at])
        self.out["small_venous"] = (m.outlet_wall.rho * m.outlet_wall.c0**2)[0]
        Z = wall.rho[at] * wall.c0[at] / wall.A0[at]
        self.out["end_impedance"] = np.where(m.inlets.by_flow, Z, 1.0 / Z)

    def explain(self, venous: Any) -> None:
        """Each margin that must be positive in an iterate, and outlets without a reachable pressure."""
        m, out = self.m, self.out
        A, A_t = (later(self.recorder, x, _PHASE["explain"]) for x in (m.layout.part(out["end"], "A"), out["A_t"]))
        Q = self.take("Q", "explain", *self.shapes["Q"])
        for i, (margin, reason, remedy) in enumerate(margins(m, A, A_t, Q)):
            out[f"margin_{i}"] = self._full(margin)
            self.reasons.append((_text(reason), remedy))
        H = self.take("H", "explain", self.n_H)
        out["lost"] = self._lost(later(self.recorder, venous, _PHASE["explain"]), H)

    def show(self, state: State) -> None:
        """Beside the outputs: volume, answers of the inlets, flows to P_venous."""
        y, H = self.take("y_report", "show", self.m.layout.size), self.take("H_report", "show", self.n_H)
        venous = self.take("venous_show", "show", len(self.m.mesh.topology.outlet_segment))
        moment = replace(state, y=y, H=H)
        self.out["V"] = (volume_weights(self.m) * y).sum()
        self.out["answers"] = inlet_answers(self.m, moment)
        self.out["venous_flow"] = venous_flow(self.acting("g_show", "show"), moment, venous)

    def _full(self, x: Any) -> Any:
        return 1.0 * np.broadcast_to(x, self.m.wall.A0.shape)

    def _lost(self, venous: Any, H: Any) -> Any:
        """1 for each outlet at which the wall cannot reach this pressure : (n_outlets,)."""
        m = self.m
        found = np.zeros_like(m.coefficients.P_0, shape=(1, len(m.mesh.topology.outlet_segment)))
        for ends in m.coefficients.outlets:
            numbers = {**ends.numbers, "P_venous": venous[..., ends.index]}
            P = H[:, m.mesh.topology.outlets][:, ends.index]
            lost = ends.kind.unreachable(numbers, m.outlet_wall.at(ends.index), P)
            found[:, ends.index] = 1.0 * lost
        return found


def _text(reason: Callable[[], str]) -> str:
    """A reason; with {} for a number that depends on the state."""
    try:
        return reason()
    except Untraceable:
        return VISCOSITY_REASON
