"""The steps of a model as a program: one pass of the scheme's own code over arrays without values.

The recording covers :func:`~solver.scheme.stage.operators_about` at rest, :class:`~solver.scheme.stage.Stage` with its
Jacobian, the tolerances, the guards and the outputs, with the laws, outlets and effects of the network at hand. Models
that differ only in numbers share a program.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ..mesh.mesh import Layout, Mesh
from ..network.description import Network
from ..scheme.guards import margins
from ..scheme.model import Model, rebuilt
from ..scheme.outputs import reporter
from ..scheme.sdirk import INFLOW_TIMES
from ..scheme.stage import Operators, Stage, condense, largest, operators_about
from ..scheme.step import State, tolerances
from .array import Traced, array, later
from .program import Program, compiled
from .recorder import Recorder

Array = np.ndarray

# the phases of a program, in the order of native/engine.h
PHASES = ("bind", "prepare", "start", "correct", "finite", "refresh", "correct_fresh", "end", "check", "report")
# its inputs and outputs, in the order there
PLACES = (
    "y", "H0", "drive", "venous", "begun", "given", "small_Q", "small_H", "start", "given_now", "Q", "H",
    "Q_new", "dH", "change_Q", "change_H", "Q_new_fresh", "dH_fresh", "change_Q_fresh", "change_H_fresh",
    "finite", "end", "A_t", "margin", "y_report", "A_t_report", "H_report", "report", "g_begin", "g", "g_report",
)  # fmt: skip
_PHASE = {name: number for number, name in enumerate(PHASES)}
CORE = 32  # nodes that are inverted as a whole: in compiled code a round costs less than in NumPy
_KEPT = 64  # programs in the cache, 1 MB each: a search of names tries some 40 kinds of one network
_MESH = ("segment", "parts", "left", "piece", "ends")


@dataclass
class Recorded:
    """A program, and the address of each number array of its models, -1 if it is not used. checked : a step of it was
    compared with NumPy's."""

    program: Program
    places: tuple[int, ...]
    checked: bool = False


# --- a model as numbers and structure -------------------------------------------------------------------------------


@dataclass
class Leaves:
    """The number arrays in frozen objects, in the order of their fields.

    arrays : (B, n) each. kind : other contents of the objects; classes : their classes. Models with equal kind and
    classes share a program. recorder : if given, :meth:`of` replaces the arrays by traced ones of one member.
    """

    recorder: Recorder | None = None
    arrays: list[Array] = field(default_factory=list)
    traced: list[Traced] = field(default_factory=list)
    kind: list[Hashable] = field(default_factory=list)
    classes: list[Hashable] = field(default_factory=list)

    def of(self, x: Any) -> Any:
        """The same object, with traced arrays if there is a recorder."""
        found = rebuilt(x, self._array, self._other)
        return found if self.recorder else x

    def _other(self, x: Any) -> None:
        if isinstance(x, (Network, Mesh, Layout)):
            self.kind.append(_facts(x))
        elif isinstance(x, slice):
            self.kind.append((x.start, x.stop, x.step))
        else:
            self.classes.append(x)

    def _array(self, x: Array, axis: int | None) -> Any:
        if axis is None or x.dtype != float or x.ndim <= axis or not x.shape[axis]:
            self.kind.append((x.shape, x.tobytes()))
            return x
        self.kind.append((x.shape[:axis], x.shape[axis + 1 :]))
        rows = np.moveaxis(x, axis, 0) if axis else x
        self.arrays.append(rows.reshape(len(rows), math.prod(rows.shape[1:])))
        if not self.recorder:
            return x
        self.traced.append(array(self.recorder, _PHASE["bind"], (*x.shape[:axis], 1, *x.shape[axis + 1 :])))
        return self.traced[-1]


