"""Run an FMU of this project through fmpy, with the inflow known in advance."""

from __future__ import annotations

import ast
import os
import re
import shutil
from collections.abc import Callable, Mapping
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave, fmi2Warning

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
    start_values : parameters by FMU variable name.
    Raises ValueError for an unknown start value, and FMUError with the FMU's own sentence when a call fails: a run
    either reaches its stop time or raises.
    """
    n = max(1, round(stop_time / step))
    time = np.arange(n + 1) * step
    Q = np.asarray(inflow(time), float)
    description = fmpy.read_model_description(os.fspath(fmu))
    variables = {variable.name: variable for variable in description.modelVariables}
    starts = {"inlet.interpolation": "linear", **(start_values or {})}
    for name in starts:
        if name not in variables:
            raise ValueError(
                f"{name}: {os.fspath(fmu)} has no such variable; see its modelDescription.xml for the names."
            )
    outputs = [v for v in description.modelVariables if v.causality == "output"]
    references = [v.valueReference for v in outputs]
    inlet = [variables["inlet.Q"].valueReference]
    messages: list[str] = []

    def log(_environment: Any, _instance: bytes, status: int, _category: bytes, message: bytes) -> None:
        if status > fmi2Warning:
            messages.append(_sentence(message.decode("utf-8", "replace")))

    folder = fmpy.extract(os.fspath(fmu))
    slave = fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation", logger=log, debug_logging=True)
    table = np.empty((n + 1, len(outputs)))
    try:
        _initialize(slave, variables, starts, inlet, Q[0])
        table[0] = slave.getReal(references)
        for i in range(n):
            slave.setReal(inlet, [Q[i + 1]])
            slave.doStep(time[i], step)
            table[i + 1] = slave.getReal(references)
            if progress:
                progress((i + 1) / n)
        slave.terminate()
    except FMICallException as error:
        raise FMUError(f"{os.fspath(fmu)}: {' '.join(messages) or error}") from None
    finally:
        slave.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)
    values = {v.name: table[:, i].copy() for i, v in enumerate(outputs)}
    return {"time": time, "inlet.Q": Q, **values}


def _initialize(
    slave: FMU2Slave, variables: dict[str, Any], starts: Mapping[str, Any], inlet: list[int], Q: float
) -> None:
    slave.setupExperiment(startTime=0.0)
    for name, value in starts.items():
        variable = variables[name]
        if variable.type == "String":
            slave.setString([variable.valueReference], [value])
        else:
            slave.setReal([variable.valueReference], [float(value)])
    slave.setReal(inlet, [Q])
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def _sentence(message: str) -> str:
    """What the slave said, without what the wrapper wraps around it: "Fatal py exception …\nValueError('…')"."""
    match = re.fullmatch(r"Fatal py exception.*?\n\w+\((.*)\)", message, flags=re.DOTALL)
    return str(ast.literal_eval(match[1])) if match else message
