"""The pythonfmu slave of any component: value references, phases, saved states, and errors.

A slave of one is a class that says how to make the component of an FMU::

    class HeartSlave(ComponentSlave):
        data_file = "heart.json"  # in the FMU's resources

        @classmethod
        def subject(cls, data):  # data: what the file holds
            ...
            return Subject(name, description, data["version"], experiment, table, lambda: Heart(settings))

No exception may leave a callback as it is. The wrapper answers one with fmi2Fatal and drops references that it does
not own, so that the host would crash at the next garbage collection. ``do_step`` therefore logs and returns False
(fmi2Discard). The other callbacks can only fail by an exception: they raise one sentence after giving the wrapper
the references it is about to drop.
"""

from __future__ import annotations

import json
import math
import sys
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar
from xml.etree.ElementTree import Element

from pythonfmu import DefaultExperiment
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.variables import Integer, Real, ScalarVariable

from solver.errors import InputError
from solver.lumped.component import Component

from ..variables.model_description import complete
from ..variables.variable import Variable
from .saving import INITIALIZING, INSTANTIATED, STEPPING, TERMINATED, SavingSlave, guarded, sentence


@dataclass(frozen=True)
class Subject:
    """The facts of a component's FMU: its name and description for people, and its variables.

    version : of the program that built it. table : inputs, then parameters, then outputs. make : a new component.
    """

    name: str
    description: str
    version: str
    experiment: DefaultExperiment
    table: tuple[Variable, ...]
    make: Callable[[], Component]


