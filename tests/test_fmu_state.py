"""Saved states of an FMU: what follows a restored state is the same to the last bit; wrong bytes change nothing."""

from __future__ import annotations

import ctypes
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Fatal
from fmus import MS, Instance, Store, run_python

from build_fmu import build
from fmu_src.contents.models import body_model, heart_model
from solver import Network, load

Make = Callable[..., Instance]

TUNED = {"CA.E": 3e6, "CA.phi0": 1e3, "VA3.outlet.R2": 1e9}
WAYS = {
    "hold": (MS, {}),
    "linear": (MS, {"inlet.interpolation": "linear"}),
    "smooth": (MS, {"inlet.interpolation": "smooth"}),
    "off the grid": (0.73e-3, {"inlet.interpolation": "smooth", "network.viscous_law": "monotone"}),
}


def onwards(instance: Instance, i: int, h: float, n: int = 12) -> list[list[float]]:
    """All outputs, ports included, over n steps from step i on; tuned in the middle."""
    rows = []
    for k in range(i, i + n):
        if k == i + n // 2:
            instance.set({"CA.E": 2.5e6, "CA.outlet.P_venous": 300.0})
        rows.append(instance.step(k, 1e-6 * k, h))
    return rows


def prepared(instantiate: Make, way: str) -> tuple[Instance, float]:
    """An instance of all kinds of outlets after 20 steps and a change of parameters; more are still to be taken up."""
    h, starts = WAYS[way]
    instance = instantiate("mixed")
    instance.initialize(starts)
    for i in range(20):
        if i == 10:
            instance.set(TUNED)
        instance.step(i, 5e-6, h)
    instance.set({"AA.E": 1.1e6, "CA.outlet.P_venous": 450.0})
    return instance, h


@pytest.mark.parametrize("way", WAYS)
def test_same_instance(instantiate: Make, way: str) -> None:
    """Save, go on, restore, go on: the same bits, values that were set included; also from a state saved twice."""
    instance, h = prepared(instantiate, way)
    state = instance.slave.getFMUState()
    parameters = instance.get(["AA.E", "CA.E", "CA.outlet.P_venous"])
    first = onwards(instance, 20, h)
    for _ in range(2):
        instance.slave.setFMUState(state)
        assert instance.get(["AA.E", "CA.E", "CA.outlet.P_venous"]) == parameters
        assert onwards(instance, 20, h) == first
    instance.slave.freeFMUState(state)
    assert len({tuple(row) for row in first}) == len(first)


@pytest.mark.parametrize("way", WAYS)
def test_other_instance(instantiate: Make, way: str) -> None:
    """A state restored in another instance, directly and through bytes, goes on there with the same bits."""
    instance, h = prepared(instantiate, way)
    state = instance.slave.getFMUState()
    blob = instance.slave.serializeFMUState(state)
    expected = onwards(instance, 20, h)
    direct, fresh, used = instantiate("mixed"), instantiate("mixed"), instantiate("mixed")
    used.initialize({"network.elastic_law": "regression", "solver.dt": 0.5e-3, "CA.L": 0.3})
    used.step(0, 1e-6)
    direct.slave.setFMUState(state)
    assert onwards(direct, 20, h) == expected
    for other in (fresh, used):
        other.slave.setFMUState(other.slave.deSerializeFMUstate(blob))
        assert onwards(other, 20, h) == expected
    again = other.slave.serializeFMUState(state)
    assert again == blob


CONTINUED = """
import json, sys
from pathlib import Path
from fmus import Instance, Store
from test_fmu_state import onwards
fmu, blob, folder, h = sys.argv[1:]
instance = Instance(Path(fmu), Path(folder))
instance.slave.setFMUState(instance.slave.deSerializeFMUstate(Path(blob).read_bytes()))
print(json.dumps(onwards(instance, 20, float(h))))
"""


@pytest.mark.parametrize(
    "way", [pytest.param(way, marks=[pytest.mark.slow] * (way in ("hold", "linear"))) for way in WAYS]
)
def test_new_process(instantiate: Make, fmus: dict[str, Path], tmp_path: Path, way: str) -> None:
    """A new process reads the bytes and goes on with the same bits."""
    instance, h = prepared(instantiate, way)
    blob = instance.slave.serializeFMUState(instance.slave.getFMUState())
    (tmp_path / "state").write_bytes(blob)
    arguments = (os.fspath(fmus["mixed"]), os.fspath(tmp_path / "state"), os.fspath(tmp_path / "new"), repr(h))
    done = run_python(CONTINUED, *arguments, cwd=Path(__file__).parent)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == onwards(instance, 20, h)


