"""Run an FMU of this project through fmpy, with the inflow known in advance: ``arterial-fmu run FMU``.

A process that has run one FMU keeps its code (pythonfmu). The command line is therefore how other programs run an FMU
in a fresh process: inputs and start values are files, and so is the result.
"""

from __future__ import annotations

import ast
import math
import os
import re
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeAlias

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2Warning
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription

from solver.errors import InputError
from solver.io.interrupts import interrupts_later
from solver.quantities.text import did_you_mean

from ..cosimulation.drive import DRIVES
from ..cosimulation.ports import is_port
from .unpacking import unpacking_folder

Array = np.ndarray
_BY_NETWORK = DRIVES.index("network") + 1
Input = Callable[[Array], Array]


class FMUError(RuntimeError):
    """A failed call of the FMU, with the FMU's log message."""


def run_fmu(
    fmu: str | os.PathLike[str],
    inflow: Input | None,
    stop_time: float,
    *,
    step: float = 1e-3,
    start_values: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Input] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Array]:
    """Step an FMU from 0 to ``stop_time`` [s]; return "time", inputs, outputs without the ports, each (n,) in SI.

    inflow : Q(t) [m³/s] for an array of times, or P(t) [Pa] of an FMU whose input is inlet.P. inlet.interpolation is
    ``linear`` and inlet.Q is set to Q(t + h) before the step from t, so the inflow is piecewise linear through the
    samples, without the half-step delay of a held input. None: the network's own drives (inlet.drive = network). step :
    communication step [s]; the last one ends at the stop time. start_values : parameters by FMU variable name. inputs :
    u(t) of further inputs by name: the drive of another inlet, or others such as "AA.outlet.P_venous". Between
    communication points the FMU keeps these constant, so each is set to u(t + h/2) for the step from t to t + h. That
    is the mean of u over the step up to O(h²), so its effect is accurate to second order; u(t) would act half a step
    late, an error of O(h). The start value is u(0). An output that follows an input immediately, such as a prescribed
    pressure, still lags by h/2. Raises ValueError for a file that is no FMU, an unknown start value or input or times
    that are not positive, and FMUError with the FMU's own sentence when a call fails: a run either reaches its stop
    time or raises.
    """
    inputs = inputs or {}
    time = _communication_points(stop_time, step)
    description = read_description(fmu)
    variables = {variable.name: variable for variable in description.modelVariables}
    drive = drive_of(variables, fmu)
    if drive in inputs:
        raise InputError(f"{drive}: it is an input of its own; give it as inflow.")
    check_inputs(inputs, variables, fmu)
    own = {"inlet.drive": "network"} if inflow is None and "inlet.drive" in variables else {}
    starts = _start_values({"inlet.interpolation": "linear", **own, **(start_values or {})}, variables, fmu)
    given = {} if inflow is None else {drive: inflow}
    if given and starts.get("inlet.drive") == _BY_NETWORK:
        raise InputError(f"{drive}: ignored with inlet.drive = network; leave one of them out.")
    driving = {name: _sampled("inflow", u, time) for name, u in given.items()}
    shown = driving | {name: _sampled(name, u, time) for name, u in inputs.items()}
    middle = 0.5 * (time[1:] + time[:-1])
    columns = [  # linear between communication points, if it drives an inlet
        shown[n][1:] if n.endswith(("inlet.Q", "inlet.P")) else _sampled(n, u, middle)
        for n, u in {**given, **inputs}.items()
    ]
    samples = np.column_stack([np.empty((len(middle), 0)), *columns])
    driven = [variables[name].valueReference for name in shown]
    outputs = {v.name: v.valueReference for v in variables.values() if v.causality == "output" and not is_port(v.name)}
    # the FMU shares this Python, and would treat Ctrl-C within a call as its own error
    with interrupts_later() as due, _instantiated(fmu, description) as slave:
        _initialize(slave, variables, starts, driven, [values[0] for values in shown.values()])
        table = _steps(slave, time, driven, samples, list(outputs.values()), progress, due)
        slave.terminate()
    return {"time": time, **shown, **{name: table[:, i].copy() for i, name in enumerate(outputs)}}


