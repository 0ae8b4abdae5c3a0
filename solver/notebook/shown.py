"""The common part of the display of results in notebooks."""

from __future__ import annotations

from typing import Any


class Shown:
    """A result with a display in notebooks, in its own module.

    The module has ``html(result)`` and ``columns(result)``, arrays or lists by heading; it is imported on first use.
    """

    @property
    def _page(self) -> Any:
        """The module."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return str(self._page.html(self))

    def to_polars(self) -> Any:
        """A polars.DataFrame; the class defines its columns."""
        from . import frames

        return frames.polars(self._page.columns(self))

    def to_pandas(self) -> Any:
        """The pandas.DataFrame of the columns of :meth:`to_polars`. Raises ImportError if pandas is missing."""
        from . import frames

        return frames.pandas(self._page.columns(self))
