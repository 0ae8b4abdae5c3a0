"""Columns as data frames, polars or pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Columns = Mapping[str, np.ndarray | Sequence[Any]]


def polars(columns: Columns) -> Any:
    """A polars.DataFrame."""
    import polars

    return polars.DataFrame(dict(columns))


def pandas(columns: Columns) -> Any:
    """A pandas.DataFrame. Raises ImportError where pandas is not installed."""
    try:
        import pandas
    except ImportError:
        raise ImportError("pandas is not installed: pip install pandas, or take to_polars() instead.") from None
    return pandas.DataFrame(dict(columns))