def test_any_phase(instantiate: Make) -> None:
    """States saved before, during and after initialization and after the end bring their phase and start time back."""
    instance, other = instantiate("sheep"), instantiate("sheep")
    states = [instance.slave.getFMUState()]
    instance.set({"CA.L": 0.2})
    instance.slave.setupExperiment(startTime=2.0, stopTime=2.01)
    instance.slave.enterInitializationMode()
    states.append(instance.slave.getFMUState())
    instance.slave.exitInitializationMode()
    states.append(instance.slave.getFMUState())
    rows = [instance.step(2000 + i, 1e-5) for i in range(10)]
    instance.slave.terminate()
    states.append(instance.slave.getFMUState())
    blobs = [instance.slave.serializeFMUState(state) for state in states]

    for state in (states[3], other.slave.deSerializeFMUstate(blobs[3])):
        other.slave.setFMUState(state)
        assert other.get() == rows[-1]
        with pytest.raises(FMICallException):
            other.step(2010, 1e-5)
        assert "do_step in phase 'terminated'" in other.messages.pop()
    for state in (states[2], other.slave.deSerializeFMUstate(blobs[2])):
        other.slave.setFMUState(state)
        assert [other.step(2000 + i, 1e-5) for i in range(10)] == rows
        with pytest.raises(FMICallException):
            other.step(2010, 1e-5)
        assert "the stop time is 2.01 s" in other.messages.pop()
    for state in (states[1], other.slave.deSerializeFMUstate(blobs[1])):
        other.slave.setFMUState(state)
        other.slave.exitInitializationMode()
        assert [other.step(2000 + i, 1e-5) for i in range(10)] == rows
    for state in (states[0], other.slave.deSerializeFMUstate(blobs[0])):
        other.slave.setFMUState(state)
        other.initialize({"CA.L": 0.2}, start_time=2.0)
        assert [other.step(2000 + i, 1e-5) for i in range(10)] == rows


def test_effects_with_memory(sheep: Network, tmp_path: Path) -> None:
    """Effects that are tuned from 0 give the state a memory; it is in the bytes too."""
    fmu = build(sheep.with_terms({"CA.tau": 0.0, "MD.tau": 0.0, "fluid.unsteady_scale": 0.0, "AA.leak": 0.0}), tmp_path)
    instance, other = (Instance(fmu, tmp_path / name) for name in ("first", "second"))
    instance.initialize()
    for i in range(10):
        if i == 5:
            instance.set({"CA.tau": 0.02, "fluid.unsteady_scale": 1.0, "AA.leak": 1e-9})
        instance.step(i, 1e-5)
    blob = instance.slave.serializeFMUState(instance.slave.getFMUState())
    other.slave.setFMUState(other.slave.deSerializeFMUstate(blob))
    for each in (instance, other):
        each.set({"MD.tau": 0.01})
    assert [other.step(i, 2e-5) for i in range(10, 20)] == [instance.step(i, 2e-5) for i in range(10, 20)]
    for each in (instance, other):
        each.slave.freeInstance()


MODELS: dict[str, tuple[Callable[[Store], Path], dict[str, float | str], dict[str, float]]] = {
    "heart": (lambda stored: stored.lumped(heart_model), {}, {"heart.rate": 1.5}),
    "body": (lambda stored: stored.lumped(body_model, "sheep"), {"body.exchange": "start"}, {"arteries.V": 2e-6}),
    "pressure inlet": (
        lambda stored: stored(build, replace(load("sheep"), inlet=replace(load("sheep").inlet, causality="pressure"))),
        {},
        {"inlet.P": 900.0, "CA.E": 2e6},
    ),
    "periodic start": (
        lambda stored: stored(build, load("sheep")),
        {"network.start": "periodic", "inlet.interpolation": "smooth"},
        {"inlet.Q": 2e-5},
    ),
}


@pytest.mark.parametrize("model", MODELS)
def test_other_models(stored: Store, tmp_path: Path, model: str) -> None:
    """Every kind of FMU goes on with the same bits in another instance that read its bytes."""
    make, starts, later = MODELS[model]
    fmu = make(stored)
    instance, other = (Instance(fmu, tmp_path / name) for name in ("first", "second"))
    instance.initialize(starts)
    for i in range(6):
        instance.slave.doStep(i * MS, MS)
    instance.set(later)
    state = instance.slave.getFMUState()
    other.slave.setFMUState(other.slave.deSerializeFMUstate(instance.slave.serializeFMUState(state)))

    def onwards(each: Instance) -> list[list[float]]:
        rows = []
        for i in range(6, 15):
            each.slave.doStep(i * MS, MS)
            rows.append(each.get())
        return rows

    expected = onwards(instance)
    assert onwards(other) == expected
    instance.slave.setFMUState(state)
    assert onwards(instance) == expected
    for each in (instance, other):
        each.slave.freeInstance()


