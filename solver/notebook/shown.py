"""What all results have in common in a notebook."""

from __future__ import annotations

from typing import Any


class Shown:
    """A result that shows itself in a notebook, by a module of its own.

    The module has ``html(result)`` and ``columns(result)``, arrays or lists by heading; it is imported when asked.
    """

    @property
    def _page(self) -> Any:
        """The module."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return str(self._page.html(self))

    def to_polars(self) -> Any:
        """A polars.DataFrame; the class says of what."""
        from . import frames

        return frames.polars(self._page.columns(self))

    def to_pandas(self) -> Any:
        """The pandas.DataFrame of the columns of :meth:`to_polars`. Raises ImportError where pandas is missing."""
        from . import frames

        return frames.pandas(self._page.columns(self))
