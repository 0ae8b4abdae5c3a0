"""Quantities: dataclass fields that carry a unit, an allowed range and a description."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from ..errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Quantity:
    """The definition of a number: unit, allowed range, and display in tools.

    unit, display : SI unit and display unit (spelled as in pint and FMI).
    low, high : allowed range, both ends included unless ``open_low``.
    nominal : typical magnitude, for the FMU's ``nominal`` attribute.
    whole : whether it must be a whole number.
    tunable : whether it may change while a simulation runs (wall and outlets) or not (geometry).
    input : whether another model may drive it: an FMU input instead of a parameter.

    For inference: spread : standard deviation between animals, of its logarithm, or of its value if that may be
    negative (of its ratio, if it has one). refit : the fits that adjust it, by one common factor or shift: "network",
    "wall".
    individual : the same deviation between the arteries or outlets of one animal, about their common value (0: no
    individual deviation). ratio_to : the key that it is expressed relative to; the ratio stays constant when that key
    changes.
    """

    unit: str
    description: str
    low: float
    high: float
    nominal: float = 1.0
    display: str | None = None
    open_low: bool = False
    whole: bool = False
    tunable: bool = True
    input: bool = False
    spread: float = 0.3
    refit: tuple[str, ...] = ()
    individual: float = 0.0
    ratio_to: str | None = None

    def check(self, name: str, value: float) -> None:
        """Raise ValueError with one sentence unless ``value`` is a number inside the allowed range."""
        if not isinstance(value, (int, float, np.floating, np.integer)) or isinstance(value, bool):
            raise InputError(f"{name} = {value!r}: must be a number{self.in_unit}.")
        try:
            value = float(value)
        except OverflowError:  # an integer beyond the largest double
            value = math.inf
        below = value <= self.low if self.open_low else value < self.low
        if not math.isfinite(value) or below or value > self.high:
            bracket = "(" if self.open_low else "["
            raise InputError(
                f"{name} = {value:g} {self.unit_text} is not allowed: {self.description} must lie in "
                f"{bracket}{self.low:g}, {self.high:g}] {self.unit_text}; check the value and its unit."
            )
        if self.whole and not value.is_integer():
            raise InputError(f"{name} = {value:g} is not allowed: {self.description} must be a whole number.")

    @property
    def in_unit(self) -> str:
        """The words after "a number" in a sentence."""
        return f" in {self.unit}" if self.unit != "1" else ""

    @property
    def unit_text(self) -> str:
        return self.unit if self.unit != "1" else "(no unit)"


def quantity(default: float | None, unit: str, description: str, low: float, high: float, **more: Any) -> Any:
    """A dataclass field that carries a :class:`Quantity`; ``default`` None means the value must be given."""
    metadata = {"quantity": Quantity(unit, description, low, high, **more)}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


def quantities(owner: Any) -> dict[str, Quantity]:
    """The quantities of a dataclass or of one of its instances, by field name."""
    return dict(_quantities(owner if isinstance(owner, type) else type(owner)))


@cache
def _quantities(kind: Any) -> dict[str, Quantity]:
    return {f.name: f.metadata["quantity"] for f in fields(kind) if "quantity" in f.metadata}


def with_values(group: str, owner: T, values: Mapping[str, Any]) -> T:
    """The dataclass with the quantities in ``values``, which has the names of variables: "heart.rate"."""
    names = {key: f"{group}.{key}" for key in quantities(owner)}
    return replace(owner, **{key: values[name] for key, name in names.items() if name in values})  # type: ignore[type-var]
