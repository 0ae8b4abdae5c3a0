"""Networks: description and validation, files, and the coefficients of the equations."""

from typing import Any


def __getattr__(name: str) -> Any:
    from ..former_names import former  # this package has the name of a former module

    return former(__name__, name)
