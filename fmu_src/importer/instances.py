"""An instance of an FMU through FMPy, of FMI 2.0 or 3.0, with the same calls for both."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import ModelDescription


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
