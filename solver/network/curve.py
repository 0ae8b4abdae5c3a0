"""A periodic curve through a table of times and values: the drive of a network's inlet other than the half-sine.

Cubic: the periodic spline with continuous second derivative, whose second derivatives M at the points solve

    h_{i-1} M_{i-1} + 2 (h_{i-1} + h_i) M_i + h_i M_{i+1} = 6 [(y_{i+1} - y_i)/h_i - (y_i - y_{i-1})/h_{i-1}]

with indices modulo the number of points (C. de Boor, A Practical Guide to Splines, ch. IV). Linear: straight pieces.
Fourier: the least-squares series with K harmonics through the points,

    y(t) = a_0 + Σ_k a_k cos 2πkt/T + b_k sin 2πkt/T,     k = 1 … K
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..errors import InputError

Array = np.ndarray

INTERPOLATIONS = ("cubic", "linear", "fourier")
_MOST = 2000  # rows
_MOST_HARMONICS = 100
_TELLS = 1e-6  # smallest over largest singular value of the harmonics at the rows, if these determine them
_FINE = 4096  # samples of a period, to find the largest value of a series
_CLOSED = 1e-6  # of the range of the values: tolerance between the last and the first value of one period


@dataclass(frozen=True)
class Curve:
    """One period: t : times [s] from 0 to the period, and values there; the last value repeats the first.

    signal : Q [m³/s] or P [Pa]. harmonics : K of a Fourier series, 0 for the others.
    Raises ValueError, one sentence that begins with the signal, for an invalid table.
    """

    signal: str
    t: tuple[float, ...]
    values: tuple[float, ...]
    interpolation: str = "cubic"
    harmonics: int = 0

    def __post_init__(self) -> None:
        t, y, name = np.array(self.t, float), np.array(self.values, float), self.signal
        if len(t) != len(y):
            raise InputError(f"{name}: {len(y)} values for {len(t)} times; give one value per time.")
        if not 3 <= len(t) <= _MOST:
            raise InputError(f"{name}: a table of {len(t)} rows; it must have 3 to {_MOST}.")
        if not (np.isfinite(t).all() and np.isfinite(y).all()):
            raise InputError(f"{name}: times and values must be finite numbers; complete the table.")
        back = np.flatnonzero(np.diff(t) <= 0.0)
        if t[0] != 0.0 or back.size:
            at = f"t = {t[back[0] + 1]:g} s after {t[back[0]]:g} s" if back.size else f"the first is {t[0]:g} s"
            raise InputError(f"{name}: times must start at 0 and increase, but {at}; correct the table.")
        if y[0] != y[-1]:
            raise InputError(f"{name}: the last value must be the first one, {y[0]:g}; close the table.")
        self._check_interpolation()

    def _check_interpolation(self) -> None:
        if self.interpolation not in INTERPOLATIONS:
            raise InputError(f"interpolation = {self.interpolation!r}: must be {' or '.join(INTERPOLATIONS)}.")
        if self.interpolation != "fourier":
            if self.harmonics:
                raise InputError(f"harmonics = {self.harmonics}: only a Fourier series has them; omit it.")
            return
        most = min(_MOST_HARMONICS, (len(self.t) - 2) // 2)
        if not 1 <= self.harmonics <= most:
            given = f"harmonics = {self.harmonics}" if self.harmonics else "harmonics is missing"
            raise InputError(f"{given}: a Fourier series has at least 1, and with {len(self.t)} rows {most} at most.")
        size = np.linalg.svd(self._waves, compute_uv=False)
        if size[-1] < _TELLS * size[0]:
            raise InputError(
                f"harmonics = {self.harmonics}: the times of the table are too uneven for so many; give fewer."
            )

    @staticmethod
    def through(
        signal: str,
        t: Array,
        values: Array,
        interpolation: str = "cubic",
        period: float | None = None,
        harmonics: int = 0,
    ) -> Curve:
        """The curve through a table, with time counted from its first row.

        period [s] : by default the length of the table, if its last value equals its first; a longer period is closed
        by the first value. Raises ValueError unless the table is one period.
        """
        t, values = np.array(t, float), np.array(values, float)
        t = t - t[:1]
        last = float(t[-1]) if t.size else 0.0
        gap, size = (abs(values[-1] - values[0]), np.ptp(values)) if values.size else (0.0, 0.0)
        period = last if period is None else period
        if period > last * (1.0 + 1e-12):
            t, values = np.append(t, period), np.append(values, values[:1])
        elif period < last * (1.0 - 1e-12):
            raise InputError(f"T = {period:g} s: shorter than the table, {last:g} s; give one period.")
        elif gap > _CLOSED * size:
            raise InputError(
                f"{signal}: the table ends at {values[-1]:g} and begins at {values[0]:g}; end it with its first "
                "value, or give the period T after its last time."
            )
        else:
            values = np.append(values[:-1], values[:1])
        return Curve(signal, tuple(t.tolist()), tuple(values.tolist()), interpolation, harmonics)

    @staticmethod
    def series(signal: str, mean: float, cos: Array, sin: Array, period: float) -> Curve:
        """The Fourier series with the coefficients a_0, a : (K,), b : (K,), by its values at equidistant times.

        Raises ValueError unless there are as many cosines as sines, one to a hundred of each.
        """
        K = len(cos)
        if not 1 <= K <= _MOST_HARMONICS or len(sin) != K:
            raise InputError(
                f"{signal}_cos: {K} cosines and {len(sin)} sines; give as many of each, 1 to {_MOST_HARMONICS}."
            )
        n = 2 * K + 2
        values = mean + _harmonics(np.arange(n) / n, K)[:, 1:] @ np.concatenate([cos, sin])
        t = period / n * np.arange(n + 1)
        t[-1] = period
        return Curve.through(signal, t, np.append(values, values[0]), "fourier", harmonics=K)

    @property
    def period(self) -> float:
        """[s]"""
        return self.t[-1]

    @property
    def largest(self) -> float:
        """The largest value of the table, or of a series."""
        return max(self.values) if self.interpolation != "fourier" else float(self.at(np.arange(_FINE) / _FINE).max())

    def scaled(self, factor: float, stretch: float = 1.0) -> Curve:
        """All values, and all times, times a factor."""
        t, values = (tuple(by * x for x in old) for by, old in ((stretch, self.t), (factor, self.values)))
        return replace(self, t=t, values=values)

    def raised(self, by: float) -> Curve:
        """All values plus a constant."""
        return replace(self, values=tuple(value + by for value in self.values))

    @cached_property
    def mean(self) -> float:
        """The mean over a period: that of the straight pieces plus that of the cubic part, -h³ (M_i + M_{i+1})/24;
        a_0."""
        if self.interpolation == "fourier":
            return float(self.coefficients[0].real)
        t, y, M = self.numbers
        h = np.diff(t)
        whole = 0.5 * h * (y[1:] + y[:-1]) - h**3 / 24.0 * (M[1:] + M[:-1])
        return float(whole.sum() / self.period)

    def at(self, phase: Array | float) -> Array:
        """Values at fractions of the period, any shape; the curve repeats beyond 1."""
        if self.interpolation == "fourier":
            turn = np.exp(2j * np.pi * np.mod(np.asarray(phase, float), 1.0))
            return np.asarray(np.polyval(self.coefficients[::-1], turn).real)
        t, y, M = self.numbers
        x = np.mod(np.asarray(phase, float), 1.0) * self.period
        i = np.clip(np.searchsorted(t, x, side="right") - 1, 0, len(t) - 2)
        h = t[i + 1] - t[i]
        left, right = (t[i + 1] - x) / h, (x - t[i]) / h
        cubic = (left**3 - left) * M[i] + (right**3 - right) * M[i + 1]
        return left * y[i] + right * y[i + 1] + cubic * h * h / 6.0

    @cached_property
    def numbers(self) -> tuple[Array, Array, Array]:
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

    @property
    def _waves(self) -> Array:
        """1, the cosines and the sines at all rows but the last, which repeats the first : (rows, 2 K + 1)."""
        return _harmonics(np.array(self.t[:-1]) / self.period, self.harmonics)

    @cached_property
    def coefficients(self) -> Array:
        """a_k - i b_k : (K + 1,)."""
        K = self.harmonics
        found = np.linalg.lstsq(self._waves, np.array(self.values[:-1]), rcond=None)[0]
        return np.append(found[0], found[1 : K + 1] - 1j * found[K + 1 :])


def _harmonics(phase: Array, K: int) -> Array:
    """1, cos 2πkφ and sin 2πkφ, k = 1 … K, at fractions φ : (n,) of a period, as (n, 2 K + 1)."""
    angle = 2.0 * np.pi * phase[:, None] * np.arange(1, K + 1)
    return np.concatenate([np.ones((len(phase), 1)), np.cos(angle), np.sin(angle)], axis=1)
