"""The check of a parameter set: the FMU against the record."""

from typing import Any


def __getattr__(name: str) -> Any:
    from solver.former_names import former  # this package has the name of a former module

    return former(__name__, name)
