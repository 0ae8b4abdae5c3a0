"""Displays of results in notebooks: a result asks for its display, and the door that has registered itself gives it."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Protocol

DOOR = "arterial_fmu.notebook"  # registers itself; imported when a result is first displayed


class Door(Protocol):
    """The package with all displays."""

    def display(self, result: Any) -> Any:
        """The module with ``html(result)``, ``columns(result)`` and ``figure(result, …)`` of the result's class."""

    def polars(self, columns: Any) -> Any:
        """A polars.DataFrame of columns, arrays or lists by heading."""

    def pandas(self, columns: Any) -> Any:
        """A pandas.DataFrame of columns. Raises ImportError if pandas is missing."""


_registered: list[Door] = []


def register(door: Door) -> None:
    """Let results be displayed by this door."""
    _registered[:] = [door]


def door() -> Door:
    """The door that is registered. Raises ImportError if there is none."""
    if not _registered:
        import_module(DOOR)
    return _registered[0]


class Shown:
    """A result with a display in notebooks."""

    def _repr_html_(self) -> str:
        return str(door().display(self).html(self))

    def to_polars(self) -> Any:
        """A polars.DataFrame; the class defines its columns."""
        return door().polars(door().display(self).columns(self))

    def to_pandas(self) -> Any:
        """The pandas.DataFrame of the columns of :meth:`to_polars`. Raises ImportError if pandas is missing."""
        return door().pandas(door().display(self).columns(self))

    def _figure(self, *asked: Any) -> Any:
        """A figure, which a notebook displays."""
        return door().display(self).figure(self, *asked)
