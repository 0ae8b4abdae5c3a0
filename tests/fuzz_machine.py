"""Random calls into instances of several FMUs, by FMPy, in a process of its own: what a host may do and may not.

    python fuzz_machine.py FOLDER EXAMPLES STEPS SEED FMU ...

Calls come in any order and with any arguments but those which the wrapper of pythonfmu takes without a look (see
docs/simulators.md): states that are null, foreign to Python or freed, text that is not UTF-8, an instance that was
freed. After each sequence a bystander of each FMU, an instance that gets none of these calls, is stepped: its outputs
must be the same bits as in a quiet process. After a step that was not refused all outputs must be finite. Prints the
number of calls, by kind. Where the process dies, the last line of FOLDER/calls says in which call.
"""

from __future__ import annotations

import ctypes
import gc
import json
import math
import os
import sys
from collections import Counter
from typing import Any, TextIO

import fmpy
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, rule, run_state_machine_as_test

COUNTS: Counter[str] = Counter()
REFUSED: Counter[str] = Counter()
MOST = 4  # instances at a time


MESSAGES: list[str] = []


def _log(_environment: Any, _instance: bytes, _status: int, _category: bytes, message: bytes) -> None:
    MESSAGES.append(message.decode())


# one for the process: FMPy's own would vanish with the instance, and it keeps the last one for all instances
CALLBACKS = fmi2.fmi2CallbackFunctions()
CALLBACKS.logger = fmi2.fmi2CallbackLoggerTYPE(_log)
CALLBACKS.allocateMemory = fmi2.defaultCallbacks.allocateMemory
CALLBACKS.freeMemory = fmi2.defaultCallbacks.freeMemory


class Unit:
    """An FMU that is unpacked once."""

    def __init__(self, path: str, folder: str) -> None:
        description = fmpy.read_model_description(path)
        self.options = {
            "guid": description.guid,
            "modelIdentifier": description.coSimulation.modelIdentifier,
            "unzipDirectory": fmpy.extract(path, folder),
            "instanceName": "fuzzed",
        }
        variables = description.modelVariables
        self.outputs = [v.valueReference for v in variables if v.causality == "output"]
        self.numbers = [v.valueReference for v in variables if v.type == "Real"]
        self.choices = [v.valueReference for v in variables if v.type == "Enumeration"] or [0]
        first = next(v for v in variables if v.causality == "input")  # inlet.Q of arteries
        self.inlet, self.size = first.valueReference, float(first.start) or 1e-5

    def instantiate(self) -> fmi2.FMU2Slave:
        slave = fmi2.FMU2Slave(**self.options)
        slave.instantiate(callbacks=CALLBACKS, loggingOn=True)
        return slave


class Bystander:
    """An instance that is left alone; its answer is known from the quiet start of the process."""

    def __init__(self, unit: Unit, steps: int) -> None:
        self.unit, self.i = unit, 0
        quiet, self.slave = unit.instantiate(), unit.instantiate()
        for slave in (quiet, self.slave):
            slave.setupExperiment(startTime=0.0)
            slave.enterInitializationMode()
            slave.exitInitializationMode()
        self.expected = [self._step(quiet, i) for i in range(steps)]
        quiet.freeInstance()

    def _step(self, slave: Any, i: int) -> list[float]:
        slave.setReal([self.unit.inlet], [self.unit.size * (1.0 + 0.1 * math.sin(0.1 * i))])
        slave.doStep(i * 2e-3, 2e-3)
        return slave.getReal(self.unit.outputs)

    def check(self) -> None:
        assert self._step(self.slave, self.i) == self.expected[self.i], f"another instance changed at step {self.i}"
        self.i += 1


WORLD: dict[str, Any] = {}

floats = st.sampled_from([0.0, 1.0, -1.0, 1e-5, 3e6, 1e300, -0.0, 1e-3]) | st.floats(width=64)
lengths = st.sampled_from([2e-3, 1e-3, 7.3e-4, 1e-2, 0.0, -1e-3, 1e9, 1e-9, 1e-300, float("nan"), float("inf")])
whole = st.integers(-(2**31), 2**31 - 1)
any_vrs = st.lists(st.integers(0, 200) | st.integers(0, 2**32 - 1), max_size=5)


