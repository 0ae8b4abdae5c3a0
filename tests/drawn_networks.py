"""A hypothesis strategy for networks that can be run, and their runs by the engine, by its FMU and by NumPy.

Effects, outlets and laws are those of the catalogues, so a new one is drawn without a change here.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from hypothesis import strategies as st

from build_fmu import build_native
from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.variables.arteries_variables import INTERPOLATIONS, variable_table
from solver import Inlet, InputError, Junction, Network, NonPhysicalState, Segment, Settings, Site
from solver.laws import effects
from solver.laws.effect import Array, Effect
from solver.laws.outlets import OUTLETS, Outlet
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.network.inflow import drives_of
from solver.quantities.coordinate import SCALE
from solver.quantities.quantity import Quantity, quantities
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.sdirk import INFLOW_TIMES
from solver.scheme.step import adopt, initial_state, step
from solver.tracing.native import Backend

TIGHT = Settings(dt=2e-3, tolerance=1e-12)  # steps solved to round-off: nothing is left over that may differ
STEPS = 15  # between two changes of parameters

Values = dict[str, Any]  # parameters by name


@dataclass(frozen=True)
class Drawn:
    """A network, a batch of its parameters (empty: one set), and what is retuned after each STEPS steps."""

    network: Network
    batch: Values
    retuned: tuple[Values, ...]
    pressures: Mapping[str, tuple[float, float]]  # mean and amplitude [Pa] at the inlets with given pressure
    effects: tuple[str, ...] = ()

    def drive(self, name: str, t: Array | float) -> Array:
        """The pressure [Pa] at an inlet at times t [s]."""
        mean, size = self.pressures[name]
        return mean + size * np.sin(40.0 * np.asarray(t))


# the effects that the engine must know, without those that a test adds: those of channels act on the record alone
IN_EQUATIONS = [effect for effect in effects.ALL if effect.owner != "channel"]


# --- numbers ---------------------------------------------------------------------------------------------------------


def within(q: Quantity, value: float) -> float:
    """The nearest allowed value."""
    low = q.low + 1e-3 * q.nominal if q.open_low else q.low
    return float(min(max(value, low), q.high))


def switched_on(draw: Any, effect: Effect, network: Network, place: str) -> dict[str, float]:
    """Values of its numbers, up to two typical sizes away from those of the network, or from neutral ones; where it has
    none, about the nominal ones."""
    present, owners, found = network.parameters(), dict(network.owners()), dict[str, float]()
    moves = {c.moves[0][0]: c for c in effect.coordinates(network, place)}
    for key, variables in effect.variables(network, place).items():
        first, x = variables[0], draw(st.floats(0.3, 2.0)) * draw(st.sampled_from([1.0, -1.0]))
        if first in moves and moves[first].kind == SCALE:
            value = moves[first].nominal * np.exp(moves[first].moves[0][1] * x)
        elif key in effect.neutral:
            size = effect.step(network, owners[first.rpartition(".")[0]], key)
            value = present.get(first, effect.neutral[key]) + size * x
        else:
            value = effect.terms[key].nominal * np.exp(x)
        found[key] = within(effect.terms[key], value)
    return found


def varied(draw: Any, q: Quantity, value: float) -> float:
    """Another value of a parameter: near it, none of it where that is allowed, or a little where it is 0."""
    factor = draw(st.floats(0.8, 1.25) | st.sampled_from([1.0, 0.0] if q.low <= 0.0 and not q.open_low else [1.0]))
    return within(q, value * factor if value else 0.1 * q.nominal * factor)


def outlet(draw: Any, segment: str) -> Outlet:
    """Of any kind; its numbers within a factor of three of the usual ones, or in the inner part of a short range."""
    kind, numbers = draw(st.sampled_from(OUTLETS)), dict[str, float]()
    for key, q in quantities(kind).items():
        if q.input:
            numbers[key] = draw(st.sampled_from([0.0, 500.0]))
        elif q.high - q.low <= 10.0 * q.nominal:
            numbers[key] = draw(st.floats(0.75 * q.low + 0.25 * q.high, 0.1 * q.low + 0.9 * q.high))
        else:
            numbers[key] = q.nominal * draw(st.floats(0.3, 3.0))
    return kind(segment, **numbers)


# --- networks --------------------------------------------------------------------------------------------------------


def _vessel(draw: Any, name: str) -> Segment:
    real = lambda low, high: draw(st.floats(low, high))  # noqa: E731
    phi0 = draw(st.sampled_from([1e4, 0.0]))
    return Segment(name, real(0.02, 0.15), real(3e-3, 1e-2), real(5e-4, 1e-3), real(5e5, 2e6), phi0)


def _joined(draw: Any, roots: int) -> tuple[list[Segment], list[Junction], list[str]]:
    """Trees from the first segments, whose ends are joined until all hang together, and perhaps further, to loops; or
    closed by two vessels in parallel. Returns segments, junctions and open ends."""
    count = draw(st.integers(roots, roots + 3))
    parents = {i: draw(st.integers(0, i - 1)) for i in range(roots, count)}
    segments = [_vessel(draw, f"S{i}") for i in range(count)]
    ways = {i: tuple(f"S{j}" for j, p in parents.items() if p == i) for i in range(count)}
    junctions = [Junction((f"S{i}",), way, k=draw(st.floats(0.0, 1.0))) for i, way in ways.items() if way]
    tree = {i: i for i in range(roots)}
    for i, p in parents.items():
        tree[i] = tree[p]
    ends = {f"S{i}": tree[i] for i, way in ways.items() if not way}

    def join(*names: str) -> None:
        end = f"J{len(segments)}"
        segments.append(_vessel(draw, end))
        junctions.append(Junction(names, (end,)))
        ends[end] = min(ends.pop(name) for name in names)

    for root in range(1, roots):  # an end of every other tree with one of the first
        join(*(next(name for name, of in ends.items() if of == which) for which in (0, root)))
        ends.update({name: 0 for name, of in ends.items() if of == root})
    loop = draw(st.sampled_from(["none", "ends", "parallel", "both"]))
    if loop in ("ends", "both") and len(ends) > 1:
        join(*draw(st.permutations(sorted(ends)))[:2])
    if loop in ("parallel", "both"):
        start = draw(st.sampled_from(sorted(ends)))
        names = [f"P{i}" for i in range(draw(st.integers(2, 3)))]
        segments.extend(_vessel(draw, name) for name in names)
        junctions.append(Junction((start,), tuple(names)))
        ends.update(dict.fromkeys(names, ends.pop(start)))
        join(*names)
    return segments, junctions, sorted(ends)


@st.composite
def networks(draw: Any, first: Effect | None = None) -> Drawn:
    """Up to three inlets, trees and loops, any outlets and laws, up to three effects beside ``first``, a batch of up to
    three parameter sets, and parameters that change in mid-run."""
    roots, large = draw(st.integers(1, 3)), draw(st.sampled_from([1.0] * 5 + [20.0]))  # large: it breaks down
    segments, junctions, ends = _joined(draw, roots)
    inlets = [
        Inlet(f"S{i}", large * draw(st.floats(2e-5, 5e-5)), 0.2, draw(st.sampled_from(["flow", "flow", "pressure"])))
        for i in range(roots)
    ]
    P_0 = draw(st.sampled_from([0.0, 1e4]))
    network = Network(
        "drawn", tuple(segments), inlets[0], tuple(junctions), tuple(outlet(draw, end) for end in ends),
        tuple(Site(s.name, s.name, draw(st.floats(0.0, 1.0))) for s in segments), further_inlets=tuple(inlets[1:]),
        elastic_law=draw(st.sampled_from(sorted(ELASTIC_LAWS))),
        viscous_law=draw(st.sampled_from(sorted(VISCOUS_LAWS))), P_ref=P_0, P_0=P_0,
    )  # fmt: skip
    drawn = draw(st.lists(st.sampled_from(IN_EQUATIONS), max_size=3, unique_by=lambda effect: effect.name))
    acting = list[str]()
    for effect in dict.fromkeys([*([first] if first else []), *drawn]):
        places = effect.where(network)  # none for the memory of elastic walls
        if places:
            place = draw(st.sampled_from(places))
            network = effect.add(network, place, switched_on(draw, effect, network, place))
            acting.append(effect.name)
    present = network.parameters()
    known = {  # without a ratio to 0, which is not allowed
        name: q
        for name, q in network.parameter_quantities().items()
        if not (q.ratio_to and present[f"{name.rpartition('.')[0]}.{q.ratio_to}"] == 0.0)
    }
    members = draw(st.integers(1, 3))

    def several(names: Sequence[str]) -> Values:
        """Other values of up to three of these parameters, for each member of the batch."""
        chosen = draw(st.lists(st.sampled_from(sorted(names)), max_size=3, unique=True))
        each = {name: np.array([varied(draw, known[name], present[name]) for _ in range(members)]) for name in chosen}
        return each if members > 1 else {name: float(x[0]) for name, x in each.items()}

    batch = several(list(known)) if members > 1 else {}
    members = members if batch else 1
    tunable = [name for name, q in known.items() if q.tunable]
    retuned = [several(tunable) for _ in range(draw(st.integers(0, 2)))]
    pressures = {
        inlet.drive: (P_0, large * draw(st.floats(1e3, 3e3)))
        for inlet in network.inlets
        if inlet.causality == "pressure"
    }
    return Drawn(network, batch, tuple(retuned), pressures, tuple(acting))


# --- runs ------------------------------------------------------------------------------------------------------------


def outputs(drawn: Drawn, backend: str) -> tuple[Array, int]:
    """The outputs (n, B, n_outputs) of a run that is retuned, and how many halvings of steps it took.

    Raises NonPhysicalState, InputError as the solver.
    """
    model = build(drawn.network, drawn.batch, TIGHT)
    given = {name: (lambda t, name=name: drawn.drive(name, t)) for name in drawn.pressures}
    drives = drives_of(drawn.network, given, model.coefficients.B)
    state, found = initial_state(model), list[Array]()
    for changed in ({}, *drawn.retuned):
        if changed:
            model = model.with_parameters(changed)
            state = adopt(model, state)
        made, report = Backend(backend, model, TIGHT.dt), reporter(model)
        drive = drives((round(state.t / TIGHT.dt) + np.arange(STEPS)[:, None] + INFLOW_TIMES) * TIGHT.dt)
        table, done = np.empty((STEPS, model.coefficients.B, len(report.names))), 0
        while done < STEPS:
            many, state = made.steps(state, drive[done:], table[done:])
            if not many:  # NumPy repeats what the engine does not solve, as in the solver
                state, many = step(model, state, TIGHT.dt, drive[done]), 1
                table[done] = report(state)
            done += many
        found.append(table)
    return np.concatenate(found), state.halved


def component_outputs(drawn: Drawn, way: str) -> Array:
    """The outputs (n, 1, n_outputs) of the component behind an FMU, by NumPy: see :func:`host`."""
    network = drawn.network
    component, values = CoSimulation(network, TIGHT), {v.name: v.start for v in variable_table(network, TIGHT)}
    component.initialize(0.0, {**values, "inlet.interpolation": way})
    inputs = {*component.drives, *component.venous}

    def step(t: float, given: Mapping[str, float]) -> list[float]:
        changed = {name: value for name, value in given.items() if name not in inputs and value != values[name]}
        values.update(given)
        if changed:
            component.retune({**{name: values[name] for name in inputs}, **changed})
        component.step(t, TIGHT.dt, values)
        return component.outputs()[: len(network.output_units())]

    return host(drawn, step)


def fmu_outputs(drawn: Drawn, way: str) -> Array:
    """The same of the FMU that needs no Python. Raises InputError with the sentence of its log."""
    log = list[str]()
    with tempfile.TemporaryDirectory() as folder:
        fmu = build_native(drawn.network, folder, TIGHT)
        description = fmpy.read_model_description(str(fmu))
        slave: Any = fmpy.instantiate_fmu(
            fmpy.extract(str(fmu), f"{folder}/fmu"), description, fmi_type="CoSimulation", debug_logging=True,
            logger=lambda _environment, _name, _status, _category, message: log.append(message.decode()),
        )  # fmt: skip
        references = {v.name: v.valueReference for v in description.modelVariables}
        read = [references[name] for name in drawn.network.output_units()]

        def step(t: float, changed: Mapping[str, float]) -> list[float]:
            slave.setReal([references[name] for name in changed], list(changed.values()))
            slave.doStep(t, TIGHT.dt)
            return list(slave.getReal(read))

        try:
            slave.setupExperiment(startTime=0.0)
            slave.setInteger([references["inlet.interpolation"]], [1 + INTERPOLATIONS.index(way)])
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            return host(drawn, step)
        except FMICallException:
            raise InputError(log[-1].removeprefix(f"{slave.instanceName}: ")) from None
        finally:
            slave.freeInstance()


def host(drawn: Drawn, step: Callable[[float, Mapping[str, float]], Sequence[float]]) -> Array:
    """The outputs (n, 1, n_outputs) of communication steps from t [s], with the inlets driven and, after each STEPS
    steps, parameters and inputs changed. step(t, changed) returns the outputs after a step."""
    found, network = list[Sequence[float]](), drawn.network
    for changed in ({}, *drawn.retuned):
        given = {name: float(np.ravel(value)[0]) for name, value in changed.items()}
        for _ in range(STEPS):
            t = len(found) * TIGHT.dt
            flows = {i.drive: float(i.Q(t + TIGHT.dt)) for i in network.inlets if i.causality == "flow"}
            pressures = {name: float(drawn.drive(name, t + TIGHT.dt)) for name in drawn.pressures}
            found.append(step(t, {**flows, **pressures, **given}))
            given = {}
    return np.array(found)[:, None]


def by_pulse(names: Sequence[str], found: Array, expected: Array) -> float:
    """The largest difference of outputs (n, B, n_names), by the pulse of each channel of each member, or by 1e-2 of the
    largest of its kind where it has none."""
    size = np.abs(expected).max(axis=0)
    for kind in "PQR":
        same = [i for i, name in enumerate(names) if name.endswith(f".{kind}")]
        size[:, same] = size[:, same].max(axis=1, keepdims=True)
    pulse = np.maximum(np.ptp(expected, axis=0), 1e-2 * size)
    return float((np.abs(found - expected) / np.where(pulse > 0.0, pulse, 1.0)).max())


ROUND_OFF = (0.0, 1e-15, -1e-15, 3e-15, -3e-15, 1e-14, -1e-14)  # of a modulus


def nearly(drawn: Drawn) -> Iterator[Drawn]:
    """The network, and networks that are equal to it but for round-off in a modulus.

    Near a breakdown, round-off decides whether an iteration to 1e-12 converges, and so how often a step is halved: of
    NumPy's own runs of one network once, twice or three times, 1e-3 of the pulse apart.
    """
    first, *others = drawn.network.segments
    for change in ROUND_OFF:
        segments = (replace(first, E=first.E * (1.0 + change)), *others)
        yield replace(drawn, network=replace(drawn.network, segments=segments))


def outcome(run: Callable[..., Any], *given: Any) -> Any:
    """The result of a run, or the sentence with which it fails."""
    try:
        return run(*given)
    except (NonPhysicalState, InputError) as error:
        return str(error)
