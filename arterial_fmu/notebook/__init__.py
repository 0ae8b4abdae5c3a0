"""The door for notebooks: the displays of results as HTML, data frames and figures, registered by class."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any, cast

from solver import displays

from .frames import pandas as pandas
from .frames import polars as polars

DISPLAYS = {
    "solver.network.description.Network": "arterial_fmu.notebook.network",
    "solver.waveforms.Waveforms": "arterial_fmu.notebook.waveforms",
    "fitting.wall.wall_fit.WallFit": "arterial_fmu.notebook.wall",
    "discrepancy.findings.outcome.Outcome": "arterial_fmu.notebook.study",
}


def display(result: Any) -> ModuleType:
    """The module that displays a result, by its class or the nearest base. Raises TypeError if there is none."""
    for kind in type(result).__mro__:
        module = DISPLAYS.get(f"{kind.__module__}.{kind.__qualname__}")
        if module is not None:
            return import_module(module)
    raise TypeError(f"{type(result).__name__}: has no display; arterial_fmu.notebook.DISPLAYS lists those that have.")


displays.register(cast(displays.Door, sys.modules[__name__]))
