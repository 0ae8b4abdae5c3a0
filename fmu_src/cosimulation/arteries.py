"""The arteries as a component without FMI: parameters by name, any communication step, and ports for coupling."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from solver.errors import InputError, NonPhysicalState
from solver.io.saved import Kind, dataclasses
from solver.lumped.component import Component, check_time
from solver.mesh.mesh import Layout
from solver.network.description import Network
from solver.network.inlet import Inlet
from solver.periodic.start import periodic_state
from solver.scheme.model import Model, Settings, build
from solver.scheme.outputs import reporter, volume_weights
from solver.scheme.step import State, initial_state

from .communication_step import CommunicationStep, Drive, Position, rounded
from .drive import inlet_with, own_drive
from .ports import Impedances, endless, impedances, port_names, port_values

Array = np.ndarray

_ON_GRID = 1e-6  # tolerance, in dt, for a communication step that is a multiple of dt
_LONGEST = 4.0 / 3.0  # maximum internal step, in dt, for other communication steps
_FURTHEST = 2.0  # number of communication steps of extrapolated inflow
_RENEWED = 9.9e-3  # s after which the impedances of the ports are recomputed
_MOST_STEPS = 1_000_000  # internal steps in one communication step


class CoSimulation(Component):
    """The component. Each communication step is divided into equal internal steps: of length dt if it is a multiple of
    dt, else of at most 4/3 dt. They end with it, so a jump of the inflow lies between internal steps.

    The drive of an inlet in a communication step from t to t + h is, by ``inlet.interpolation``,

    hold     the value set before the step;
    linear   a straight line from the previous value to that value, which is Q(t + h);
    smooth   a straight line from Q(t), set before the step, to an extrapolated value. The next step first repeats this
             one with the true value. So the arteries receive straight lines between the Q(t), and only the outputs at
             the newest time are provisional.

    With ``inlet.drive`` = network, the network's own flows and pressures drive it, evaluated as in the solver; inputs
    at the inlets and the interpolation are ignored.

    P_venous is constant during a step. No state is changed in place, so a snapshot of the attributes is one of the
    component.
    """

    remade = frozenset("network settings parameters port_names venous drives means report weights found own".split())

    def __init__(self, network: Network, settings: Settings) -> None:
        self.network, self.settings = network, settings
        self.parameters = tuple(network.parameters())
        self.port_names = port_names(network)
        self.drives = [inlet.drive for inlet in network.inlets]
        self.means = [*(inlet.variable(key) for inlet in network.inlets for key in ("Q_mean", "P_mean")), "inlet.T"]
        self.venous = [f"{outlet.segment}.outlet.P_venous" for outlet in network.outlets]

    def initialize(self, t0: float, values: Mapping[str, Any]) -> None:
        """Build the solver and its first state from variable values by name; raises ValueError if they do not fit."""
        laws = {"elastic_law": values["network.elastic_law"], "viscous_law": values["network.viscous_law"]}
        settings = replace(self.settings, dt=values["solver.dt"], element_length=values["solver.element_length"])
        parameters = {name: values[name] for name in self.parameters}
        self.origin = laws, asdict(settings), parameters
        self._use(self._built(*self.origin))
        self.dt, self.time = settings.dt, t0
        by_network = values["inlet.drive"] == "network"
        self.beats = {name: values[name] for name in values if name in self.means} if by_network else None
        self.own = self._own()
        self.interpolation = "linear" if self.own else values["inlet.interpolation"]  # a flow that is known
        self.unset = self._driving(values).tolist() if self.own else None  # until a host sets what is ignored
        # the last position with known inflow, and that of the outputs: the same except with ``smooth``
        self.known = self.shown = Position(self.model, self._start(t0, values), self._drive_at(t0, values), 0.0)
        self.slope = np.zeros(len(self.drives))  # of the inflows in the last communication step [m³/s²]
        self.last = self._step_of(self.dt, values)
        self.basis, self.basis_time = (self.known, self.shown, self.last), t0
        self.V = self.V_0 = self._volume()
        self.V_venous = self.Q_venous = 0.0

    def _start(self, t0: float, values: Mapping[str, Any]) -> State:
        if values["network.start"] == "rest":
            return initial_state(self.model, t0)
        beats = [_beats(inlet, values) for inlet in self.network.inlets]
        T = next((T for _, T in beats if T), 1.0)  # a steady state has no period
        return periodic_state(self.model, lambda t: np.stack([drive(t) for drive, _ in beats], axis=1), T, t0)

    def _own(self) -> Drive | None:
        """The network's own drives of its inlets, if they are selected."""
        return None if self.beats is None else own_drive(self.network, self.beats)

    def retune(self, changed: Mapping[str, Any]) -> None:
        """Apply values that were changed between steps, by name; raises ValueError and keeps the old ones if invalid.

        Inputs that are also parameters (P_venous) matter, because the Jacobian at rest depends on them.
        """
        fresh = self.known is self.shown
        self._use(self.model.with_parameters({name: v for name, v in changed.items() if name in self.parameters}))
        self.shown = self.shown.under(self.model)
        if fresh:  # else the known position must first reach the outputs, with the old parameters
            self.known = self.shown

    def _built(self, laws: Mapping[str, str], settings: Mapping[str, Any], parameters: Mapping[str, float]) -> Model:
        return build(replace(self.network, **laws), parameters, Settings(**settings))  # type: ignore[arg-type]

    def kinds(self) -> dict[type, Kind]:
        """A model is saved as its parameters, and those at the start: they have made the mesh."""

        def made(origin: tuple[Any, ...], parameters: Mapping[str, float]) -> Model:
            return self._built(*origin).with_parameters(parameters)

        model = Kind(lambda model: {"origin": self.origin, "parameters": model.parameters}, made)
        return {Model: model, **dataclasses(CommunicationStep, Position, State, Layout)}

    def resumed(self) -> None:
        """The reports follow from the model."""
        if "model" in self.__dict__:  # it was saved after its initialization
            self._use(self.model)
            self.own = self._own()

    def _use(self, model: Model) -> None:
        self.model, self.report, self.weights = model, reporter(model), volume_weights(model)[0]
        self.found: Impedances | None = None  # about the basis, where they were asked for

    def step(self, t: float, h: float, values: Mapping[str, Any]) -> None:
        """Advance from t to t + h [s] with the inputs in ``values``.

        Raises ValueError, NonPhysicalState; the component is then as before.
        """
        self._check_time(t, h)
        self.remark = self._unheard(values)
        values = self._received(values)
        step = self._step_of(h, values)
        halved = self.shown.state.halved
        known, shown, slope = self._driven(step, self._driving(values))
        self.known, self.shown, self.slope, self.last, self.time = known, shown, slope, step, t + h
        if shown.state.halved > halved:
            self.remark = (
                f"the step from t = {t:g} s did not converge and was cut into halves; a smaller dt avoids that."
            )
        self.V = self._volume()
        V_venous = self.V_0 + shown.V_in - self.V
        self.V_venous, self.Q_venous = V_venous, (V_venous - self.V_venous) / h
        if self.time - self.basis_time >= _RENEWED or not step.as_long_as(self.basis[2]):
            self.basis, self.basis_time, self.found = (known, shown, step), self.time, None

    def _received(self, values: Mapping[str, Any]) -> Mapping[str, Any]:
        """The inputs. Some masters that run all FMUs in parallel set every input to 0 before the first step; the start
        pressures then remain."""
        first = self.interpolation == "smooth" and self.known is self.shown
        if first and not any(values[name] for name in (*self.drives, *self.venous)):
            pressures = dict(zip(self.venous, self.last.P_venous.tolist(), strict=True))
            given = zip(self.drives, self.known.drive.tolist(), strict=True)
            return {**values, **pressures, **{name: P for name, P in given if name.endswith(".P")}}
        return values

    def _driving(self, values: Mapping[str, Any]) -> Array:
        """The inputs at the inlets : (n_inlets,)."""
        return np.array([values[name] for name in self.drives], float)

    def _drive_at(self, t: float, values: Mapping[str, Any]) -> Array:
        """The drives of the inlets at the start : (n_inlets,)."""
        return self._driving(values) if self.own is None else self.own(np.full((1, 1), t))[0, :, 0]

    def _unheard(self, values: Mapping[str, Any]) -> str:
        """A sentence at the first step after the host has set an ignored input."""
        if self.unset is None or self._driving(values).tolist() == self.unset:
            return ""
        self.unset = None
        return f"{' and '.join(self.drives)} is ignored: inlet.drive = network; take input to drive the network by it."

    def _driven(self, step: CommunicationStep, Q: Array) -> tuple[Position, Position, Array]:
        """The next ``known``, ``shown`` and ``slope`` after a communication step with the inlets at Q."""
        if self.own is not None:
            after = step.run_along(self.known.under(step.model), self.time, self.own)
            return after, after, 0.0 * Q
        if self.interpolation == "smooth":
            known, slope = replace(self.known, drive=Q), 0.0 * Q
            if self.known is not self.shown:
                slope = (Q - self.known.drive) / self.last.h
                known = (
                    self.shown
                    if np.array_equal(Q, self.shown.drive)
                    else self.last.run(self.known, self.known.drive, Q)
                )
                if step.h > _FURTHEST * self.last.h:
                    slope = 0.0 * Q
            known = known.under(step.model)
            try:
                return known, step.run(known, Q, Q + slope * step.h), slope
            except NonPhysicalState:  # of a flow that was only extrapolated: without that
                return known, step.run(known, Q, Q), 0.0 * Q
        Q_start = Q if self.interpolation == "hold" else self.known.drive
        after = step.run(self.known.under(step.model), Q_start, Q)
        return after, after, (Q - Q_start) / step.h

    def outputs(self) -> list[float]:
        """The outputs at the last communication point, in the order of the variable table, without the ports."""
        return [*self.report(self.shown.state)[0].tolist(), self.V, self.V_venous, self.Q_venous]

    def ports(self) -> dict[str, float]:
        """The ports by name, over the next communication step, assumed as long as the last one."""
        if self.found is None:
            self.found = self._impedances()
        step = replace(self.last, model=self.model)
        values = port_values(step, self.shown, self._trial(step), self.found)
        return dict(zip(self.port_names, values, strict=True))

    def _trial(self, step: CommunicationStep) -> Position:
        """The result of the next step under the extrapolated drive; the present position if it fails."""
        Q = self.shown.drive + self.slope * step.h
        try:
            if self.own is not None:
                return step.run_along(self.shown, self.time, self.own)
            return step.run(self.shown, Q if self.interpolation == "hold" else self.shown.drive, Q)
        except NonPhysicalState:
            return self.shown

    def _impedances(self) -> Impedances:
        """The impedances about the basis, or those of infinite tubes if the simulation fails there."""
        try:
            return impedances(self.basis, self.interpolation)
        except NonPhysicalState:
            return endless(self.model)

    def _volume(self) -> float:
        return float(self.weights @ self.shown.state.y[0])

    def _step_of(self, h: float, values: Mapping[str, Any]) -> CommunicationStep:
        ratio = h / self.dt
        steps, dt = round(ratio), self.dt
        if steps == 0 or abs(ratio - steps) > _ON_GRID:
            steps = max(1, steps, math.ceil(ratio / _LONGEST))
            dt = rounded(h / steps)
        P_venous = np.array([values[name] for name in self.venous])
        return CommunicationStep(self.model, h, steps, dt, P_venous)

    def _check_time(self, t: float, h: float) -> None:
        check_time(t, h, self.time, 2 * _ON_GRID * self.dt)
        if h > _MOST_STEPS * self.dt:
            raise InputError(
                f"communication step of {h:g} s: more than {_MOST_STEPS} internal steps of {self.dt:g} s; "
                "take shorter communication steps."
            )


def _beats(inlet: Inlet, values: Mapping[str, Any]) -> tuple[Callable[[Array], Array], float]:
    """The drive of an inlet in the beats of a periodic start, and their period [s], 0 for a steady drive."""
    if inlet.causality == "pressure":
        return (lambda t: values[inlet.variable("P_mean")] + 0.0 * t), 0.0
    pulse = inlet_with(inlet, values)
    return pulse.Q, pulse.T
