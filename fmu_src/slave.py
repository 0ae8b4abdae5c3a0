"""The pythonfmu slave: value references, phases and errors around :class:`CoSimulation`.

No exception may leave a callback as it is. The wrapper answers one with fmi2Fatal and drops references that it does
not own, so that the host would crash at the next garbage collection. ``do_step`` therefore logs and returns False
(fmi2Discard). The other callbacks can only fail by an exception: they raise one sentence after giving the wrapper
the references it is about to drop.
"""

from __future__ import annotations

import ctypes
import json
import math
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NoReturn, TypeVar
from xml.etree.ElementTree import Element

from pythonfmu import DefaultExperiment, Fmi2Slave
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.variables import Real, ScalarVariable, String

from solver.network import Network, from_dict
from solver.scheme.guards import NonPhysicalState
from solver.scheme.model import Settings

from .cosimulation import CoSimulation
from .description import complete, description
from .variables import Variable, variable_table

INSTANTIATED, INITIALIZING, STEPPING, TERMINATED = "instantiated", "initialization mode", "stepping", "terminated"

T = TypeVar("T")


class ArterialSlave(Fmi2Slave):
    """A network of arteries. ``code_name`` and ``content_hash`` are set by the build: see ``build_fmu.py``."""

    author = "arterial-fmu contributors"
    license = "MIT"
    code_name = ""  # module name that carries the hash of all content
    content_hash = ""
    # read once: a class belongs to one content, and a reset works after the host has deleted the FMU's folder
    model: ClassVar[tuple[Network, Settings, str] | None] = None

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        cls = type(self)
        if cls.model is None:
            cls.model = _read_model(Path(kwargs["resources"]) / "network.json")
        network, settings, self.version = cls.model
        self.guid = self.content_hash
        self.modelName = network.name
        self.description = description(network)
        self.default_experiment = DefaultExperiment(0.0, 5 * network.inlet.T, settings.dt, settings.tolerance)
        self.table = variable_table(network, settings)
        self.names = tuple(variable.name for variable in self.table)
        # outputs have no value before initialization mode
        self.values: list[Any] = [0.0 if v.start is None else v.start for v in self.table]
        self.numbers = frozenset(i for i, v in enumerate(self.table) if v.quantity is not None)
        self.texts = frozenset(range(len(self.table))) - self.numbers
        self.inputs = frozenset(i for i, v in enumerate(self.table) if v.causality == "input")
        self.first_output = next(i for i, v in enumerate(self.table) if v.causality == "output")
        self.component = CoSimulation(network, settings)
        self.phase, self.t0 = INSTANTIATED, 0.0
        self.outdated = True  # the outputs, before initialization ends
        self.changed: dict[str, float] = {}  # tunable parameters since the last step
        for variable in self.table:
            self.register_variable(_registered(variable), nested=False)

    # --- phases ---------------------------------------------------------------------------------------------------

    def setup_experiment(self, start_time: float, *_: Any) -> None:
        def set_up() -> None:
            self._require("setup_experiment", INSTANTIATED)
            if not math.isfinite(start_time):
                raise ValueError(f"start time of {start_time:g} s: must be finite.")
            self.t0 = start_time

        self._guarded("setting up the experiment", set_up)

    def enter_initialization_mode(self) -> None:
        def enter() -> None:
            self._require("enter_initialization_mode", INSTANTIATED)
            if self.resources in sys.path:  # the wrapper puts it there at every instantiation and leaves it
                sys.path.remove(self.resources)
            self.phase = INITIALIZING

        self._guarded("entering initialization mode", enter)

    def exit_initialization_mode(self) -> None:
        def leave() -> None:
            self._require("exit_initialization_mode", INITIALIZING)
            self._initialize()
            self.phase = STEPPING

        self._guarded("initialization", leave)

    def terminate(self) -> None:
        self.phase = TERMINATED

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step; False, with the reason in the log, when it failed."""
        try:
            self._require("do_step", STEPPING)
            inputs = {self.names[i]: self.values[i] for i in self.inputs}
            if self.changed:
                self.component.retune({**inputs, **self.changed})
                self.changed = {}
            self.component.step(current_time, step_size, inputs)
            self.values[self.first_output :] = self.component.outputs()
            return True
        except BaseException as error:
            self.log(self._message(error, f"stepping from t = {current_time:g} s"), Fmi2Status.error)
        return False

    def _require(self, call: str, phase: str) -> None:
        if self.phase != phase:
            raise ValueError(f"{call} in phase {self.phase!r}: it belongs to phase {phase!r}; reset the component.")

    # --- values ---------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        return self._guarded("reading variables", lambda: self._get(vrs, self.numbers))

    def get_string(self, vrs: list[int]) -> list[str]:
        return self._guarded("reading variables", lambda: self._get(vrs, self.texts))

    def get_integer(self, vrs: list[int]) -> list[Any]:
        return self._guarded("reading variables", lambda: self._get(vrs, frozenset()))

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        self._guarded("setting variables", lambda: self._set(vrs, values, self.numbers))

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        self._guarded("setting variables", lambda: self._set(vrs, values, self.texts))

    def set_integer(self, vrs: list[int], values: list[Any]) -> None:
        self._guarded("setting variables", lambda: self._set(vrs, values, frozenset()))

    get_boolean, set_boolean = get_integer, set_integer  # no variable is of these types

    def _get(self, vrs: list[int], kind: frozenset[int]) -> list[Any]:
        self._check_kind(vrs, kind)
        if self.phase == INITIALIZING and self.outdated and max(vrs, default=0) >= self.first_output:
            self._initialize()
        values = self.values
        return [values[vr] for vr in vrs]

    def _set(self, vrs: list[int], values: list[Any], kind: frozenset[int]) -> None:
        self._check_kind(vrs, kind)
        for vr, value in zip(vrs, values, strict=True):
            variable = self.table[vr]
            if variable.causality == "output":
                raise ValueError(f"{variable.name} is an output and cannot be set.")
            if variable.variability == "fixed" and self.phase in (STEPPING, TERMINATED):
                raise ValueError(
                    f"{variable.name} is fixed: set it before initialization ends, or reset the component."
                )
            variable.check(value)
        for vr, value in zip(vrs, values, strict=True):
            if value != self.values[vr]:
                self.outdated = True
                # inputs are read at every step; a new value of anything else needs new coefficients
                if self.phase == STEPPING and vr not in self.inputs:
                    self.changed[self.names[vr]] = value
            self.values[vr] = value

    def _check_kind(self, vrs: list[int], kind: frozenset[int]) -> None:
        if not kind.issuperset(vrs):
            vr = next(vr for vr in vrs if vr not in kind)
            if not 0 <= vr < len(self.table):
                raise ValueError(f"value reference {vr}: there is no such variable.")
            right = "Real" if vr in self.numbers else "String"
            raise ValueError(f"{self.table[vr].name} is a {right} variable; read and set it as such.")

    def _initialize(self) -> None:
        self._check_code()
        self.component.initialize(self.t0, dict(zip(self.names, self.values, strict=True)))
        self.values[self.first_output :] = self.component.outputs()
        self.outdated = False

    def _check_code(self) -> None:
        """Refuse to run the code of another FMU: a process keeps the first module of a name."""
        expected = Path(self.resources) / "slavemodule.txt"
        if expected.is_file() and expected.read_text().strip() != self.code_name:
            raise ValueError(
                f"this process runs module {self.code_name} instead of {expected.read_text().strip()}; rebuild the FMU."
            )

    def _get_fmu_state(self, *_: Any) -> None:
        def refuse() -> NoReturn:
            raise ValueError("the state cannot be saved or restored (canGetAndSetFMUstate is false).")

        self._guarded("saving or restoring the state", refuse)

    _set_fmu_state = _get_fmu_state

    # --- errors ---------------------------------------------------------------------------------------------------

    def _guarded(self, what: str, action: Callable[[], T]) -> T:
        try:
            return action()
        except BaseException as error:
            message = self._message(error, what)
        # the wrapper drops these three references before it reports fmi2Fatal, and once more when it frees the instance
        for held in (type(self), self, self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
        raise ValueError(message)

    def _message(self, error: BaseException, what: str) -> str:
        """What goes to the host's log, where it is a printf format by the standard.

        A user's mistake is one sentence. Of a fault of ours, which must not kill the host either, it is everything.
        """
        if isinstance(error, (ValueError, NonPhysicalState)):
            text = str(error)
        elif isinstance(error, KeyboardInterrupt):
            text = f"interrupted while {what}."
        else:
            text = f"internal error while {what}\n{traceback.format_exc()}"
        return f"{self.instance_name}: {text}".replace("%", "%%")

    # --- description ----------------------------------------------------------------------------------------------

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """modelDescription with units, ranges, InitialUnknowns and dependencies."""
        return complete(super().to_xml(model_options or {}), self.table, self.version)


def _read_model(file: Path) -> tuple[Network, Settings, str]:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return from_dict(data["network"]), Settings(**data["settings"]), data["version"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{file.name}: not the one of this FMU ({error}); build the FMU anew.") from None


_INITIAL = {"parameter": Fmi2Initial.exact, "output": Fmi2Initial.calculated}  # FMI forbids it on inputs


def _registered(variable: Variable) -> ScalarVariable:
    """The pythonfmu variable of a row; values go through the slave's own get and set."""
    kind = Real if variable.quantity is not None else String
    return kind(
        variable.name,
        causality=Fmi2Causality[variable.causality],
        variability=Fmi2Variability[variable.variability],
        initial=_INITIAL.get(variable.causality),
        description=variable.description,
        getter=lambda: variable.start,
    )
