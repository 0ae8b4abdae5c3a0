"""Find where model and record disagree."""

from typing import Any


def __getattr__(name: str) -> Any:
    from solver.former_names import former  # this package has the name of a former module

    return former(__name__, name)