def _facts(x: Network | Mesh | Layout) -> Hashable:
    """The contents that a program depends on."""
    if isinstance(x, Network):
        names = tuple(segment.name for segment in x.segments)
        return names, tuple((site.segment, site.position) for site in x.sites), tuple(x.output_units())
    if isinstance(x, Layout):
        return tuple(x.shapes.items())
    return x.element.N, x.core, x.n_nodes, *(getattr(x, name).tobytes() for name in _MESH)


def numbers(model: Model) -> Model:
    """All objects that a step and its outputs depend on: not the terms of effects, which act through the other numbers,
    so that effects which change the same numbers share a program."""
    tables = model.tables.given(np.zeros(len(model.tables.tables)))  # g(t) is an input, moment by moment
    c = replace(model.coefficients, terms=(), batched=False)
    return replace(model, parameters={}, memo={}, coefficients=c, mesh=replace(model.mesh, core=CORE), tables=tables)


# --- recording -----------------------------------------------------------------------------------------------------


def recorded(model: Model, tau: float) -> tuple[Recorded, list[Array]]:
    """The program of the steps of a model with stages of length tau [s], and the numbers to bind.

    Raises Untraceable with the operation that cannot be recorded.
    """
    return _programs.of(numbers(model), tau, lambda r, m, leaves: Recording(r, m, tau).all(leaves))


class Programs:
    """A cache of programs by kind of model."""

    def __init__(self) -> None:
        self.kept: dict[Hashable, Recorded] = {}

    def of(
        self, model: Model, tau: float, record: Callable[[Recorder, Any, Leaves], Recorded]
    ) -> tuple[Recorded, list[Array]]:
        """The program for a model of :func:`numbers`, and its numbers. If none of the same kind is cached, ``record``
        makes it from a traced model. tau : the length of stages."""
        looked = Leaves()
        looked.of(model)
        key = (tau, tuple(looked.kind), tuple(looked.classes))
        found = self.kept.pop(key, None)
        if found is None:
            recorder = Recorder()
            leaves = Leaves(recorder)
            found = record(recorder, leaves.of(model), leaves)
        while len(self.kept) >= _KEPT:
            self.kept.pop(next(iter(self.kept)), None)
        self.kept[key] = found
        return found, looked.arrays


_programs = Programs()


