"""The pythonfmu slave: value references, phases and errors around :class:`CoSimulation`.

No exception may leave a callback as it is. The wrapper answers one with fmi2Fatal and drops references that it does
not own, so that the host would crash at the next garbage collection. ``do_step`` therefore logs and returns False
(fmi2Discard). The other callbacks can only fail by an exception: they raise one sentence after giving the wrapper
the references it is about to drop.
"""

from __future__ import annotations

import ctypes
import json
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element

from pythonfmu import DefaultExperiment, Fmi2Slave
from pythonfmu.enums import Fmi2Causality, Fmi2Initial, Fmi2Status, Fmi2Variability
from pythonfmu.variables import Real, ScalarVariable, String

from solver.network import from_dict
from solver.staggered import NonPhysicalState, Settings

from .cosimulation import CoSimulation
from .description import complete
from .variables import Variable, variable_table

INSTANTIATED, INITIALIZING, STEPPING, TERMINATED = "instantiated", "initialization mode", "stepping", "terminated"


class ArterialSlave(Fmi2Slave):
    """A network of arteries. The class attributes are set by the build: see ``build_fmu.py``."""

    author = "arterial-fmu contributors"
    license = "MIT"
    code_name = ""  # module name that carries the hash of all content
    content_hash = ""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        data = json.loads((Path(kwargs["resources"]) / "network.json").read_text(encoding="utf-8"))
        network = from_dict(data["network"])
        settings = Settings(**data["settings"])
        self.guid = self.content_hash
        self.modelName = network.name
        self.version = data["version"]
        self.description = f"1D blood flow in the arterial network {network.name}. {network.reference}".strip()
        self.default_experiment = DefaultExperiment(0.0, 5 * network.inlet.T, settings.dt, settings.tolerance)
        self.table = variable_table(network, settings)
        self.values: list[Any] = [variable.start for variable in self.table]
        self.first_output = next(i for i, v in enumerate(self.table) if v.causality == "output")
        self.index = {variable.name: i for i, variable in enumerate(self.table)}
        self.component = CoSimulation(network, settings)
        self.phase, self.changed, self.t0 = INSTANTIATED, True, 0.0
        for variable in self.table:
            self.register_variable(_registered(variable), nested=False)

    # --- phases ---------------------------------------------------------------------------------------------------

    def setup_experiment(self, start_time: float, *_: Any) -> None:
        self.t0, self.changed = start_time, True

    def enter_initialization_mode(self) -> None:
        self.phase = INITIALIZING

    def exit_initialization_mode(self) -> None:
        self._guarded("initialization", self._initialize)
        self.phase = STEPPING

    def terminate(self) -> None:
        self.phase = TERMINATED

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step; False, with the reason in the log, when it failed."""
        try:
            if self.phase != STEPPING:
                raise ValueError(f"do_step in phase {self.phase}: the component must be initialized first.")
            if self.changed:
                self.component.retune(self._by_name())
                self.changed = False
            self.component.step(current_time, step_size, self.values[self.index["inlet.Q"]])
            self.values[self.first_output :] = self.component.outputs()
            return True
        except (ValueError, NonPhysicalState) as error:
            self.log(f"{self.instance_name}: {error}", Fmi2Status.error)
        except Exception:  # a fault of ours must not kill the host: everything about it goes to the log
            self.log(
                f"{self.instance_name}: internal error at t = {current_time:g} s\n{traceback.format_exc()}",
                Fmi2Status.error,
            )
        return False

    # --- values ---------------------------------------------------------------------------------------------------

    def get_real(self, vrs: list[int]) -> list[float]:
        if self.phase == INITIALIZING and self.changed and max(vrs, default=0) >= self.first_output:
            self._guarded("reading outputs", self._initialize)
        values = self.values
        # outputs have no value before initialization mode
        return [0.0 if values[vr] is None else values[vr] for vr in vrs]

    def get_string(self, vrs: list[int]) -> list[str]:
        return [self.values[vr] for vr in vrs]

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        self._guarded("setting a variable", lambda: self._set(vrs, values))

    def set_string(self, vrs: list[int], values: list[str]) -> None:
        self._guarded("setting a variable", lambda: self._set(vrs, values))

    def _set(self, vrs: list[int], values: list[Any]) -> None:
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
            self.values[vr] = value
            # inlet.Q is read at every step; everything else needs new coefficients
            self.changed = self.changed or self.table[vr].name != "inlet.Q"

    def _by_name(self) -> dict[str, Any]:
        return {variable.name: value for variable, value in zip(self.table, self.values, strict=True)}

    def _initialize(self) -> None:
        self._check_code()
        self.component.initialize(self.t0, self._by_name())
        self.values[self.first_output :] = self.component.outputs()
        self.changed = False

    def _check_code(self) -> None:
        """Refuse to run the code of another FMU: a process keeps the first module of a name."""
        if self.resources is None:
            return
        expected = Path(self.resources) / "slavemodule.txt"
        if expected.is_file() and expected.read_text().strip() != self.code_name:
            raise ValueError(
                f"this process runs module {self.code_name} instead of {expected.read_text().strip()}; rebuild the FMU."
            )

    # --- errors ---------------------------------------------------------------------------------------------------

    def _guarded(self, what: str, action: Callable[[], None]) -> None:
        try:
            action()
        except (ValueError, NonPhysicalState) as error:
            self._fail(f"{self.instance_name}: {error}")
        except Exception:
            self._fail(f"{self.instance_name}: internal error while {what}\n{traceback.format_exc()}")

    def _fail(self, message: str) -> NoReturn:
        # the wrapper drops these three references before it reports fmi2Fatal, and once more when it frees the instance
        for held in (type(self), self, self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))
        raise ValueError(message)

    # --- description ----------------------------------------------------------------------------------------------

    def to_xml(self, model_options: dict[str, str] | None = None) -> Element:
        """modelDescription with units, ranges, InitialUnknowns and dependencies."""
        return complete(super().to_xml(model_options or {}), self.table)


def _registered(variable: Variable) -> ScalarVariable:
    """The pythonfmu variable of a row; values go through the slave's own get and set."""
    kind = Real if variable.quantity is not None else String
    return kind(
        variable.name,
        causality=Fmi2Causality[variable.causality],
        variability=Fmi2Variability[variable.variability],
        initial=Fmi2Initial.calculated if variable.causality == "output" else _initial(variable),
        description=variable.description,
        getter=lambda: variable.start,
    )


def _initial(variable: Variable) -> Fmi2Initial | None:
    return Fmi2Initial.exact if variable.causality == "parameter" else None  # FMI forbids ``initial`` on inputs
