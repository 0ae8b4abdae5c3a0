"""A periodic curve through a table of times and values: what a network's inlet is driven by where it is no half-sine.

Cubic: the periodic spline with continuous second derivative, whose second derivatives M at the points solve

    h_{i-1} M_{i-1} + 2 (h_{i-1} + h_i) M_i + h_i M_{i+1} = 6 [(y_{i+1} - y_i)/h_i - (y_i - y_{i-1})/h_{i-1}]

with indices modulo the number of points (C. de Boor, A Practical Guide to Splines, ch. IV). Linear: straight pieces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

Array = np.ndarray

INTERPOLATIONS = ("cubic", "linear")
_MOST = 2000  # rows
_CLOSED = 1e-6  # of the range of the values: how far the last may be from the first where the table is one period


@dataclass(frozen=True)
class Curve:
    """One period: t : times [s] from 0 to the period, and values there; the last value is the first one again.

    signal : Q [m³/s] or P [Pa]. Raises ValueError, one sentence, for what is no such table.
    """

    signal: str
    t: tuple[float, ...]
    values: tuple[float, ...]
    interpolation: str = "cubic"

    def __post_init__(self) -> None:
        t, y = np.array(self.t, float), np.array(self.values, float)
        name = f"inlet.{self.signal}"
        if self.interpolation not in INTERPOLATIONS:
            raise ValueError(f"inlet.interpolation = {self.interpolation!r}: must be {' or '.join(INTERPOLATIONS)}.")
        if len(t) != len(y):
            raise ValueError(f"{name}: {len(y)} values for {len(t)} times; give one value per time.")
        if not 3 <= len(t) <= _MOST:
            raise ValueError(f"{name}: a table of {len(t)} rows; it must have 3 to {_MOST}.")
        if not (np.isfinite(t).all() and np.isfinite(y).all()):
            raise ValueError(f"{name}: times and values must be finite numbers; complete the table.")
        back = np.flatnonzero(np.diff(t) <= 0.0)
        if t[0] != 0.0 or back.size:
            at = f"t = {t[back[0] + 1]:g} s after {t[back[0]]:g} s" if back.size else f"the first is {t[0]:g} s"
            raise ValueError(f"{name}: times must start at 0 and increase, but {at}; correct the table.")
        if y[0] != y[-1]:
            raise ValueError(f"{name}: the last value must be the first one, {y[0]:g}; close the table.")

    @staticmethod
    def through(
        signal: str, t: Array, values: Array, interpolation: str = "cubic", period: float | None = None
    ) -> Curve:
        """The curve through a table, with time counted from its first row.

        period [s] : default the length of a table whose last value is its first; a longer one is closed by that value.
        Raises ValueError where the table is not one period.
        """
        t, values = np.array(t, float), np.array(values, float)
        t = t - t[:1]
        last = float(t[-1]) if t.size else 0.0
        gap, size = (abs(values[-1] - values[0]), np.ptp(values)) if values.size else (0.0, 0.0)
        period = last if period is None else period
        if period > last * (1.0 + 1e-12):
            t, values = np.append(t, period), np.append(values, values[:1])
        elif period < last * (1.0 - 1e-12):
            raise ValueError(f"inlet.T = {period:g} s: shorter than the table, {last:g} s; give one period.")
        elif gap > _CLOSED * size:
            raise ValueError(
                f"inlet.{signal}: the table ends at {values[-1]:g} and begins at {values[0]:g}; end it with its first "
                "value, or give the period T after its last time."
            )
        else:
            values = np.append(values[:-1], values[:1])
        return Curve(signal, tuple(t.tolist()), tuple(values.tolist()), interpolation)

    @property
    def period(self) -> float:
        """[s]"""
        return self.t[-1]

    @property
    def largest(self) -> float:
        return max(self.values)

    def scaled(self, factor: float, stretch: float = 1.0) -> Curve:
        """All values, and all times, times a factor."""
        t, values = (tuple(by * x for x in old) for by, old in ((stretch, self.t), (factor, self.values)))
        return replace(self, t=t, values=values)

    @cached_property
    def mean(self) -> float:
        """The mean over a period: of the straight pieces, and of what the cubic adds, -h³ (M_i + M_{i+1})/24."""
        t, y, M = self._numbers
        h = np.diff(t)
        whole = 0.5 * h * (y[1:] + y[:-1]) - h**3 / 24.0 * (M[1:] + M[:-1])
        return float(whole.sum() / self.period)

    def at(self, phase: Array | float) -> Array:
        """Values at parts of the period, any shape; beyond 1 it repeats."""
        t, y, M = self._numbers
        x = np.mod(np.asarray(phase, float), 1.0) * self.period
        i = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 2)
        h = t[i + 1] - t[i]
        left, right = (t[i + 1] - x) / h, (x - t[i]) / h
        cubic = (left**3 - left) * M[i] + (right**3 - right) * M[i + 1]
        return left * y[i] + right * y[i + 1] + cubic * h * h / 6.0

    @cached_property
    def _numbers(self) -> tuple[Array, Array, Array]:
        """t, values and second derivatives M, the last equal to the first."""
        t, y = np.array(self.t), np.array(self.values)
        if self.interpolation == "linear":
            return t, y, np.zeros_like(y)
        h = np.diff(t)
        slope = np.diff(y) / h
        n, before = len(h), np.roll(h, 1)
        matrix = np.diag(2.0 * (before + h))
        i = np.arange(n)
        matrix[i, i - 1] += before
        matrix[i, (i + 1) % n] += h
        M = np.linalg.solve(matrix, 6.0 * (slope - np.roll(slope, 1)))
        return t, y, np.append(M, M[0])
