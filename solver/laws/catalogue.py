"""The catalogue of effects as a whole: the terms of an owner, the measurement chain, the table of the docs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import InputError
from ..quantities.quantity import Quantity, quantities
from . import effects
from .effect import Array, Described, Effect, check_known
from .sensors import Known, KnownDelay, KnownZero, Sensor

(ZERO,) = KnownZero.terms  # its key
(DELAY,) = KnownDelay.terms

# --- terms of an owner --------------------------------------------------------------------------------------------


def terms_of(owner: str) -> dict[str, Quantity]:
    """The possible terms of a kind of owner, by key, in the order of the catalogue."""
    return dict(_terms(owner, effects.ALL))


@lru_cache(maxsize=32)
def _terms(owner: str, catalogue: tuple[Effect, ...]) -> Mapping[str, Quantity]:
    return {key: q for e in catalogue if e.owner == owner and not e.always for key, q in e.terms.items()}


def quantities_of(owner: Any) -> dict[str, Quantity]:
    """The quantities of an object of the network: its fields and its terms."""
    terms = getattr(owner, "terms", {})
    known = _terms(owner.OWNER, effects.ALL) if terms else {}
    return quantities(owner) | {key: q for key, q in known.items() if key in terms}


def value_of(owner: Any, key: str) -> float:
    """The number behind a key of :func:`quantities_of`."""
    terms = getattr(owner, "terms", {})
    return terms[key] if key in terms else getattr(owner, key)


def neutral_value(key: str, variable: str = "") -> float:
    """The value of a term that switches it off. Raises ValueError if no effect has such a term."""
    for effect in effects.ALL:
        if key in effect.neutral:
            return effect.neutral[key]
    raise InputError(f"{variable or key}: no parameter of the network and no term of the catalogue.")


# --- the measurement chain as a whole -----------------------------------------------------------------------------


def observe(terms: Mapping[str, Any], X: Array, omega: Array) -> Array:
    """The record of a periodic signal by a channel with these terms.

    The sensors of the catalogue act in sequence, in its order. X : (..., n) complex Fourier coefficients of
    e^{iωt} at omega : (n,) [rad/s], the mean where ω = 0.
    The terms are numbers, or arrays that broadcast against X. Returns X's shape. Raises ValueError for an unknown term.
    """
    check_known("channel", terms, terms_of("channel"))
    X, omega = np.asarray(X), np.asarray(omega, float)
    for effect in effects.ALL:
        if isinstance(effect, Sensor) and any(key in terms for key in effect.terms):
            X = effect.observe(dict(effect.neutral) | dict(terms), X, omega)
    return X


def filtered(network: Described, channel: str, omega: Array) -> Array:
    """H : (n,) of the known filters of a channel in a network, at omega : (n,) [rad/s].

    Known filters are the sensors of the catalogue that no search has as candidates; all other terms of a channel are
    results of one.
    """
    H = np.ones(np.shape(omega), complex)
    for effect, values in _known_sensors(network, channel):
        H = H * effect.transfer(values, omega)
    return H


def zero_of(network: Described, channel: str) -> float:
    """The known zero of a channel in a network, in SI; 0 if it has none."""
    return float(sum(effect.offset(values) for effect, values in _known_sensors(network, channel)))


def _known_sensors(network: Described, channel: str) -> Iterator[tuple[Known, dict[str, Array]]]:
    for own in (c for c in network.channels if c.name == channel):
        for effect in effects.ALL:
            if isinstance(effect, Known):
                yield effect, {key: np.asarray(value) for key, value in {**effect.neutral, **own.terms}.items()}


# --- documentation ------------------------------------------------------------------------------------------------


def table() -> str:
    """The catalogue as a Markdown table, for docs/effects.md."""
    rows = ["| Effect | Equation | Key [unit], range, off | Where | Signature | Confused with | Told apart by |"]
    rows += ["|---|---|---|---|---|---|---|"]
    for e in effects.ALL:
        keys = "; ".join(_documented(key, q, e.neutral.get(key)) for key, q in e.terms.items())
        rivals = ", ".join(f"`{name}`" for name in e.confusable)
        cells = (f"`{e.name}`", e.equation, keys, ", ".join(e.places), e.signature, rivals, e.separator)
        rows.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join(rows)


def _documented(key: str, q: Quantity, neutral: float | None) -> str:
    unit = {"1": "–", "signal": "its signal's"}.get(q.unit, q.unit)
    off = "" if neutral is None else f", {neutral:g}"
    return f"`{key}` [{unit}] {q.low:g} to {q.high:g}{off}"
