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

from ..scheme import terms
from ..scheme.guards import margins
from ..scheme.model import Model
from ..scheme.outputs import reporter
from ..scheme.sdirk import GAMMA
from ..scheme.stage import Operators, Stage, loads_of, memory_of, operators_about
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
    "driven", "answer", "answer_mean", "flow_in", "change", "forgotten", "memories", "let_out", "charged",
    "enters", "scaled",
)  # fmt: skip
CORE = 8  # nodes that are inverted as a whole: with complex numbers a round costs less

_programs = Programs()


class Sizes(NamedTuple):
    """Sizes of a moment: its state, rates and drive; its residuals of flow, storage and memory; its memories; its
    outputs with the margin of the guards; stored pressures. 0: the model has none."""

    now: int
    left: int
    unfilled: int
    unremembered: int
    memories: int
    observed: int
    outlets: int

    @staticmethod
    def of(model: Model) -> Sizes:
        shapes, n_H = model.layout.shapes, model.mesh.n_nodes
        A, Q, stress, history = (int(np.prod(shapes[name])) for name in ("A", "Q", "stress", "history"))
        remembers = stress + history > 0
        return Sizes(
            now=2 * model.layout.size + n_H + len(model.inlets.by_flow),
            left=Q + n_H,
            unfilled=0 if model.storage.proportional else A,
            unremembered=stress + Q if remembers else 0,
            memories=stress + history,
            observed=len(model.network.output_units()) + 1,
            outlets=shapes["P_C"][0],
        )


def recorded(model: Model) -> tuple[Recorded, list[Array]]:
    """The program of the balance of a model, and the numbers to bind. Raises Untraceable."""
    (own, walls), tau = numbers(model), GAMMA * model.settings.dt
    own = replace(own, mesh=replace(own.mesh, core=CORE))
    return _programs.of((own, walls), tau, lambda r, x, leaves: _Recording(r, x[0], tau).balance(leaves, x[1]))


class _Recording(Recording):
    """Inputs and outputs of the program of a model m."""

    phases: ClassVar[Mapping[str, int]] = {name: number for number, name in enumerate(PHASES)}

    def operators(self) -> Operators:
        """The operators at the moments, without a Jacobian."""
        m, tau = self.m, self.tau
        return Operators(tau, m.mass / tau, memory_of(m), loads_of(m, tau), None)  # type: ignore[arg-type]

    def balance(self, leaves: Leaves, walls: Any) -> Recorded:
        """The program; walls : at the sites."""
        at_moments = self.o
        self.steady()
        self.o = at_moments
        self.moments(walls)
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

    def moments(self, walls: Any) -> None:
        """Residuals and outputs at a moment."""
        m, size = self.m, Sizes.of(self.m)

        def now(phase: str) -> tuple[Any, ...]:
            n, x = m.layout.size, self.take("now", phase, size.now)
            return x[:, :n], x[:, n : n + self.n_H], x[:, n + self.n_H : 2 * n + self.n_H], x[:, 2 * n + self.n_H :]

        def stage_of(y: Any, rate: Any, drive: Any) -> Stage:
            return Stage.of(m, self.o, y - self.tau * rate, m.inlets.gain * drive, m.coefficients.P_venous, 0.0)

        y, H, rate, drive = now("moment")
        stage, Q = stage_of(y, rate, drive), m.layout.part(y, "Q")
        R, net = terms.residual(stage.start, Q, H), stage.node_residual(Q, H)
        self.out["left"] = np.concatenate([R.reshape(1, -1), net], axis=1)
        if size.unfilled:
            y, H, rate, drive = now("fill")
            start = stage_of(y, rate, drive).start
            supply = start.supply(m.layout.part(y, "Q"))
            self.out["unfilled"] = start.storage.left_over(supply, m.layout.part(y, "A"), m.layout.part(rate, "A"))
        if size.unremembered:
            y, H, rate, drive = now("remember")
            found = unremembered(m, y, rate)
            self.out["unremembered"] = np.concatenate([x.reshape(1, -1) for x in found], axis=1)
        y, H, rate, drive = now("observe")
        A_t = m.layout.part(rate, "A")
        state = State(0.0, y, A_t, H, y, y, m.layout, m.layout)
        least = [np.min(margin) for margin, _, _ in margins(m, m.layout.part(y, "A"), A_t, m.layout.part(y, "Q"))]
        found = (reporter(m, walls).report(state), np.min(np.stack(least)).reshape(1, 1))
        self.out["observed"] = np.concatenate(found, axis=1)

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
            forgotten, n = self.given_complex("forgotten", "recall", size.unremembered), self.shapes["stress"]
            at_once = forgotten[:, : int(np.prod(n))].reshape(1, *n)
            U = forgotten[:, int(np.prod(n)) :].reshape(1, *self.shapes["Q"])
            found = remembered(m, tau, at_once, U)
            self.leave("memories", np.concatenate([x.reshape(1, -1) for x in found], axis=1))
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
