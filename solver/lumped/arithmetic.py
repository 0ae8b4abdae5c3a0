"""What the step of a heart or a body is written with: functions of single numbers.

A number is a float, or one that is only being recorded for the compiled engine (:mod:`~solver.tracing.arithmetic`).
Code that takes its decisions with :func:`select`, :func:`require` and :func:`repeated`, not with ``if`` and ``while``,
serves both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from ..errors import InputError

Number = Any  # a float, a truth value, or one of these that is being recorded
State = TypeVar("State", bound=tuple[Any, ...])


def _known(x: Number) -> bool:
    return isinstance(x, (bool, int, float, np.bool_))


def select(condition: Number, yes: Number, no: Number) -> Number:
    """One of two numbers; both have been computed."""
    if condition is True:  # the usual cases first: a step asks a hundred times
        return yes
    if condition is False:
        return no
    return (yes if condition else no) if _known(condition) else np.where(condition, yes, no)


def negated(condition: Number) -> Number:
    """Whether it is false."""
    return select(condition, False, True)


def divided(x: Number, y: Number, otherwise: Number) -> Number:
    """x / y, and another number where y is 0."""
    if type(y) is float or _known(y):
        return x / y if y else otherwise
    return np.where(y != 0.0, x / y, otherwise)


def positive(x: Number) -> Number:
    """x where it is positive, else 0."""
    if type(x) is float or _known(x):
        return x if x > 0.0 else 0.0
    return np.maximum(x, 0.0)


def larger(x: Number, y: Number) -> Number:
    """The larger of two numbers."""
    return select(x > y, x, y)


def is_finite(x: Number) -> Number:
    """Whether x is neither infinite nor NaN."""
    return math.isfinite(x) if type(x) is float else np.isfinite(x)


def exp(x: Number) -> Number:
    return math.exp(x) if type(x) is float else np.exp(x)


def expm1(x: Number) -> Number:
    return math.expm1(x) if type(x) is float else np.expm1(x)


def cos(x: Number) -> Number:
    return math.cos(x) if type(x) is float else np.cos(x)


def sqrt(x: Number) -> Number:
    return math.sqrt(x) if type(x) is float else np.sqrt(x)


def require(condition: Number, sentence: str, *numbers: Number) -> None:
    """Raise ValueError with a sentence unless a condition holds. %g in the sentence stands for the next number."""
    if not _known(condition):
        condition.recorder.require_or_say(condition, sentence, numbers)
    elif not condition:
        raise InputError(sentence % numbers)


def solution(found: State, correction: Callable[..., State]) -> State:
    """The x that a search has found for F(x, p) = 0. Recorded derivatives are those of the solution,
    dx/dp = -F_x⁻¹ F_p, and not of the search.

    correction : -F_x⁻¹ F, by Newton's method; it vanishes at the solution, where x + correction has this derivative.
    """
    return found if _known(found[0]) else found[0].recorder.solution(found, correction)


def repeated(body: Callable[[State], State], state: State) -> State:
    """The state, a tuple of numbers and such tuples, after ``body`` has been applied to it as long as its first number
    is true."""
    if not _known(state[0]):
        return state[0].recorder.repeated(body, state)
    while state[0]:
        state = body(state)
    return state
