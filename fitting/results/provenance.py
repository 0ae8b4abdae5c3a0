"""The software that made a result."""

from __future__ import annotations

from fmu_src import __version__
from solver.tracing.native import NoEngine, library


def software() -> str:
    """Name and version of this package, "arterial-fmu 0.2.0"."""
    return f"arterial-fmu {__version__}"


def engine() -> str:
    """The backend of beats: "native", the compiled engine, or "numpy" with the reason."""
    try:
        library()
    except NoEngine as reason:
        return f"numpy: {reason}"
    return "native"
