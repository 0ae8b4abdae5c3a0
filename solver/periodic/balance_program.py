"""The harmonic balance of a model as a program: one pass of :mod:`~solver.periodic.harmonic_balance` over arrays
without numbers.

Its first phases are those of a step, here of implicit steps of given length to the steady state. The others are the
Jacobians of small waves, one block of numbers for every frequency; the residuals at one moment of a period; and the
response to them at one frequency. Complex numbers are stored with real parts first, then imaginary ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..laws.wall import Wall
from ..scheme import terms
from ..scheme.drag_and_leak import DragForce, Force
from ..scheme.guards import margins
from ..scheme.model import Model
from ..scheme.outputs import reporter
from ..scheme.sdirk import GAMMA
from ..scheme.stage import Loads, Memory, Operators, Stage, loads_of, memory_of, operators_about
from ..scheme.step import State
from ..tracing.complex import Complex
from ..tracing.steps import PHASES as STEP
from ..tracing.steps import Leaves, Programs, Recorded, Recording, numbers
from .harmonic_balance import Response, evened, remembered, settled_below, unremembered

Array = np.ndarray

# the phases and places after those of a step, in the order of native/balance.h
PHASES = (*STEP, "about", "linearise", "moment", "fill", "remember", "observe", "respond", "respond_mean", "filled",
          "recall", "stored", "scaled")  # fmt: skip
PLACES = (
    "tau_step", "guess", "about_y", "about_H", "tau_wave", "now", "left", "unfilled", "unremembered", "observed",
    "driven", "answer", "answer_mean", "flow_in", "change", "forgotten", "memories", "past", "let_out", "charged",
    "enters", "scaled",
)  # fmt: skip
CORE = 8  # nodes that are inverted as a whole: with complex numbers a round costs less

_programs = Programs()


class Sizes(NamedTuple):
    """Sizes of a moment: all that its phases are given; its residuals of flow, storage and memory; its memories, and
    what a stage needs of them; its outputs with the margin of the guards; stored pressures. 0: the model has none."""

    now: int
    left: int
    unfilled: int
    unremembered: int
    memories: int
    past: int
    observed: int
    outlets: int

    @staticmethod
    def of(model: Model) -> Sizes:
        shapes, n_H = model.layout.shapes, model.mesh.n_nodes
        A, Q, P_C, stress, history = (int(np.prod(shapes[name])) for name in ("A", "Q", "P_C", "stress", "history"))
        past = (A if stress else 0) + (Q if history else 0)
        return Sizes(
            now=2 * (A + Q + P_C) + A + past + stress + history + n_H + len(model.inlets.by_flow),
            left=Q + n_H,
            unfilled=0 if model.storage.proportional else A,
            unremembered=min(stress, 2 * A) + Q if past else 0,
            memories=stress + history,
            past=past,
            observed=len(model.network.output_units()) + 1,
            outlets=shapes["P_C"][0],
        )


def recorded(model: Model) -> tuple[Recorded, list[Array]]:
    """The program of the balance of a model, and the numbers to bind. Raises Untraceable."""
    own, tau = numbers(model), GAMMA * model.settings.dt
    own = replace(own, mesh=replace(own.mesh, core=CORE))
    return _programs.of(own, tau, lambda r, m, leaves: _Recording(r, m, tau).balance(leaves))


def past_of(model: Model, stress: Any, history: Any, tau: float) -> list[Any]:
    """What a stage of length tau needs of the memories at its start, linear in these: the faded stress of walls with
    memory (B, n_e, N) [Pa], and the constant of a force with history, like mass."""
    moment, force = model.wall.remembering(stress.swapaxes(0, 1), tau).moment, model.force.since(history, tau)
    found = [] if moment is None else [moment.faded]
    return [*found, force.constant] if isinstance(force, DragForce) and force.memories else found


class _Past(Memory):
    """The memories by the number that a stage needs of them : (B, …) of :func:`past_of`."""

    def __init__(self, past: Any) -> None:
        self.past = past

    def recall(self, model: Model, y: Array, tau: float, loads: Loads, P_venous: Array) -> tuple[Wall, Force, Array]:
        wall, force, behind = super().recall(model, y, tau, loads, P_venous)
        (_, n_e, N), n = model.layout.shapes["stress"], 0
        if wall.moment is not None:
            n = n_e * N
            wall = replace(wall, moment=replace(wall.moment, faded=self.past[:, :n].reshape(1, n_e, N)))
        if isinstance(force, DragForce) and force.memories:
            force = replace(force, constant=self.past[:, n:].reshape(1, n_e, N + 1))
        return wall, force, behind


class _Moment(NamedTuple):
    """A moment: A, Q, P_C and the past (:func:`past_of`) at the start of a stage that ends there; drive, H, state
    vector y and ∂A/∂t at its end. The engine gives a phase only those that it needs."""

    start: Any
    past: Any
    drive: Any
    H: Any
    y: Any
    A_t: Any

    def stage(self, of: Recording) -> Stage:
        m, o, y, n = of.m, of.o, self.start, of.m.layout.size - self.start.shape[1]
        if n:
            o, y = replace(o, memory=_Past(self.past)), np.concatenate([y, np.zeros((1, n))], axis=1)
        return Stage.of(m, o, y, m.inlets.gain * self.drive, m.coefficients.P_venous, 0.0)


class _Recording(Recording):
    """Inputs and outputs of the program of a model m."""

    phases: ClassVar[Mapping[str, int]] = {name: number for number, name in enumerate(PHASES)}

    def operators(self) -> Operators:
        """The operators at the moments, without a Jacobian."""
        m, tau = self.m, self.tau
        return Operators(tau, m.mass / tau, memory_of(m), loads_of(m, tau), None)  # type: ignore[arg-type]

    def balance(self, leaves: Leaves) -> Recorded:
        """The program."""
        at_moments = self.o
        self.steady()
        self.o = at_moments
        self.moments()
        self.frequencies()
        return self.recorded(leaves, self.phases["linearise"])

    def steady(self) -> None:
        """An implicit step of a given length, linearised about its initial state."""
        m = self.m
        tau, H = self.take("tau_step", "start")[0], self.take("H0", "start", self.n_H)
        y, given = self.take("start", "start", m.layout.size), self.take("given_now", "start", len(m.inlets.by_flow))
        self.o = operators_about(m, tau, y, H)
        stage = Stage.of(m, self.o, y, given, m.coefficients.P_venous, 0.0)
        self.out["guess"] = evened(m.layout.part(y, "Q")).copy()
        self.out["small_Q"], self.out["small_H"] = settled_below(m, given)
        self.correct(stage, "correct", "", self.o.at_rest)
        self.refresh(stage)
        self.end(stage)

    def moments(self) -> None:
        """Residuals and outputs at a moment."""
        m, size, part = self.m, Sizes.of(self.m), self.m.layout.part
        now = self._moment("moment")
        Q, stage = part(now.y, "Q"), now.stage(self)
        R, net = terms.residual(stage.start, Q, now.H), stage.node_residual(Q, now.H)
        self.out["left"] = np.concatenate([R.reshape(1, -1), net], axis=1)
        if size.unfilled:
            now = self._moment("fill")
            start = now.stage(self).start
            supply = start.supply(part(now.y, "Q"))
            self.out["unfilled"] = start.storage.left_over(supply, part(now.y, "A"), now.A_t)
        if size.unremembered:
            now = self._moment("remember")
            found = unremembered(m, now.y, now.A_t)
            self.out["unremembered"] = np.concatenate([x.reshape(1, -1) for x in found], axis=1)
        y, H, A_t = (now := self._moment("observe")).y, now.H, now.A_t
        state = State(0.0, y, A_t, H, y, y, m.layout, m.layout)
        least = [np.min(margin) for margin, _, _ in margins(m, m.layout.part(y, "A"), A_t, m.layout.part(y, "Q"))]
        found = (reporter(m).report(state), np.min(np.stack(least)).reshape(1, 1))
        self.out["observed"] = np.concatenate(found, axis=1)

    def _moment(self, phase: str) -> _Moment:
        size, shapes = Sizes.of(self.m), self.shapes
        A, Q, P_C = (int(np.prod(shapes[name])) for name in ("A", "Q", "P_C"))
        parts = (A + Q + P_C, size.past, len(self.m.inlets.by_flow), self.n_H, Q, A, P_C, A, size.memories)
        x, ends = self.take("now", phase, size.now), np.cumsum(parts)
        start, past, drive, H, *fluid, A_t, memories = (x[:, e - n : e] for n, e in zip(parts, ends, strict=True))
        now_Q, now_A, now_P_C = fluid
        y = np.concatenate([part for part in (now_A, now_Q, now_P_C, memories) if part.shape[1]], axis=1)
        return _Moment(start, past, drive, H, y, A_t.reshape(1, *shapes["A"]))

    def frequencies(self) -> None:
        """The Jacobian of waves of one frequency, and the responses by it."""
        m, size, part = self.m, Sizes.of(self.m), self.m.layout.part
        y, H = self.take("about_y", "about", m.layout.size), self.take("about_H", "about", self.n_H)
        tau = self.given_complex("tau_wave", "linearise")[0]
        response = Response.of(m, tau, y, H)
        for phase, means in (("respond", 0), ("respond_mean", 1)):
            driven, (_, *shape) = self.given_complex("driven", phase, size.left), part(y, "Q").shape
            R = driven[:, : -self.n_H].reshape(1, *shape)
            changes = response.answer(R, driven[:, -self.n_H :], means)
            self.leave("answer_mean" if means else "answer", np.concatenate(changes, axis=1))
        if size.unfilled:
            flow_in = self.given_complex("flow_in", "filled", size.unfilled).reshape(1, *self.shapes["A"])
            self.leave("change", tau * response.storage * flow_in)
        if size.unremembered:
            forgotten, n = self.given_complex("forgotten", "recall", size.unremembered), int(np.prod(self.shapes["Q"]))
            at_once = forgotten[:, :-n].reshape(1, -1, *self.shapes["A"])
            stress, history = remembered(m, tau, at_once, forgotten[:, -n:].reshape(1, *self.shapes["Q"]))
            self.leave("memories", np.concatenate([stress.reshape(1, -1), history.reshape(1, -1)], axis=1))
            self.leave(
                "past", np.concatenate([x.reshape(1, -1) for x in past_of(m, stress, history, self.tau)], axis=1)
            )
        if size.outlets:
            let_out = self.given_complex("let_out", "stored", size.outlets)
            self.leave("charged", response.charge * let_out)
        self.leave("scaled", response.scale * self.given_complex("enters", "scaled", self.n_H))

    def given_complex(self, name: str, phase: str, *shape: int) -> Any:
        x = self.take(name, phase, 2, *shape)
        return Complex(x[:, 0], x[:, 1])

    def leave(self, name: str, x: Any) -> None:
        """Add complex numbers to the outputs of the program."""
        self.out[name] = np.concatenate([x.re.reshape(-1), x.im.reshape(-1)])