class Host(RuleBasedStateMachine):
    """Instances and states in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.slaves: list[Any] = []
        self.units: list[Unit] = []
        self.times: list[float] = []
        self.states: list[tuple[ctypes.c_void_p, Unit, float, list[float] | None]] = []
        self.blobs: list[tuple[bytes, Unit, float]] = []

    def call(self, name: str, action: Any, *arguments: Any) -> Any:
        """The result, or None if the FMU refused: then with one sentence in the log."""
        log: TextIO = WORLD["log"]
        log.seek(0)
        log.truncate()
        log.write(f"{sum(COUNTS.values())} {name} {arguments!r}\n")
        log.flush()
        COUNTS[name] += 1
        MESSAGES.clear()
        if sum(COUNTS.values()) % 50 == 0:
            gc.collect()  # where a reference has been lost, this is where the process dies
        try:
            return action(*arguments)
        except FMICallException:
            REFUSED[name] += 1
            (message,) = MESSAGES
            assert "internal error" not in message, message
        return None

    def pick(self, data: st.DataObject, of: list[Any]) -> int | None:
        return data.draw(st.integers(0, len(of) - 1)) if of else None

    def slave(self, data: st.DataObject) -> tuple[int, Any, Unit]:
        if not self.slaves:
            self.start(WORLD["units"][0])
        k = self.pick(data, self.slaves)
        assert k is not None
        return k, self.slaves[k], self.units[k]

    def start(self, unit: Unit) -> None:
        slave = self.call("instantiate", unit.instantiate)
        self.slaves.append(slave)
        self.units.append(unit)
        self.times.append(0.0)

    def look(self, k: int) -> None:
        """After a step all outputs, ports included, can be read and are finite."""
        found = self.call("getReal", self.slaves[k].getReal, self.units[k].outputs)
        assert found is not None, f"outputs cannot be read after a step: {MESSAGES}"
        assert all(map(math.isfinite, found)), found

    @rule(data=st.data())
    def instantiate(self, data: st.DataObject) -> None:
        if len(self.slaves) < MOST:
            self.start(data.draw(st.sampled_from(WORLD["units"])))

    @rule(data=st.data())
    def ready(self, data: st.DataObject) -> None:
        """An instance that may step, for much that follows is refused at once otherwise."""
        k, slave, _ = self.slave(data)
        self.call("reset", slave.reset)
        self.call("setupExperiment", lambda: slave.setupExperiment(startTime=0.0))
        self.call("enterInitializationMode", slave.enterInitializationMode)
        self.call("exitInitializationMode", slave.exitInitializationMode)
        self.times[k] = 0.0

    @rule(data=st.data())
    def free(self, data: st.DataObject) -> None:
        k, slave, _ = self.slave(data)
        self.call("freeInstance", slave.freeInstance)
        for each in (self.slaves, self.units, self.times):
            del each[k]

    @rule(data=st.data())
    def setup(self, data: st.DataObject) -> None:
        _, slave, _ = self.slave(data)
        start, stop = data.draw(floats), data.draw(st.none() | floats)
        self.call("setupExperiment", lambda a, b: slave.setupExperiment(startTime=a, stopTime=b), start, stop)

    @rule(data=st.data())
    def phase(self, data: st.DataObject) -> None:
        k, slave, _ = self.slave(data)
        name = data.draw(st.sampled_from(["enterInitializationMode", "exitInitializationMode", "terminate", "reset"]))
        self.call(name, getattr(slave, name))
        if name == "reset":
            self.times[k] = 0.0

    @rule(data=st.data())
    def step(self, data: st.DataObject) -> None:
        k, slave, _ = self.slave(data)
        t = self.times[k] if data.draw(st.integers(0, 9)) else data.draw(floats)
        h = data.draw(lengths)
        before = REFUSED["doStep"]
        self.call("doStep", slave.doStep, t, h)
        if REFUSED["doStep"] == before:
            self.times[k] = t + h
            self.look(k)

    @rule(data=st.data())
    def drive(self, data: st.DataObject) -> None:
        """An ordinary step."""
        k, slave, unit = self.slave(data)
        self.call("setReal", slave.setReal, [unit.inlet], [unit.size * data.draw(st.floats(-1.0, 5.0))])
        before = REFUSED["doStep"]
        self.call("doStep", slave.doStep, self.times[k], 2e-3)
        if REFUSED["doStep"] == before:
            self.times[k] += 2e-3
            self.look(k)

    @rule(data=st.data())
    def set_real(self, data: st.DataObject) -> None:
        _, slave, unit = self.slave(data)
        vrs = data.draw(st.lists(st.sampled_from(unit.numbers), max_size=4) | any_vrs)
        self.call("setReal", slave.setReal, vrs, data.draw(st.lists(floats, min_size=len(vrs), max_size=len(vrs))))

    @rule(data=st.data())
    def tune(self, data: st.DataObject) -> None:
        """A parameter a little off its value."""
        _, slave, unit = self.slave(data)
        vr = data.draw(st.sampled_from(unit.numbers))
        found = self.call("getReal", slave.getReal, [vr])
        if found:
            self.call("setReal", slave.setReal, [vr], [found[0] * data.draw(st.floats(0.9, 1.1))])

    @rule(data=st.data())
    def set_other(self, data: st.DataObject) -> None:
        _, slave, unit = self.slave(data)
        vrs = data.draw(st.lists(st.sampled_from(unit.choices), max_size=3) | any_vrs)
        n = {"min_size": len(vrs), "max_size": len(vrs)}
        kind = data.draw(st.sampled_from(["setInteger", "setInteger", "setBoolean", "setString"]))
        values = {
            "setInteger": st.lists(st.integers(0, 4) | whole, **n),
            "setBoolean": st.lists(st.booleans(), **n),
            "setString": st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")), **n),
        }
        self.call(kind, getattr(slave, kind), vrs, data.draw(values[kind]))

    @rule(data=st.data())
    def get(self, data: st.DataObject) -> None:
        _, slave, unit = self.slave(data)
        kind = data.draw(st.sampled_from(["getReal", "getReal", "getInteger", "getBoolean", "getString"]))
        vrs = data.draw(st.sampled_from([unit.outputs, unit.choices]) | any_vrs)
        self.call(kind, getattr(slave, kind), vrs)

    @rule(data=st.data())
    def unsupported(self, data: st.DataObject) -> None:
        """Functions that the wrapper has and does not carry out."""
        _, slave, unit = self.slave(data)
        vr, order, value = (ctypes.c_uint * 1)(unit.inlet), (ctypes.c_int * 1)(1), (ctypes.c_double * 1)(1.0)
        one, c = ctypes.c_size_t(1), ctypes.c_void_p(slave.component)
        arguments = {
            "fmi2SetRealInputDerivatives": (c, vr, one, order, value),
            "fmi2GetRealOutputDerivatives": (c, vr, one, order, value),
            "fmi2GetDirectionalDerivative": (c, vr, one, vr, one, value, value),
            "fmi2CancelStep": (c,),
        }
        name = data.draw(st.sampled_from(sorted(arguments)))
        function = ctypes.CDLL(slave.dll._name)[name]
        assert self.call(name, function, *arguments[name]) == 3  # fmi2Error

    @rule(data=st.data())
    def save(self, data: st.DataObject) -> None:
        k, slave, unit = self.slave(data)
        outputs = self.call("getReal", slave.getReal, unit.outputs)
        state = self.call("getFMUState", slave.getFMUState)
        self.states.append((state, unit, self.times[k], outputs))

    @rule(data=st.data())
    def restore(self, data: st.DataObject) -> None:
        """In any instance, of the other FMU too."""
        k, slave, unit = self.slave(data)
        at = self.pick(data, self.states)
        if at is None:
            return
        state, of, time, outputs = self.states[at]
        before = REFUSED["setFMUState"]
        self.call("setFMUState", slave.setFMUState, state)
        assert (REFUSED["setFMUState"] == before) == (of is unit)
        if of is unit:
            self.times[k] = time
            if outputs is not None:
                assert repr(slave.getReal(unit.outputs)) == repr(outputs)

    @rule(data=st.data())
    def free_state(self, data: st.DataObject) -> None:
        _, slave, _ = self.slave(data)
        at = self.pick(data, self.states)
        if at is not None:
            self.call("freeFMUState", slave.freeFMUState, self.states.pop(at)[0])

    @rule(data=st.data())
    def serialize(self, data: st.DataObject) -> None:
        _, slave, unit = self.slave(data)
        at = self.pick(data, self.states)
        if at is None:
            return
        state, of, time, _ = self.states[at]
        blob = self.call("serializeFMUState", slave.serializeFMUState, state)
        assert (blob is not None) == (of is unit)
        if blob is not None and len(self.blobs) < 5:
            self.blobs.append((blob, unit, time))

    @rule(data=st.data())
    def deserialize(self, data: st.DataObject) -> None:
        """Right bytes, or changed ones, or any."""
        _, slave, unit = self.slave(data)
        blob, of, time = data.draw(st.sampled_from(self.blobs)) if self.blobs else (b"", None, 0.0)
        change = data.draw(st.sampled_from(["none", "none", "cut", "byte", "other"]))
        if change == "cut":
            blob, of = blob[: data.draw(st.integers(0, max(0, len(blob) - 1)))], None
        elif change == "byte" and blob:
            i = data.draw(st.integers(0, len(blob) - 1))
            blob, of = blob[:i] + bytes([blob[i] ^ data.draw(st.integers(1, 255))]) + blob[i + 1 :], None
        elif change == "other":
            blob, of = data.draw(st.binary(max_size=100)), None
        state = self.call("deSerializeFMUState", slave.deSerializeFMUstate, blob)
        assert (state is not None) == (of is unit)
        if state is not None:
            self.states.append((state, unit, time, None))

    def teardown(self) -> None:
        for slave in self.slaves:
            for state, *_ in self.states:
                slave.freeFMUState(state)
            self.states.clear()
            slave.freeInstance()
        for bystander in WORLD["bystanders"]:
            bystander.check()


def main(folder: str, examples: str, steps: str, number: str, *fmus: str) -> None:
    """Run the machine and print what was called."""
    units = [Unit(fmu, os.path.join(folder, f"{i}")) for i, fmu in enumerate(fmus)]
    with open(os.path.join(folder, "calls"), "w", encoding="utf-8") as log:
        WORLD.update(units=units, bystanders=[Bystander(unit, int(examples) + 50) for unit in units], log=log)
        gc.freeze()  # what is there by now: collections look at what the calls have made
        chosen = settings(
            max_examples=int(examples),
            stateful_step_count=int(steps),
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        run_state_machine_as_test(seed(int(number))(Host), settings=chosen)
    print(json.dumps({"calls": sum(COUNTS.values()), "refused": sum(REFUSED.values()), "kinds": COUNTS}))


if __name__ == "__main__":
    main(*sys.argv[1:])
