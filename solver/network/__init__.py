"""What a network is: its description and validation, its file, and the coefficients of its equations."""

from typing import Any


def __getattr__(name: str) -> Any:
    from ..former_names import former  # this package has the name of a former module

    return former(__name__, name)