def _communication_points(stop_time: float, step: float) -> Array:
    """Times 0, step, … stop_time : (n + 1,) [s]. Raises ValueError unless both are positive."""
    for name, value in (("stop_time", stop_time), ("step", step)):
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{name} = {value!r} s: must be a positive, finite number.")
    n = max(1, math.ceil(stop_time / step - 1e-9))
    return np.minimum(np.arange(n + 1) * step, stop_time)


def _sampled(name: str, u: Input, time: Array) -> Array:
    values = np.asarray(u(time), float)
    if values.shape != time.shape:
        raise InputError(
            f"{name}: for {time.size} times it gave shape {values.shape}; it must give one value per time."
        )
    return values


def drive_of(variables: Mapping[str, Any], fmu: str | os.PathLike[str]) -> str:
    """The driving variable: inlet.Q, or inlet.P if that is an input. Raises ValueError without an inlet."""
    if "inlet.Q" not in variables:
        raise InputError(
            f"{os.fspath(fmu)}: it has no inlet, so it is no FMU of arteries and is not run alone; give one of "
            "arteries, or run a heart or body in the system of arterial-fmu build system, in a "
            "simulator that reads SSP."
        )
    pressure = variables.get("inlet.P")
    return "inlet.P" if pressure is not None and pressure.causality == "input" else "inlet.Q"


def check_inputs(names: Iterable[str], variables: Mapping[str, Any], fmu: str | os.PathLike[str]) -> None:
    known = [name for name, variable in variables.items() if variable.causality == "input"]
    for name in names:
        if name not in known:
            raise InputError(f"{name}: not an input of {os.fspath(fmu)}; use one of {', '.join(known)}.")


def read_description(fmu: str | os.PathLike[str]) -> ModelDescription:
    try:
        return fmpy.read_model_description(os.fspath(fmu))
    except OSError as error:
        raise InputError(
            f"{os.fspath(fmu)}: cannot be read ({error.strerror or 'not a file'}); check the path."
        ) from None
    except (zipfile.BadZipFile, KeyError):
        reason = "not an FMU; build one with arterial-fmu build"
        if _is_system(fmu):
            reason = (
                "a system of FMUs (SSP); run it in a simulator that reads SSP, or unpack it: its FMUs are in resources/"
            )
        raise InputError(f"{os.fspath(fmu)}: {reason}.") from None


def _is_system(path: str | os.PathLike[str]) -> bool:
    """Whether a file is a system of FMUs (SSP)."""
    try:
        with zipfile.ZipFile(path) as file:
            return "SystemStructure.ssd" in file.namelist()
    except zipfile.BadZipFile:
        return False


def _start_values(
    starts: Mapping[str, Any], variables: Mapping[str, Any], fmu: str | os.PathLike[str]
) -> dict[str, float | int]:
    """The start values for the FMU: numbers; for an Enumeration the number of its item.

    Raises ValueError for an unknown name or a wrong type.
    """
    result: dict[str, float | int] = {}
    for name, value in starts.items():
        if name not in variables:
            raise InputError(
                f"{name}: {os.fspath(fmu)} has no such variable; see its modelDescription.xml"
                f"{did_you_mean(name, variables)}."
            )
        if variables[name].type == "Enumeration":
            items = {item.name: int(item.value) for item in variables[name].declaredType.items}
            if value not in items and value not in items.values():
                raise InputError(f"{name} = {value!r}: must be one of {', '.join(items)}.")
            result[name] = items[value] if isinstance(value, str) else int(value)
        elif isinstance(value, str):
            raise InputError(f"{name} = {value!r}: must be a number.")
        else:
            result[name] = float(value)
    return result


