"""The door for notebooks: the displays of results as HTML, data frames and figures, by class (`solver/displays.py`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

Columns = Mapping[str, np.ndarray | Sequence[Any]]

DISPLAYS = {
    "solver.network.description.Network": "fitting.pages.network_drawing",
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


def polars(columns: Columns) -> Any:
    """A polars.DataFrame."""
    import polars

    return polars.DataFrame(dict(columns))


def pandas(columns: Columns) -> Any:
    """A pandas.DataFrame. Raises ImportError where pandas is not installed."""
    try:
        import pandas
    except ImportError:
        raise ImportError("pandas is not installed: pip install pandas, or take to_polars() instead.") from None
    return pandas.DataFrame(dict(columns))
