"""Where simulation and measurement disagree: find it, name the missing effect, add it, show that the gap shrinks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import fitting as fitting  # which finds modules by their former names, too

if TYPE_CHECKING:
    from .workflow import discover

__all__ = ["discover"]


def __getattr__(name: str) -> Any:
    if name == "discover":
        from .workflow import discover  # solver, fits and FMPy take a second

        return discover
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
