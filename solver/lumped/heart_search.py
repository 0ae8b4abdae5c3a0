"""The flows through two valves that solve the equations of a step: Newton's method, then one valve after the other.

Both searches are loops without branches, one evaluation of the equations at a time, so that the compiled engine can
run them, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from .arithmetic import Number, is_finite, larger, negated, repeated, select

_ITERATIONS = 40
_HALVINGS = 80
_TOLERANCE, _LEAST = 1e-12, 1e-5  # of a flow; m³/s, a flow that this is a part of
_WIDTH = 1e-7  # m³/s, of the first bracket

Correction = Callable[[Number, Number], tuple[Number, Number, Number]]
Residuals = Callable[[Number, Number], tuple[Number, Number]]


def newton(correction: Correction, Q_m: Number, Q_a: Number) -> tuple[Number, Number, Number]:
    """Newton iterations with damped steps from the flows Q_m, Q_a [m³/s]: whether they converge, and the flows.

    correction : the change of two flows by Newton's method, and the size of the residuals there.
    """

    def part_of_it(s: _Newton) -> _Newton:
        """A part of a correction: taken if the residuals become smaller, else halved."""
        Q_m, Q_a = s.Q_m + s.part * s.dQ_m, s.Q_a + s.part * s.dQ_a
        dQ_m, dQ_a, size = correction(Q_m, Q_a)
        taken = (size <= (1.0 - 0.25 * s.part) * s.size + 1e-10) | (s.part < 1e-3)
        count = s.count + taken
        found = taken & (larger(abs(s.dQ_m), abs(s.dQ_a)) <= _within(Q_m, Q_a))
        goes_on = negated(found) & is_finite(dQ_m + dQ_a) & (count < _ITERATIONS)
        return _Newton(
            negated(taken) | goes_on, found, select(taken, Q_m, s.Q_m), select(taken, Q_a, s.Q_a),
            select(taken, dQ_m, s.dQ_m), select(taken, dQ_a, s.dQ_a),
            select(taken, 1.0, 0.5 * s.part), select(taken, size, s.size), count,
        )  # fmt: skip

    dQ_m, dQ_a, size = correction(Q_m, Q_a)
    end = repeated(part_of_it, _Newton(is_finite(dQ_m + dQ_a), False, Q_m, Q_a, dQ_m, dQ_a, 1.0, size, 0))
    return end.found, end.Q_m, end.Q_a


class _Newton(NamedTuple):
    """Flows, the correction there, which part of it is tried next; size of the residuals; corrections so far."""

    going: Number
    found: Number
    Q_m: Number
    Q_a: Number
    dQ_m: Number
    dQ_a: Number
    part: Number
    size: Number
    count: Number


def one_by_one(residuals: Residuals, Q_m: Number, Q_a: Number, found: Number = False) -> tuple[Number, Number, Number]:
    """One valve after the other, each by bisection, from the flows Q_m, Q_a [m³/s], unless these are ``found``: whether
    they converge, and the flows. Slow, but robust if a valve closes instantaneously.

    residuals : of both valves, each negative for low and positive for high flows through it.
    """

    def one_evaluation(s: _OneByOne) -> _OneByOne:
        b = s.bracket
        Q = b.next()
        F, G = residuals(select(s.aortic, s.Q_m, Q), select(s.aortic, Q, s.Q_a))
        b, ended = b.narrowed(Q, select(s.aortic, G, F))
        root = b.root()
        Q_m, Q_a = select(ended & negated(s.aortic), root, s.Q_m), select(ended & s.aortic, root, s.Q_a)
        both = ended & s.aortic
        rounds = s.rounds + both
        end = both & is_finite(F + G) & (abs(Q_m - s.before_m) + abs(Q_a - s.before_a) <= _within(Q_m, Q_a))
        anew = _begun(select(s.aortic, Q_m, Q_a))  # around the flow of the other valve
        return _OneByOne(
            negated(end) & (rounds < _ITERATIONS), end, s.aortic != ended, Q_m, Q_a,
            select(both, Q_m, s.before_m), select(both, Q_a, s.before_a), rounds,
            _Bracket(*(select(ended, one, other) for one, other in zip(anew, b, strict=True))),
        )  # fmt: skip

    first = _OneByOne(negated(found), found, False, Q_m, Q_a, Q_m, Q_a, 0, _begun(Q_m))
    last = repeated(one_evaluation, first)
    return last.found, last.Q_m, last.Q_a


class _Bracket(NamedTuple):
    """A root of an increasing function between two numbers, with the function at both.

    stage : 0 while a lower end is looked for, 1 a higher one, 2 while the bracket is halved.
    """

    stage: Number
    low: Number
    high: Number
    at_low: Number
    at_high: Number
    width: Number
    halvings: Number

    def next(self) -> Number:
        """Where the function is to be evaluated."""
        return select(self.stage == 0, self.low, select(self.stage == 1, self.high, 0.5 * (self.low + self.high)))

    def narrowed(self, x: Number, value: Number) -> tuple[_Bracket, Number]:
        """With the value there; and whether that was the last one."""
        wider = self.width < 1.0
        lower, higher = (self.stage == 0) & (value > 0.0) & wider, (self.stage == 1) & (value < 0.0) & wider
        inside = (self.stage == 2) & (self.low < x) & (x < self.high) & (self.halvings < _HALVINGS)
        down = inside & (value > 0.0)
        up = inside & negated(value > 0.0)
        ended = (self.stage == 2) & negated(inside)
        return _Bracket(
            stage=self.stage + negated(lower | higher | inside),
            low=select(lower, self.low - self.width, select(up, x, self.low)),
            high=select(higher, self.high + self.width, select(down, x, self.high)),
            at_low=select((self.stage == 0) | up, value, self.at_low),
            at_high=select((self.stage == 1) | down, value, self.at_high),
            width=select(lower | higher, 2.0 * self.width, self.width),
            halvings=self.halvings + inside,
        ), ended

    def root(self) -> Number:
        """The end where the function is smaller."""
        return select(abs(self.at_low) < abs(self.at_high), self.low, self.high)


class _OneByOne(NamedTuple):
    """Flows, those of the round before, and the bracket of the valve at hand."""

    going: Number
    found: Number
    aortic: Number
    Q_m: Number
    Q_a: Number
    before_m: Number
    before_a: Number
    rounds: Number
    bracket: _Bracket


def _begun(Q: Number) -> _Bracket:
    """A bracket around a guess [m³/s]."""
    return _Bracket(0, Q, Q, 0.0, 0.0, _WIDTH, 0)


def _within(Q_m: Number, Q_a: Number) -> Number:
    return _TOLERANCE * larger(larger(abs(Q_m), abs(Q_a)), _LEAST)
