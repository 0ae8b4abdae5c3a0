"""The resource of an FMU that needs no Python: its programs and constants in one file, ``resources/arterial.bin``,
whose form is in :mod:`~fmu_src.native.arrays`. Not part of the code of other FMUs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from solver.errors import InputError, NonPhysicalState
from solver.laws.wall_laws import ELASTIC_LAWS, VISCOUS_LAWS
from solver.lumped.component import Arithmetic
from solver.network.curve import Curve
from solver.network.description import Network
from solver.network.inlet import Inlet
from solver.network.validation import CHECKED_TOGETHER
from solver.scheme.guards import BARE_REMEDY, UNSOLVED
from solver.scheme.model import Model, Settings
from solver.scheme.step import State, adopt, at_stages_of
from solver.tracing import arithmetic
from solver.tracing.arithmetic import Recorded, Requirement
from solver.tracing.component import FURTHER, Whole, whole
from solver.tracing.derivative import DERIVED_PLACES, derivative
from solver.tracing.program import Program, Shared
from solver.tracing.recorder import Untraceable
from solver.tracing.steps import PLACES

from ..cosimulation.arteries import CoSimulation
from ..variables.variable import Variable
from .arrays import Texts, file_of, integers, number_of, tables

Array = np.ndarray

_MARGINS = [name for name in FURTHER if name.startswith("margin_")]  # of which there may be fewer
_SMALL = 40_000  # bytes of code of a program whose derivatives the file holds whatever its law
_MOST = 3_000_000  # bytes of programs: of larger networks only those of its own laws
_NUMBERS = 4  # at most, of a sentence
_FORMATS = re.compile(r"%%|%(?:\.1?\d)?g")  # that native/fmu/arithmetic.c knows


def resource(network: Network, settings: Settings, table: Sequence[Variable]) -> bytes:
    """The file, its GUID still open (:func:`~fmu_src.native.arrays.with_guid`).

    Raises ValueError where the network cannot be recorded.
    """
    shared = Shared()
    programs, derivatives = recorded(network, settings, shared)
    texts = Texts()
    vr = {variable.name: i for i, variable in enumerate(table)}
    model = programs[0][1].model
    first_output = next(i for i, v in enumerate(table) if v.causality == "output")
    arrays = tables(
        table, texts, n_points=model.mesh.element.N, n_programs=len(programs), name=texts.at(network.name),
        unsolved=texts.at(*UNSOLVED), shorter=texts.at(BARE_REMEDY),
    )  # fmt: skip
    segments = {segment.name: i for i, segment in enumerate(network.segments)}
    inlets, inlet_numbers, curves = _inlets(network, vr)
    sources = list[int]()
    for source in network.sources:
        kind, count, curve = _numbers_of(source.curve)
        sources += [kind, sum(map(len, curves)), count]
        curves.append(curve)
    arrays |= {
        "parameters": integers([vr[name] for name in network.parameters()]),
        "inlets": integers(inlets),
        "inlet_numbers": np.array(inlet_numbers, float),
        "curves": np.concatenate([np.zeros(0), *curves]),
        "venous": integers(
            [n for o in network.outlets for n in (vr[f"{o.segment}.outlet.P_venous"], segments[o.segment])]
        ),
        "segments": integers(
            [
                n
                for s in network.segments
                for n in (texts.at(s.name), *(vr[f"{s.name}.{key}"] for key in CHECKED_TOGETHER))
            ]
        ),
        "elements": integers(model.mesh.segment),
        "positions": model.mesh.positions(model.mesh.element.x_gauss).ravel(),
        "periodic": _periodic(network, settings, table[:first_output], model),
        "sources": integers(sources),
        "source_periods": np.array([source.curve.period for source in network.sources], float),
        "index": shared.index.all(),
        "numbers": shared.constants.all(),
    }
    each = list[Array]()
    for (laws, program), derived in zip(programs, derivatives, strict=True):
        each += [*_program(laws, program, texts), *_derived(derived)]
    return file_of(arrays, texts, each)


def recorded(
    network: Network, settings: Settings, shared: Shared
) -> tuple[list[tuple[tuple[int, int], Whole]], list[Program | None]]:
    """The programs with the numbers of their laws, 0 for any: those of the network as it is first. And those of
    derivatives, for the programs that hold nonlinear walls, in large networks of its own elastic law alone. shared :
    what all have in common.

    Raises ValueError where the network cannot be recorded.
    """
    found, derivatives = list[tuple[tuple[int, int], Whole]](), list[Program | None]()
    elastic, viscous = tuple(ELASTIC_LAWS), tuple(VISCOUS_LAWS)
    for law in sorted(elastic, key=lambda name: name != network.elastic_law):
        for bent in (False, True):
            for other in sorted(viscous, key=lambda name: name != network.viscous_law):
                same = (law, other) == (network.elastic_law, network.viscous_law)
                if shared.nbytes + sum(one.program.code.nbytes for _, one in found) > _MOST and not same:
                    continue
                set_so = replace(network, elastic_law=law, viscous_law=other)
                one = _whole(set_so, settings, bent, shared)
                derived = bent and (law == network.elastic_law or one.program.code.nbytes <= _SMALL)
                derivatives.append(derivative(set_so, settings, bent, shared) if derived else None)
                any_law = not one.model.wall.nonlinear and not bent
                found.append(((elastic.index(law) + 1, 0 if any_law else viscous.index(other) + 1), one))
                if any_law:
                    break
    return found, derivatives


def _whole(network: Network, settings: Settings, bent: bool, shared: Shared) -> Whole:
    try:
        return whole(network, settings, bent, shared)
    except Untraceable as reason:
        raise InputError(
            f"network {network.name}: an FMU that needs no Python cannot hold it ({reason}); build it without --native."
        ) from None


# --- tables ---------------------------------------------------------------------------------------------------------


def _inlets(network: Network, vr: Mapping[str, int]) -> tuple[list[int], list[float], list[Array]]:
    rows, numbers, curves = list[int](), list[float](), list[Array]()
    for inlet in network.inlets:
        kind, count, curve = _curve(inlet)
        flow = inlet.causality == "flow"
        mean = vr.get(inlet.variable("Q_mean" if flow else "P_mean"), -1)
        rows += [vr[inlet.drive], mean, int(flow), kind, sum(map(len, curves)), count]
        numbers += [inlet.mean or 0.0, inlet.T, inlet.Q_max]
        curves.append(curve)
    return rows, numbers, curves


def _curve(inlet: Inlet) -> tuple[int, int, Array]:
    """What an inlet gives by itself: none, a half-sine, a cubic through a table or a Fourier series."""
    signal = "Q" if inlet.causality == "flow" else "P"
    curve: Curve | None = inlet.curve if inlet.curve is not None and inlet.curve.signal == signal else None
    if curve is None:
        return (1, 0, np.zeros(0)) if signal == "Q" else (0, 0, np.zeros(0))
    return _numbers_of(curve)


def _numbers_of(curve: Curve) -> tuple[int, int, Array]:
    """A curve: its kind, 2 a cubic or 3 a Fourier series, how many numbers it counts, and these."""
    if curve.interpolation == "fourier":
        numbers = np.concatenate([curve.coefficients.real, curve.coefficients.imag])
        return 3, len(numbers), numbers
    return 2, len(curve.t), np.concatenate(curve.numbers)


def _periodic(network: Network, settings: Settings, given: Sequence[Variable], model: Model) -> Array:
    """The values of inputs and parameters, and the periodic start that they have; nothing where there is none."""
    component = CoSimulation(network, settings)
    starts = {variable.name: variable.start for variable in given}
    try:
        component.initialize(0.0, {**starts, "network.start": "periodic"})
    except (InputError, NonPhysicalState):
        return np.zeros(0)
    numbers = [number_of(v, v.start) for v in given]
    return np.concatenate([numbers, _state(model, adopt(model, component.shown.state))])


def _state(model: Model, state: State) -> Array:
    """The step before, and a state as the engine has it."""
    pair = at_stages_of(state, state.dt)
    return np.concatenate([[state.dt], state.y[0], state.A_t.ravel(), state.H[0], *(x.ravel() for x in pair)])


def _program(laws: tuple[int, int], whole: Whole, texts: Texts) -> Iterator[Array]:
    p, model = whole.program, whole.model
    shapes, layout = model.layout.shapes, model.layout
    counts = (
        p.n_fixed, p.n_work, layout.size, int(np.prod(shapes["A"])), int(np.prod(shapes["Q"])),
        layout.places["Q"].start,
        model.mesh.n_nodes, len(model.inlets.by_flow), len(model.mesh.topology.outlet_segment),
        len(model.network.output_units()), len(model.tables.tables),
    )  # fmt: skip
    unread = dict.fromkeys(("parameters", "dt", "element_length", *_MARGINS), -1)
    unread |= dict.fromkeys(("g_begin", "g", "g_report", "g_show"), 2)  # anywhere: of n_sources numbers
    places = [{**unread, **p.address}[name] for name in (*PLACES, *FURTHER)]
    reasons = [texts.at(text) for reason in whole.reasons for text in reason]
    yield integers([*laws, len(whole.reasons), *counts, *places, *model.inlets.first, *reasons])
    yield from (p.code, p.begin)


def _derived(p: Program | None) -> Iterator[Array]:
    if p is None:
        yield from [integers([])] * 3
    else:
        unread = dict.fromkeys(("element_length", "g_begin", "g", "g_report"), 2)
        yield integers([p.n_fixed, p.n_work, *({**unread, **p.address}[name] for name in DERIVED_PLACES)])
        yield from (p.code, p.begin)


# --- of a heart or a body: three programs ---------------------------------------------------------------------------


def arithmetic_resource(component: Arithmetic, table: Sequence[Variable]) -> bytes:
    """The file, its GUID still open (:func:`~fmu_src.native.arrays.with_guid`).

    Raises ValueError for a sentence of a requirement that C cannot print.
    """
    shared, texts = Shared(), Texts()
    given = [variable for variable in table if variable.causality != "output"]
    choices = {variable.name: variable.choices for variable in given if variable.choices}
    programs = arithmetic.recorded(component, [variable.name for variable in given], choices, shared)
    arrays = tables(table, texts, n_programs=len(programs), n_arithmetic=programs[0].n_state)
    arrays |= {"index": shared.index.all(), "numbers": shared.constants.all()}
    return file_of(arrays, texts, [array for program in programs for array in _arithmetic(program, texts)])


def _arithmetic(recorded: Recorded, texts: Texts) -> Iterator[Array]:
    """Counts and places, code, where phases begin; and nothing more."""
    p, at = recorded.program, recorded.program.address
    numbers = [p.n_fixed, p.n_work, len(recorded.loops), len(recorded.requirements)]
    numbers += [at.get(name, -1) for name in ("values", "state", "t", "h", "direction")]
    numbers += [at["next_state"], at["outputs"]]
    for k, size in enumerate(recorded.loops):
        numbers += [size, *(at[f"{name}_{k}"] for name in ("begin", "before", "after"))]
    for k, must in enumerate(recorded.requirements):
        _check(must)
        places = [at[f"number_{k}_{i}"] for i in range(must.numbers)]
        numbers += [must.phase, at[f"required_{k}"], texts.at(must.sentence), *places, *[0] * (_NUMBERS - len(places))]
    yield integers(numbers)
    yield from (p.code, p.begin)
    yield from [integers([])] * 3


def _check(must: Requirement) -> None:
    """Raise ValueError where the sentence has another format than %g and %.6g, or not one for each number."""
    formats = [found for found in _FORMATS.findall(must.sentence) if found != "%%"]
    if "%" in _FORMATS.sub("", must.sentence):
        raise InputError(f"{must.sentence!r}: in an FMU without Python only %g, %.0g to %.19g and %% may be in it.")
    if not len(formats) == must.numbers <= _NUMBERS:
        raise InputError(
            f"{must.sentence!r}: has {len(formats)} places for {must.numbers} numbers; an FMU without Python needs one "
            f"for each, and takes up to {_NUMBERS}."
        )
