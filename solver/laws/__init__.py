"""Each kind of wall, outlet, effect and sensor is one class with all its facts."""

from typing import Any


def __getattr__(name: str) -> Any:
    from ..former_names import former  # this package has the name of a former module

    return former(__name__, name)
