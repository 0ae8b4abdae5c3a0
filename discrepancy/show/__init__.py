"""Show that the gap shrinks: free runs of the FMU."""

from typing import Any


def __getattr__(name: str) -> Any:
    from solver.former_names import former  # this package has the name of a former module

    return former(__name__, name)
