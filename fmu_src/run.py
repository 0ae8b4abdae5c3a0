"""Run an FMU of this project through fmpy, with the inflow known in advance."""

from __future__ import annotations

import ast
import math
import os
import re
import zipfile
from collections.abc import Callable, Mapping
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2Warning
from fmpy.model_description import ModelDescription

Array = np.ndarray


class FMUError(RuntimeError):
    """A call of the FMU failed; the message is what the FMU logged."""


def run_fmu(
    fmu: str | os.PathLike[str],
    inflow: Callable[[Array], Array],
    stop_time: float,
    *,
    step: float = 1e-3,
    start_values: Mapping[str, float | str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Array]:
    """Step an FMU from 0 to ``stop_time`` [s] and return "time", "inlet.Q" and every output, each (n,) in SI.

    inflow : Q(t) [m³/s] for an array of times. inlet.interpolation is ``linear`` and inlet.Q is set to Q(t + h) before
    the step from t, so the inflow is piecewise linear through the samples, without the half-step delay of a held input.
    step : communication step [s]; the last one is shorter if the stop time asks for it.
    start_values : parameters by FMU variable name.
    Raises ValueError for a file that is no FMU, an unknown start value or times that are not positive, and FMUError
    with the FMU's own sentence when a call fails: a run either reaches its stop time or raises.
    """
    for name, value in (("stop_time", stop_time), ("step", step)):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value!r} s: must be a positive, finite number.")
    n = max(1, math.ceil(stop_time / step - 1e-9))
    time = np.minimum(np.arange(n + 1) * step, stop_time)
    Q = np.asarray(inflow(time), float)
    if Q.shape != time.shape:
        raise ValueError(f"inflow: for {time.size} times it gave shape {Q.shape}; it must give one value per time.")
    description = _read(fmu)
    variables = {variable.name: variable for variable in description.modelVariables}
    starts = _start_values({"inlet.interpolation": "linear", **(start_values or {})}, variables, fmu)
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    references = [v.valueReference for v in outputs]
    inlet = [variables["inlet.Q"].valueReference]
    messages: list[str] = []

    def log(_environment: Any, _instance: bytes, status: int, _category: bytes, message: bytes) -> None:
        if status > fmi2Warning:
            messages.append(_sentence(message.decode("utf-8", "replace")))

    table = np.empty((n + 1, len(outputs)))
    with TemporaryDirectory(prefix="fmu_", ignore_cleanup_errors=True) as folder:
        fmpy.extract(os.fspath(fmu), folder)
        try:
            slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation", logger=log, debug_logging=True)
        except Exception as error:  # FMPy has no exception of its own for this
            raise FMUError(f"{os.fspath(fmu)}: {' '.join(messages) or error}") from None
        try:
            _initialize(slave, variables, starts, inlet, Q[0])
            table[0] = slave.getReal(references)
            for i in range(n):
                slave.setReal(inlet, [Q[i + 1]])
                slave.doStep(time[i], time[i + 1] - time[i])
                table[i + 1] = slave.getReal(references)
                if progress:
                    progress((i + 1) / n)
            slave.terminate()
        except FMICallException as error:
            raise FMUError(f"{os.fspath(fmu)}: {' '.join(messages) or error}") from None
        finally:
            slave.freeInstance()
    values = {v.name: table[:, i].copy() for i, v in enumerate(outputs)}
    return {"time": time, "inlet.Q": Q, **values}


def _read(fmu: str | os.PathLike[str]) -> ModelDescription:
    try:
        return fmpy.read_model_description(os.fspath(fmu))
    except OSError as error:
        raise ValueError(
            f"{os.fspath(fmu)}: cannot be read ({error.strerror or 'not a file'}); check the path."
        ) from None
    except (zipfile.BadZipFile, KeyError):
        raise ValueError(f"{os.fspath(fmu)}: not an FMU; build one with build_fmu.py.") from None


def _start_values(
    starts: Mapping[str, Any], variables: Mapping[str, Any], fmu: str | os.PathLike[str]
) -> dict[str, float | str]:
    """The start values with the type of their variable. Raises ValueError for an unknown name or a wrong type."""
    result: dict[str, float | str] = {}
    for name, value in starts.items():
        if name not in variables:
            raise ValueError(
                f"{name}: {os.fspath(fmu)} has no such variable; see its modelDescription.xml for the names."
            )
        text = variables[name].type == "String"
        if isinstance(value, str) != text:
            raise ValueError(f"{name} = {value!r}: must be {'a text' if text else 'a number'}.")
        result[name] = value if text else float(value)
    return result


def _initialize(
    slave: FMU2Slave, variables: dict[str, Any], starts: Mapping[str, float | str], inlet: list[int], Q: float
) -> None:
    slave.setupExperiment(startTime=0.0)
    for name, value in starts.items():
        reference = [variables[name].valueReference]
        if isinstance(value, str):
            slave.setString(reference, [value])
        else:
            slave.setReal(reference, [value])
    slave.setReal(inlet, [Q])
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def _sentence(message: str) -> str:
    """What the slave said, without what the wrapper wraps around it: "Fatal py exception …\nValueError('…')"."""
    match = re.fullmatch(r"Fatal py exception.*?\n\w+\((.*)\)", message, flags=re.DOTALL)
    return str(ast.literal_eval(match[1])) if match else message
