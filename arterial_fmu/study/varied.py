"""The varied parameters of a study: ``CA.phi0=10..120kPa*s``, ``all.E=0.8..1.2x``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fitting.inference.unknown_text import named_parameters
from solver.errors import InputError
from solver.network.files import parse_quantity
from solver.quantities.quantity import Quantity
from solver.quantities.text import typed_unit

Array = np.ndarray

OPTION = "--vary"
_RANGE = re.compile(r"(.+?)\.\.(.+)")
_BARE = re.compile(r"[+-]?[0-9.]+(?:[eE][+-]?[0-9]+)?")
_FACTOR = re.compile(rf"({_BARE.pattern})\s*x?\s*\.\.\s*({_BARE.pattern})\s*x")


@dataclass(frozen=True)
class Varied:
    """Parameters that vary together from low to high [unit]: all take one value, or their own values times one factor.

    name : as given. nominal : value by parameter, in SI; the names are the FMU's.
    """

    name: str
    nominal: Mapping[str, float]
    low: float
    high: float
    unit: str
    factor: bool
    text: str

    def values(self, x: Array) -> dict[str, Array]:
        """x : (n,) in [low, high], as the values (n,) [SI] of every parameter."""
        return {name: x * value if self.factor else x for name, value in self.nominal.items()}


def parse_varied(
    texts: Iterable[str], known: Mapping[str, Quantity], nominal: Mapping[str, float], model: str
) -> tuple[Varied, ...]:
    """The varied parameters from texts NAME=LOW..HIGH with a unit, or with x for factors of the model's own values.

    NAME : as in :func:`fitting.inference.unknown_text.named_parameters`.
    known, nominal : the parameters of the model, their quantities and values [SI].
    Raises ValueError, one sentence that begins with the option, for an unknown name or an invalid range.
    """
    found = tuple(_parse(text, known, nominal, model) for text in texts)
    if not found:
        raise InputError(
            f'{OPTION}: nothing is varied; name at least one parameter, such as {OPTION} "all.E=0.8..1.2x".'
        )
    moved: dict[str, str] = {}
    for each in found:
        for name in each.nominal:
            if name in moved:
                raise InputError(f"{OPTION} {each.name}: {name} is varied by {moved[name]}, too; keep one of them.")
            moved[name] = each.name
    return found


def _parse(text: str, known: Mapping[str, Quantity], nominal: Mapping[str, float], model: str) -> Varied:
    name, equals, span = (part.strip() for part in text.partition("="))
    if not equals or not _RANGE.fullmatch(span):
        raise InputError(
            f'{OPTION} {text}: must look like NAME=LOW..HIGH, for example "CA.phi0=10..120kPa*s" or "all.E=0.8..1.2x".'
        )
    option = f"{OPTION} {name}"
    names = named_parameters(name, option, known, model)
    unit, display = known[names[0]].unit, known[names[0]].display
    factors = _FACTOR.fullmatch(span)
    if factors:
        low, high = (parse_quantity(part, "1", option) for part in factors.groups())
    else:
        low, high = _ends(span, unit, option, display)
    if not low < high:
        raise InputError(f"{option}={span}: the range must begin with its lower end; give two values that differ.")
    found = Varied(name, {n: nominal[n] for n in names}, low, high, "1" if factors else unit, bool(factors), span)
    for end in (low, high):
        for each, value in found.values(np.array(end)).items():
            if factors and nominal[each] == 0.0:
                raise InputError(
                    f"{option}={span}: {each} is 0 in {model}, which no factor can change; give a range with its unit."
                )
            try:
                known[each].check(each, float(value))
            except InputError as error:
                raise InputError(f"{option}={span}: {error}") from None
    return found


def _ends(span: str, unit: str, option: str, display: str | None) -> tuple[float, float]:
    """The two ends of a range [unit]; if the first has no unit, that of the second applies to both."""
    match = _RANGE.fullmatch(span)
    assert match is not None
    first, last = (part.strip() for part in match.groups())
    if _BARE.fullmatch(first):
        first += " " + _BARE.sub("", last, count=1).strip()
    if unit not in ("1", "s") and _BARE.fullmatch(last):
        proposed = f'"{span}{typed_unit(unit, display)}"'
        raise InputError(f"{option}={span}: it has no unit; write one, such as {proposed}, or x for factors.")
    return parse_quantity(first.strip(), unit, option), parse_quantity(last, unit, option)
