"""Parameters by variable name into dataclasses of quantities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from ..quantities.quantity import quantities

T = TypeVar("T")


def with_values(group: str, owner: T, values: Mapping[str, Any]) -> T:
    """The dataclass with the quantities in ``values``, which uses the names of :func:`parameters`."""
    names = {key: f"{group}.{key}" for key in quantities(owner)}
    return replace(owner, **{key: values[name] for key, name in names.items() if name in values})  # type: ignore[type-var]
