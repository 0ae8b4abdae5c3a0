"""Run an FMU with the compiled engine in this process, through FMPy: it has no code that a process would keep.

Its steps take some 30 µs, so that a new process, and files for inputs and results, would take most of the time.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Warning
from fmpy.model_description import ScalarVariable

Array = np.ndarray


class FMUFailed(RuntimeError):
    """A failed call; the message is the FMU's sentence."""


def stepped(
    path: str | os.PathLike[str],
    starts: Mapping[str, float | str],
    first: Mapping[str, float],
    driver: str,
    drives: Sequence[float],
    h: float,
    outputs: Sequence[str],
) -> Array:
    """Outputs at times 0, h, … n h : (n + 1, n_outputs) [SI] of an FMU for FMI 2.0.

    starts : start values, for an Enumeration the name of an item. first : inputs at time 0. driver, drives : an input
    and its value (n,) during each step; the inflow is interpolated, so its value is that of the step's end.
    Raises FMUFailed if a call fails.
    """
    description = fmpy.read_model_description(os.fspath(path))
    variables = {variable.name: variable for variable in description.modelVariables}
    messages: list[str] = []

    def log(_environment: Any, _name: bytes, status: int, _category: bytes, text: bytes) -> None:
        if status > fmi2Warning:
            messages.append(text.decode("utf-8", "replace"))

    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        fmpy.extract(os.fspath(path), folder)
        slave = None
        try:
            slave = fmpy.instantiate_fmu(folder, description, "CoSimulation", logger=log, debug_logging=True)
            slave.setupExperiment(startTime=0.0)
            for name, value in starts.items():
                _put(slave, variables[name], value)
            slave.setReal([variables[name].valueReference for name in first], list(first.values()))
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            return _steps(slave, variables[driver], drives, h, [variables[name].valueReference for name in outputs])
        except FMICallException as error:
            raise FMUFailed(f"{Path(path).name}: {' '.join(messages) or error}") from None
        finally:
            if slave is not None:
                slave.freeInstance()


def _put(slave: Any, variable: ScalarVariable, value: float | str) -> None:
    if variable.type == "Enumeration":
        (number,) = (int(item.value) for item in variable.declaredType.items if item.name == value)
        slave.setInteger([variable.valueReference], [number])
    else:
        slave.setReal([variable.valueReference], [float(value)])


def _steps(slave: Any, driver: ScalarVariable, drives: Sequence[float], h: float, outputs: Sequence[int]) -> Array:
    table = np.empty((len(drives) + 1, len(outputs)))
    table[0] = slave.getReal(outputs)
    for i, value in enumerate(drives):
        slave.setReal([driver.valueReference], [value])
        slave.doStep(i * h, h)
        table[i + 1] = slave.getReal(outputs)
    slave.terminate()
    return table
