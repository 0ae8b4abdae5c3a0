"""The software that made a result."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from solver.tracing.native import NoEngine, library


def software() -> str:
    """Name and version of this package, "arterial-fmu 0.1.0"."""
    try:
        return f"arterial-fmu {version('arterial-fmu')}"
    except PackageNotFoundError:
        return "arterial-fmu (not installed)"


def engine() -> str:
    """The backend of beats: "native", the compiled engine, or "numpy" with the reason."""
    try:
        library()
    except NoEngine as reason:
        return f"numpy: {reason}"
    return "native"
