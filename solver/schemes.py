"""The schemes by name: the functions and the settings of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from .errors import InputError
from .muscl.settings import MusclSettings
from .periodic import start
from .scheme import model, outputs, step
from .scheme.model import Settings
from .scheme.outputs import Reporter

AnySettings = Settings | MusclSettings


class Scheme(NamedTuple):
    """A scheme. Only its own functions accept its models, states and meshes."""

    settings: type[Any]
    build: Callable[..., Any]
    reporter: Callable[..., Reporter[Any]]
    initial_state: Callable[..., Any]
    periodic_state: Callable[..., Any]
    adopt: Callable[..., Any]
    step: Callable[..., Any]
    accelerates: bool = False  # whether its beats are extrapolated


def _staggered() -> Scheme:
    """The default."""
    return Scheme(
        Settings, model.build, outputs.reporter, step.initial_state, start.periodic_state, step.adopt, step.step, True
    )


def _muscl() -> Scheme:
    """The paper's, imported when it is first used."""
    from .muscl import model, sampling, start, step

    return Scheme(
        MusclSettings, model.build, sampling.reporter, step.initial_state, start.periodic_state, step.adopt, step.step
    )


SCHEMES = {"staggered": _staggered, "muscl": _muscl}


def scheme_of(name: str, settings: AnySettings | None) -> tuple[Scheme, AnySettings]:
    """The scheme of a name, and its settings; the defaults for None.

    Raises ValueError for an unknown name, or for settings of another scheme.
    """
    if name not in SCHEMES:
        raise InputError(f"scheme = {name!r}: must be {' or '.join(map(repr, SCHEMES))}.")
    scheme = SCHEMES[name]()
    settings = scheme.settings() if settings is None else settings
    if not isinstance(settings, scheme.settings):
        raise InputError(
            f"settings: scheme {name!r} takes {scheme.settings.__name__}, not {type(settings).__name__}; give these."
        )
    return scheme, settings