class ComponentSlave(SavingSlave):
    """The slave of a component. ``code_name`` and ``content_hash`` are set by the build: see ``build_fmu.py``."""

    author = "arterial-fmu contributors"
    license = "MIT"
    copyright = "© 2026 arterial-fmu contributors"
    code_name = ""  # module name that carries the hash of all content
    data_file = ""  # JSON in the FMU's resources
    # read once: a class belongs to one content, and a reset works after the host has deleted the FMU's folder
    about: ClassVar[Subject | None] = None

    @classmethod
    @abstractmethod
    def subject(cls, data: Any) -> Subject:
        """The subject of this FMU, from its data file."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cls = type(self)
        if cls.about is None:
            cls.about = _read(cls.subject, Path(kwargs["resources"]) / cls.data_file)
        about = cls.about
        self.version, self.guid = about.version, self.content_hash
        self.modelName, self.description = about.name, about.description
        self.default_experiment = about.experiment
        self.table = about.table
        self.names = tuple(variable.name for variable in self.table)
        # outputs have no value before initialization mode
        self.values: list[Any] = [0.0 if v.start is None else v.start for v in self.table]
        self.numbers = frozenset(i for i, v in enumerate(self.table) if v.quantity is not None)
        self.choices = frozenset(range(len(self.table))) - self.numbers
        self.inputs = frozenset(i for i, v in enumerate(self.table) if v.causality == "input")
        # the range of each input, which is checked in every step
        self.inside = {i: (v.quantity.low, v.quantity.high) for i in self.inputs if (v := self.table[i]).quantity}
        self.first_output = next(i for i, v in enumerate(self.table) if v.causality == "output")
        self.first_late = next((i for i, v in enumerate(self.table) if v.late), len(self.table))
        self.at_hand = frozenset(i for i in self.numbers if i < self.first_late)
        self.component = about.make()
        self.phase, self.t0 = INSTANTIATED, 0.0
        self.stop_time: float | None = None
        self.outdated = True  # the outputs, before initialization ends
        self.late_due = False  # the late outputs are not computed yet
        self.changed: dict[str, float] = {}  # tunable parameters since the last step
        for variable in self.table:
            self.register_variable(_registered(variable), nested=False)

    # --- phases ---------------------------------------------------------------------------------------------------

    @guarded("setting up the experiment")
    def setup_experiment(self, start_time: float, stop_time: float | None = None, *_: Any) -> None:
        self._require("setup_experiment", INSTANTIATED)
        if not math.isfinite(start_time):
            raise InputError(f"start time of {start_time:g} s: must be finite.")
        if stop_time is not None and not stop_time >= start_time:
            raise InputError(f"stop time of {stop_time:g} s: must not lie before the start time of {start_time:g} s.")
        self.t0, self.stop_time = start_time, stop_time

    @guarded("entering initialization mode")
    def enter_initialization_mode(self) -> None:
        self._require("enter_initialization_mode", INSTANTIATED)
        self._settle()
        self.phase = INITIALIZING

    @guarded("initialization")
    def exit_initialization_mode(self) -> None:
        self._require("exit_initialization_mode", INITIALIZING)
        self._initialize()
        self.phase = STEPPING

    def terminate(self) -> None:
        self.phase = TERMINATED

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step; False, with the reason in the log and nothing changed, when it failed."""
        before = self.component.__dict__.copy()
        try:
            self._require("do_step", STEPPING)
            self._check_end(current_time + step_size, step_size)
            inputs = {self.names[i]: self.values[i] for i in self.inputs}
            if self.changed:
                self.component.retune({**inputs, **self.changed})
            self.component.step(current_time, step_size, inputs)
            self._show()
            self.changed = {}
            if self.component.remark:
                self.log(f"{self.instance_name}: {self.component.remark}", Fmi2Status.warning)
            return True
        except BaseException as error:
            self.component.__dict__ = before
            self.log(sentence(self.instance_name, error, f"stepping from t = {current_time:g} s"), Fmi2Status.error)
        return False

    def _check_end(self, t: float, h: float) -> None:
        """Reject a step beyond the stop time, within the round-off of communication points."""
        if self.stop_time is not None and t > self.stop_time + 1e-6 * abs(h) + 1e-9 * abs(t):
            raise InputError(
                f"step to t = {t:.9g} s: the stop time is {self.stop_time:.9g} s; end there, or set up a later one."
            )

    def _require(self, call: str, phase: str) -> None:
        if self.phase != phase:
            raise InputError(f"{call} in phase {self.phase!r}: it belongs to phase {phase!r}; reset the component.")

    # --- values ---------------------------------------------------------------------------------------------------

    @guarded("reading variables")
    def get_real(self, vrs: list[int]) -> list[float]:
        if self.phase == STEPPING and self.at_hand.issuperset(vrs):  # the usual case, at every step
            values = self.values
            return [values[vr] for vr in vrs]
        return self._get(vrs, self.numbers)

    @guarded("reading variables")
    def get_integer(self, vrs: list[int]) -> list[int]:
        """The numbers of Enumerations; there are no other integers."""
        return [self.table[vr].number(text) for vr, text in zip(vrs, self._get(vrs, self.choices), strict=True)]

    @guarded("reading variables")
    def get_string(self, vrs: list[int]) -> list[Any]:
        return self._get(vrs, frozenset())

    @guarded("setting variables")
    def set_real(self, vrs: list[int], values: list[float]) -> None:
        self._set(vrs, values, self.numbers)

    @guarded("setting variables")
    def set_integer(self, vrs: list[int], values: list[int]) -> None:
        self._check_kind(vrs, self.choices)
        texts = [self.table[vr].choice(number) for vr, number in zip(vrs, values, strict=True)]
        self._set(vrs, texts, self.choices)

    @guarded("setting variables")
    def set_string(self, vrs: list[int], values: list[Any]) -> None:
        self._set(vrs, values, frozenset())

    get_boolean, set_boolean = get_string, set_string  # no variable is of these types

    def _get(self, vrs: list[int], kind: frozenset[int]) -> list[Any]:
        self._check_kind(vrs, kind)
        last = max(vrs, default=0)
        if self.phase == INITIALIZING and self.outdated and last >= self.first_output:
            self._initialize()
        if self.late_due and last >= self.first_late:
            ports = self.component.ports()
            self.values[self.first_late :] = [ports[name] for name in self.names[self.first_late :]]
            self.late_due = False
        values = self.values
        return [values[vr] for vr in vrs]

    def _set(self, vrs: list[int], values: list[Any], kind: frozenset[int]) -> None:
        self._check_kind(vrs, kind)
        for vr, value in zip(vrs, values, strict=True):
            inside = self.inside.get(vr)
            if inside is None or not inside[0] < value < inside[1]:
                self._check_setting(self.table[vr], value)
        for vr, value in zip(vrs, values, strict=True):
            if value != self.values[vr]:
                self.outdated = True
                # inputs are read at every step; a new value of anything else needs new coefficients
                if self.phase == STEPPING and vr not in self.inputs:
                    self.changed = {**self.changed, self.names[vr]: value}
            self.values[vr] = value

    def _check_setting(self, variable: Variable, value: Any) -> None:
        if variable.causality == "output":
            raise InputError(f"{variable.name} is an output and cannot be set.")
        if variable.variability == "fixed" and self.phase in (STEPPING, TERMINATED):
            raise InputError(f"{variable.name} is fixed: set it before initialization ends, or reset the component.")
        variable.check(value)

    def _check_kind(self, vrs: list[int], kind: frozenset[int]) -> None:
        if not kind.issuperset(vrs):
            vr = next(vr for vr in vrs if vr not in kind)
            if not 0 <= vr < len(self.table):
                raise InputError(f"value reference {vr}: there is no such variable.")
            right = "a Real variable" if vr in self.numbers else "an Enumeration (Integer)"
            raise InputError(f"{self.table[vr].name} is {right}; read and set it as such.")

    def _initialize(self) -> None:
        self.component.initialize(self.t0, dict(zip(self.names, self.values, strict=True)))
        self._show()
        self.outdated = False

    def _show(self) -> None:
        outputs = self.component.outputs()
        if not all(map(math.isfinite, outputs)):
            i = next(i for i, value in enumerate(outputs) if not math.isfinite(value))
            raise InputError(
                f"{self.names[self.first_output + i]} would be {outputs[i]:g}: must be finite; check the values of "
                "inputs and parameters, and their units."
            )
        self.values[self.first_output : self.first_late] = outputs
        self.late_due = True

    def _settle(self) -> None:
        if self.resources in sys.path:  # the wrapper inserts it at every instantiation and does not remove it
            sys.path.remove(self.resources)
        self._check_code()

    def _check_code(self) -> None:
        """Refuse to run the code of another FMU: a process keeps the first module of a name."""
        expected = Path(self.resources) / "slavemodule.txt"
        if expected.is_file() and expected.read_text().strip() != self.code_name:
            raise InputError(
                f"this process runs module {self.code_name} instead of {expected.read_text().strip()}; rebuild the FMU."
            )

    @classmethod
    def _new(cls) -> Component:
        assert cls.about is not None
        return cls.about.make()

    @classmethod
    def _title(cls) -> str:
        return cls.about.name if cls.about else cls.code_name

    # --- description ----------------------------------------------------------------------------------------------

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """modelDescription with units, ranges, InitialUnknowns and dependencies."""
        return complete(super().to_xml(model_options or {}), self.table, self.version)


def _read(subject: Callable[[Any], Subject], file: Path) -> Subject:
    try:
        return subject(json.loads(file.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file.name}: not the one of this FMU ({error}); build the FMU anew.") from None


_INITIAL = {"parameter": Fmi2Initial.exact, "output": Fmi2Initial.calculated}  # FMI forbids it on inputs


def _registered(variable: Variable) -> ScalarVariable:
    """The pythonfmu variable of a row; values go through the slave's own get and set."""
    kind = Real if variable.quantity is not None else Integer  # which the description turns into an Enumeration
    start = variable.start if variable.quantity is not None else variable.number(str(variable.start))
    return kind(
        variable.name,
        causality=Fmi2Causality[variable.causality],
        variability=Fmi2Variability[variable.variability],
        initial=_INITIAL.get(variable.causality),
        description=variable.description,
        getter=lambda: start,
    )
