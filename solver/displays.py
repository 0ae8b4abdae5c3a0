"""Displays of results in notebooks: a result asks the door for its display."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def door() -> Any:
    """The package with the displays: ``display(result)``, the module with ``html(result)``, ``columns(result)`` and
    ``figure(result, …)`` of the result's class; ``polars(columns)`` and ``pandas(columns)``, data frames of columns."""
    return import_module("arterial_fmu.notebook")  # when a result is first displayed


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
