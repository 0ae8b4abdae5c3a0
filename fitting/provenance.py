"""The software that made a result."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def software() -> str:
    """Name and version of this package, "arterial-fmu 0.1.0"."""
    try:
        return f"arterial-fmu {version('arterial-fmu')}"
    except PackageNotFoundError:
        return "arterial-fmu (not installed)"