class Recording:
    """Inputs and outputs, by name, of the program of a model m; for one member."""

    phases: ClassVar[Mapping[str, int]] = _PHASE

    def __init__(self, recorder: Recorder, m: Any, tau: float) -> None:
        self.recorder, self.m, self.n_H, self.shapes = recorder, m, m.mesh.n_nodes, m.layout.shapes
        self.n_sources = len(m.tables.nodes)
        self.given, self.out = defaultdict[str, list[Any]](list), dict[str, Any]()
        self.tau = tau
        self.o = self.operators()

    def operators(self) -> Operators:
        """The operators of the steps."""
        H = np.broadcast_to(self.m.coefficients.P_0, (1, self.n_H))
        return operators_about(self.m, self.tau, self.m.at_rest(), H)

    def all(self, leaves: Leaves) -> Recorded:
        """The program."""
        self.steps()
        return self.recorded(leaves)

    def steps(self) -> tuple[State, Any]:
        """All phases of steps; returns the state at their start, and P_venous."""
        state, venous = self.prepare()
        stage = self.start(venous)
        self.correct(stage, "correct", "", self.o.at_rest)
        self.refresh(stage)
        self.end(stage)
        self.report(state)
        return state, venous

    def recorded(self, leaves: Leaves, held: int | None = None) -> Recorded:
        """The program of all inputs and outputs; held : the phase whose numbers have a memory of their own."""
        places = {f"leaf {i}": [leaf] for i, leaf in enumerate(leaves.traced)}
        units = self.m.mesh.n_elements
        program = compiled(self.recorder, len(self.phases), units, {**self.given, **places}, self.out, held)
        return Recorded(program, tuple(program.address.get(name, -1) for name in places))

    def acting(self, name: str, phase: str) -> Any:
        """The model with table amplitudes that are given before a phase."""
        n = self.n_sources
        return replace(self.m, tables=self.m.tables.given(self.take(name, phase, n)[0])) if n else self.m

    def take(self, name: str, phase: str, *shape: int) -> Any:
        """An input array given before a phase; it shares its place with one of the same name in an earlier phase."""
        self.given[name].append(array(self.recorder, self.phases[phase], (1, *shape)))
        return self.given[name][-1]

    def prepare(self) -> tuple[State, Any]:
        """The start of a step: tolerances, drives of the inlets at its stages, the state with the new inflow."""
        m, out = self.m, self.out
        y, H = self.take("y", "prepare", m.layout.size), self.take("H0", "prepare", self.n_H)
        drive = self.take("drive", "prepare", len(m.inlets.by_flow), len(INFLOW_TIMES))[0, ..., None]
        venous = m.coefficients.venous(self.take("venous", "prepare", len(m.mesh.topology.outlet_segment)))
        state = State(0.0, y, y, H, y, y, m.layout, m.layout)
        out["given"] = m.inlets.at_stages(drive)
        out["small_Q"], out["small_H"] = tolerances(m, state, m.inlets.gain * drive[:, -1].T)
        out["begun"] = y.copy()
        m.inlets.begin(out["begun"], self.acting("g_begin", "prepare").tables.let_in(drive[:, 0], 0.0))
        return state, venous

    def start(self, venous: Any) -> Stage:
        """A stage from the state vector at its start."""
        y = self.take("start", "start", self.m.layout.size)
        given = self.take("given_now", "start", len(self.m.inlets.by_flow))
        (g,) = self.acting("g", "start").tables.at(np.zeros(1))
        return Stage.of(self.m, self.o, y, given, venous, 0.0, g)

    def correct(self, stage: Stage, phase: str, fresh: str, jacobian: Any) -> None:
        """A chord iteration, and the size of its change."""
        Q, H = self.take("Q", phase, *self.shapes["Q"]), self.take("H", phase, self.n_H)
        Q_new, dH = stage.correct(jacobian, Q, H)
        self.out |= {f"Q_new{fresh}": Q_new, f"dH{fresh}": dH, f"change_H{fresh}": largest(dH)}
        self.out[f"change_Q{fresh}"] = largest((Q_new - Q).reshape(1, -1))

    def refresh(self, stage: Stage) -> None:
        """A test whether the last iterate is usable, the Jacobian there, and iterations with it."""
        s, Q = stage.start, self.take("Q", "finite", *self.shapes["Q"])
        self.out["finite"] = (s.area(s.area_rate(Q)) > 0.0).all(axis=(0, 1, 2))
        Q, H = self.take("Q", "refresh", *self.shapes["Q"]), self.take("H", "refresh", self.n_H)
        there = condense(self.m, self.o.loads, stage.jacobian(Q), H, stage.behind)
        self.correct(stage, "correct_fresh", "_fresh", there)

    def end(self, stage: Stage) -> None:
        """The state at the end of the stage, and the smallest margin that must be positive."""
        m, Q = self.m, self.take("Q", "end", *self.shapes["Q"])
        A_t: Any = stage.start.area_rate(Q)
        end: Any = stage.end(Q, A_t)
        checked = (later(self.recorder, x, self.phases["check"]) for x in (m.layout.part(end, "A"), A_t, Q))
        least = [np.min(margin) for margin, _, _ in margins(m, *checked)]
        self.out |= {"A_t": A_t, "end": end, "margin": np.min(np.stack(least))}

    def report(self, state: State) -> None:
        """The outputs of a state."""
        y, H = self.take("y_report", "report", self.m.layout.size), self.take("H_report", "report", self.n_H)
        moment = replace(state, y=y, A_t=self.take("A_t_report", "report", *self.shapes["A"]), H=H)
        self.out["report"] = reporter(self.acting("g_report", "report")).report(moment)
