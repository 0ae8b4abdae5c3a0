"""The wall of one site: its law, its fit, and physiological indices of the vessel."""

from typing import Any


def __getattr__(name: str) -> Any:
    from solver.former_names import former  # this package has the name of a former module

    return former(__name__, name)