@contextmanager
def _instantiated(fmu: str | os.PathLike[str], description: ModelDescription) -> Iterator[Slave]:
    """An instance of the FMU, freed at the end. A failed call raises FMUError with the FMU's log message."""
    messages: list[str] = []

    def log(status: int, message: bytes) -> None:
        if status > fmi2Warning:
            messages.append(_sentence(message.decode("utf-8", "replace")))

    def failed(error: Exception) -> FMUError:
        return FMUError(f"{os.fspath(fmu)}: {' '.join(messages) or error}")

    with unpacking_folder("fmu_") as folder:
        _unpack(fmu, folder)
        try:
            slave = instance(folder, description, log)
        except Exception as error:  # FMPy has no exception of its own for this
            raise failed(error) from None
        try:
            yield slave
        except FMICallException as error:
            raise failed(error) from None
        finally:
            slave.freeInstance()


def _unpack(fmu: str | os.PathLike[str], folder: str) -> None:
    try:
        fmpy.extract(os.fspath(fmu), folder)
    except (zipfile.BadZipFile, zlib.error, EOFError):
        raise InputError(
            f"{os.fspath(fmu)}: is damaged; copy it once more, or build it with arterial-fmu build."
        ) from None
    except OSError as error:
        raise InputError(
            f"{os.fspath(fmu)}: cannot be unpacked to {folder} ({error.strerror}); set TMPDIR to a folder with room."
        ) from None


def _initialize(
    slave: Slave,
    variables: dict[str, Any],
    starts: Mapping[str, float | int],
    driven: list[int],
    first: list[float],
) -> None:
    slave.setupExperiment(startTime=0.0)
    for name, value in starts.items():
        put = slave.setInteger if variables[name].type == "Enumeration" else slave.setReal
        put([variables[name].valueReference], [value])
    slave.setReal(driven, first)
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def _steps(
    slave: Slave,
    time: Array,
    driven: list[int],
    samples: Array,
    outputs: list[int],
    progress: Callable[[float], None] | None,
    due: Callable[[], None],
) -> Array:
    """The outputs at all times : (n + 1, n_outputs), with constant inputs : (n, n_inputs) in each of the n steps.

    due : raises a pending interrupt after a step.
    """
    table = np.empty((len(time), len(outputs)))
    table[0] = slave.getReal(outputs)
    for i, values in enumerate(samples.tolist()):
        slave.setReal(driven, values)
        slave.doStep(time[i], time[i + 1] - time[i])
        table[i + 1] = slave.getReal(outputs)
        due()
        if progress:
            progress((i + 1) / len(samples))
    return table


def _sentence(message: str) -> str:
    """The message of the slave, without the text that the wrapper adds: "Fatal py exception …\nValueError('…')"."""
    match = re.fullmatch(r"Fatal py exception.*?\n\w+\((.*)\)", message, flags=re.DOTALL)
    return str(ast.literal_eval(match[1])) if match else message


# --- instances, with the same calls for both versions of FMI ---------------------------------------------------------


class Slave3:
    """An instance for FMI 3.0 under the names that FMPy gives the calls of FMI 2.0."""

    def __init__(self, slave: FMU3Slave) -> None:
        self._slave = slave
        self.setReal, self.getReal, self.setInteger = slave.setFloat64, slave.getFloat64, slave.setInt64
        self.exitInitializationMode, self.terminate = slave.exitInitializationMode, slave.terminate
        self.doStep, self.freeInstance = slave.doStep, slave.freeInstance
        self._start = 0.0

    def setupExperiment(self, startTime: float) -> None:
        """Keep the start time [s], which FMI 3.0 takes with the next call."""
        self._start = startTime

    def enterInitializationMode(self) -> None:
        self._slave.enterInitializationMode(startTime=self._start)


Slave: TypeAlias = FMU2Slave | Slave3


def instance(folder: str, description: ModelDescription, log: Callable[[int, bytes], None]) -> Slave:
    """The FMU that was unpacked to folder, as a co-simulation slave; log : called with status and text of its messages.

    Raises FMPy's exception without an instance.
    """

    def logger(*said: Any) -> None:  # (environment, status, category, text); FMI 2.0 gives the instance's name, too
        status, _category, text = said[-3:]
        log(status, text)

    slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation", logger=logger, debug_logging=True)
    return Slave3(slave) if description.fmiVersion.startswith("3") else slave