# --- what is refused ----------------------------------------------------------------------------------------------


# FMPy sends the messages of all instances to the logger of the last one that was instantiated.


def refused(instance: Instance, blob: bytes) -> str:
    """The sentence in the log for bytes that are no state of the FMU."""
    instance.messages.clear()
    with pytest.raises(FMICallException) as error:
        instance.slave.deSerializeFMUstate(blob)
    assert error.value.status == fmi2Fatal
    (message,) = instance.messages
    return message.partition("\n")[2]


def test_refused_bytes(instantiate: Make) -> None:
    """Foreign, truncated and damaged bytes: fmi2Fatal, one sentence, and the instance goes on with the same bits."""
    foreign = instantiate("sheep")
    foreign.initialize()
    instance, h = prepared(instantiate, "smooth")
    state = instance.slave.getFMUState()
    blob = instance.slave.serializeFMUState(state)
    theirs = foreign.slave.serializeFMUState(foreign.slave.getFMUState())
    assert refused(instance, b"") == (
        "ValueError('mixed: state of 0 bytes: not a saved state of an FMU of this project; save one anew.')"
    )
    assert "incomplete or damaged; give all bytes" in refused(instance, blob[:-1])
    assert "incomplete or damaged" in refused(instance, blob[:200] + b"x" + blob[201:])
    assert "incomplete or damaged" in refused(instance, blob + b"\0")
    assert "not a saved state" in refused(instance, b"\x80\x04" + blob)
    assert "ValueError('mixed: state of the FMU {" in refused(instance, theirs)
    after = onwards(instance, 20, h)
    instance.slave.setFMUState(state)
    assert onwards(instance, 20, h) == after


def test_state_of_another_fmu(instantiate: Make) -> None:
    """The state object of another FMU, or of none, is refused when it is set or written; nothing is changed."""
    foreign = instantiate("sheep")
    foreign.initialize()
    instance, h = prepared(instantiate, "hold")
    theirs, own = foreign.slave.getFMUState(), instance.slave.getFMUState()
    some = "text"  # a Python object that is no state
    for state in (theirs, ctypes.c_void_p(id(some))):
        for call in (instance.slave.setFMUState, instance.slave.serializeFMUState):
            instance.messages.clear()
            with pytest.raises(FMICallException):
                call(state)
            (message,) = instance.messages
            assert message.endswith("the state is not one of this FMU; give one that this FMU saved.')")
    after = onwards(instance, 20, h)
    instance.slave.setFMUState(own)
    assert onwards(instance, 20, h) == after


def test_stop_time_and_long_steps(instantiate: Make) -> None:
    """A step beyond the stop time, or of more than a million internal steps, is refused with a sentence at once."""
    instance = instantiate("sheep")
    instance.slave.setupExperiment(startTime=0.0, stopTime=0.0123)
    instance.slave.enterInitializationMode()
    instance.slave.exitInitializationMode()
    for i in range(12):
        instance.step(i, 1e-5)
    for t, h, sentence in (
        (0.012, 1e-3, "step to t = 0.013 s: the stop time is 0.0123 s; end there, or set up a later one."),
        (0.012, 1e9, "step to t = 1e+09 s: the stop time is 0.0123 s; end there, or set up a later one."),
    ):
        with pytest.raises(FMICallException):
            instance.slave.doStep(t, h)
        assert instance.messages.pop() == f"sheep: {sentence}"
    instance.slave.doStep(0.012, 0.0003 * (1 + 1e-12))
    free = instantiate("sheep")
    free.initialize()
    with pytest.raises(FMICallException):
        free.slave.doStep(0.0, 1e9)
    assert "more than 1000000 internal steps of 0.001 s" in free.messages.pop()
    assert free.step(0, 1e-5)[0] > 0.0
    late = instantiate("sheep")
    with pytest.raises(FMICallException):
        late.slave.setupExperiment(startTime=1.0, stopTime=0.5)
    assert "stop time of 0.5 s: must not lie before the start time of 1 s." in late.messages.pop()
