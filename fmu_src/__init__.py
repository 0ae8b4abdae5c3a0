"""The FMI side: variable table, co-simulation, slave, modelDescription and documents; a driver that runs an FMU."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

__version__ = "0.2.0"


def _former(name: str, path: Any = None, target: Any = None) -> Any:
    """The spec of a module of this package by its former name."""
    if name.startswith("fmu_src."):
        from solver.former_names import FINDER  # takes half a second

        return FINDER.find_spec(name)
    return None


sys.meta_path.append(SimpleNamespace(find_spec=_former))
