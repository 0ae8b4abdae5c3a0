"""Beats of one length: their ensemble mean, and the error of the mean, from their scatter and from rounding to the
steps of a converter.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.quantities.units import of_signal

from .. import limits
from ..read.record import require
from .variable_beats import Array, VariableBeats, unlikeness


@dataclass(frozen=True)
class Beats:
    """Beats of one length; ``values`` : name -> (n_beats, N) in SI, NaN in gaps, sample j at phase j/N.

    source, sha256, told : of the record. T : period [s]. shifts : (n_beats,) [s], how much later than the strict period
    each beat came before it was moved back (0 where none was moved). spikes : single samples left out, by channel.
    steps : of the channels' converters, in SI. variable : the record that variable beats were cut from, each at the end
    of diastole; without, phase 0 is the record's first sample. said : notes on doubts about the period.
    """

    source: str
    sha256: str
    T: float
    values: Mapping[str, Array]
    shifts: Array
    spikes: Mapping[str, int] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)
    variable: VariableBeats | None = None
    told: Mapping[str, Any] = field(default_factory=dict)
    said: tuple[str, ...] = ()

    @property
    def n_beats(self) -> int:
        """Number of beats."""
        return len(self.shifts)

    @property
    def N(self) -> int:
        """Samples a beat."""
        return int(next(iter(self.values.values())).shape[1])

    @property
    def time(self) -> Array:
        """Times of the samples of a beat : (N,) [s]."""
        return np.arange(self.N) * (self.T / self.N)

    @property
    def omega(self) -> float:
        """2π/T [1/s]."""
        return 2.0 * np.pi / self.T

    @property
    def unsteadiness(self) -> float:
        """How far the interval between two beats is from the period at most, in periods.

        Not the shift itself: that of independent intervals wanders ever further, and does no harm.
        """
        return float(np.abs(np.diff(self.shifts)).max() / self.T) if self.n_beats > 1 else 0.0

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What to know before trusting an interval, one sentence each."""
        found = list(self.said)
        if self.n_beats < limits.FEWEST_BEATS:
            found.append(
                f"{self.n_beats} beats say little about the noise; record at least {limits.FEWEST_BEATS} for honest "
                "intervals."
            )
        if self.unsteadiness > limits.UNSTEADY:
            found.append(
                f"the heart rate was not steady: a beat lasted up to {self.unsteadiness:.1%} of the period more or "
                "less; intervals do not cover what that does to the shape of a beat."
            )
        found += self.variable.said if self.variable else ()
        for name, count in self.spikes.items():
            found.append(
                f"spikes of {name} left out ({count} samples): more than {limits.FAR:g} robust standard deviations "
                "off the other beats, and alone among their neighbours."
            )
        return (*found, *self._trends(), *self._odd_beats())

    def _trends(self) -> Iterator[str]:
        """A sentence for each channel whose level or pulse is not that of one state: an occlusion, a drug, a zero that
        drifts, a catheter that clots.

        The change is that of a line through the means of the beats, or their sizes along the mean beat.
        """
        for name, beats in self.values.items():
            usual = self.mean(name)
            there = np.flatnonzero(~np.isnan(beats).all(axis=1))
            if len(there) < limits.FEWEST_BEATS:
                continue
            off = (beats - usual)[there]
            level, wave = np.nanmean(off, axis=1), usual - usual.mean()
            own = np.where(np.isnan(off), np.nan, wave)  # where the beat has samples
            size = 1.0 + np.nanmean((off - level[:, None]) * own, axis=1) / np.maximum(np.nanvar(own, axis=1), 1e-300)
            largest = max(abs(float(usual.mean())), float(usual.std()))
            for quantity, y, least, cause in (
                ("mean", usual.mean() + level, limits.NEAR * largest, "a zero drifts"),
                ("pulse", float(np.ptp(usual)) * size, limits.OTHER_PULSE * float(np.ptp(usual)), "a catheter clots"),
            ):
                line = np.polyfit(there, y, 1)
                change = float(line[0] * (self.n_beats - 1))
                if abs(change) > least:
                    unit, factor = of_signal(name)
                    first, last = factor * line[1], factor * (line[1] + change)
                    yield (
                        f"the {quantity} of {name} goes from {first:.3g} to {last:.3g} "
                        f"{unit} over the beats used: the mean beat is of no single state, or {cause}; give a steady "
                        "part with --part."
                    )

    def _odd_beats(self) -> list[str]:
        """A sentence for each beat that is unlike the others: an artefact, an ectopic beat, a flushed catheter."""
        found: dict[int, tuple[str, str]] = {}
        w, at = self.variable, np.maximum(np.arange(self.n_beats) * self.T + self.shifts, 0.0)
        begins = at if w is None else w.edges[w.serving] * w.dt  # [s] after the record's start
        for name, beats in self.values.items():
            measured = np.flatnonzero(~np.isnan(beats).all(axis=1))
            size = unlikeness(beats[measured])
            usual, pulse = float(np.median(size)), float(np.ptp(self.mean(name)))
            for i in np.flatnonzero(size > max(limits.ODD * usual, limits.VISIBLE * pulse)):
                b = int(measured[i])
                sentences = (
                    f"beat {b + 1} ({begins[b]:.4g} s after the record's start) is unlike the others in {name}: "
                    f"it deviates by {size[i] / pulse:.1%} of the pulse, they by {usual / pulse:.2g} of it; "
                    "if it is an artefact, leave its samples empty."
                )
                found.setdefault(b, (name, sentences))
        if len(found) <= limits.NAMED:
            return [found[b][1] for b in sorted(found)]
        names = ", ".join(dict.fromkeys(found[b][0] for b in sorted(found)))
        return [
            f"{len(found)} of {self.n_beats} beats, from {begins[min(found)]:.4g} to {begins[max(found)]:.4g} s after "
            f"the record's start, are unlike the others in {names}: if the subject was in another state then, give "
            "the part of one state with --part; if they are artefacts, leave their samples empty."
        ]

    def require(self, names: Iterable[str]) -> None:
        """Raises ValueError that lists the channels unless all of ``names`` are there."""
        require(self.values, names, self.source)

    def site(self, name: str) -> tuple[Array, Array]:
        """P [Pa] and R [m] of a site, (n_beats, N) each. Raises ValueError if one is missing."""
        self.require((f"{name}.P", f"{name}.R"))
        return self.values[f"{name}.P"], self.values[f"{name}.R"]

    def mean(self, name: str) -> Array:
        """The ensemble mean beat : (N,). Raises ValueError where no beat was measured at a phase."""
        return self._moments(name)[0]

    def scatter(self, name: str) -> Array:
        """Standard deviation between beats at each phase : (N,); the channel's noise where one beat alone was measured.

        Needs two beats, as noise and covariance do.
        """
        counts = self._moments(name)[1]
        spread = np.sqrt((self._deviations(name) ** 2).sum(axis=0) / np.maximum(counts - 1, 1))
        return np.where(counts > 1, spread, self.noise(name))

    def noise(self, name: str) -> float:
        """Standard deviation of one sample's noise, from the scatter about each beat's own mean."""
        C = self._scatter_matrices((name,))[1:, 0, 0].real
        weights = np.full(len(C), 2.0)
        weights[-1] -= 1.0 - self.N % 2  # the coefficient at half the sampling rate stands for itself alone
        return float(np.sqrt(self.N**2 / self._ones((name,))[0] * (weights @ C) / weights.sum()))

    def covariance(self, names: Sequence[str]) -> Array:
        """Covariance of the Fourier coefficients X_k = rfft(mean)/N of the ensemble mean : (K + 1, m, m), K = N//2.

            C_k = Σ_b (X_bk - X_k)(X_bk - X_k)* / (n (n - 1)),  averaged over the harmonics k - 3 .. k + 3 that exist

        of n beats and all m channels together; Hermitian, positive semi-definite; E X X*, so σ²/(N n) for white noise
        of standard deviation σ. The mean, k = 0, is apart: real, and larger where the means of successive beats are
        correlated (r), by (1 + r)/(1 - r). Gaps are filled with the mean beat, and the covariance scaled to the
        number that was measured. Raises ValueError for a missing channel or a single beat.
        """
        if (key := tuple(names)) not in self._covariances:
            self._covariances[key] = self._covariance(key)
        return self._covariances[key].copy()

    def _covariance(self, names: tuple[str, ...]) -> Array:
        C = self._scatter_matrices(names)
        K = len(C) - 1
        pooled = np.empty_like(C)
        factors = np.sqrt(self.serial_factors(names))
        at, V = np.arange(len(names)), self.rounding(names)
        pooled[0] = C[0].real * np.outer(factors, factors) + np.diag(V[0])
        C[:, at, at] += V
        for k in range(1, K + 1):
            half = min(limits.NEIGHBOURS, max(1, k - 1)) if self.n_beats >= limits.MANY else limits.NEIGHBOURS
            pooled[k] = C[max(1, k - half) : k + half + 1].mean(axis=0)
        if self.N % 2 == 0:
            pooled[K] = pooled[K].real
        return pooled

    def rounding(self, names: Sequence[str]) -> Array:
        """Variance that a converter's steps leave in X_k, which no number of beats lowers : (K + 1, m)."""
        return np.stack([rounded_harmonics(self.values[name], self.steps.get(name, 0.0)) for name in names], axis=1)

    def serial_factors(self, names: Sequence[str]) -> Array:
        """(m,) how many successive beats hold as much of the mean as one that is independent: (1 + r)/(1 - r)."""
        return np.array([_serial_factor(self._deviations(name).mean(axis=1)) for name in names])

    def select(self, indices: Sequence[int] | Array) -> Beats:
        """Some of the beats, in that order, repetition allowed."""
        index = np.asarray(indices, dtype=int)
        values, variable = {n: v[index] for n, v in self.values.items()}, self.variable and self.variable.select(index)
        return replace(self, values=values, shifts=self.shifts[index], variable=variable)

    @cached_property
    def _covariances(self) -> dict[tuple[str, ...], Array]:
        return {}

    @cached_property
    def _cache(self) -> dict[str, tuple[Array, Array]]:
        return {}

    def _moments(self, name: str) -> tuple[Array, Array]:
        """The mean beat, and how many beats were measured at each phase : (N,)."""
        if name not in self._cache:
            self.require((name,))
            counts = (~np.isnan(self.values[name])).sum(axis=0)
            require_phases(counts, name, self.source)
            self._cache[name] = np.nansum(self.values[name], axis=0) / counts, counts
        return self._cache[name]

    def _deviations(self, name: str) -> Array:
        """Beats less the mean beat, 0 in gaps : (n_beats, N)."""
        return np.nan_to_num(self.values[name] - self.mean(name), nan=0.0)

    def _ones(self, names: Sequence[str]) -> Array:
        """Σ_j 1/n_j of each channel: N² times the variance of a coefficient of the mean under unit white noise."""
        return np.array([(1.0 / self._moments(name)[1]).sum() for name in names])

    def _scatter_matrices(self, names: tuple[str, ...]) -> Array:
        """C_k of each harmonic by itself : (K + 1, m, m)."""
        self.require(names)
        n = self.n_beats
        if n < 2:
            raise InputError(f"{self.source}: one beat has no scatter; give at least two beats.")
        X = np.stack([np.fft.rfft(self._deviations(name), axis=1) / self.N for name in names])
        C = np.einsum("abk,cbk->kac", X, X.conj(), optimize=True) / (n * (n - 1))
        lost = np.array([((self._moments(name)[1] - 1) / (n * (n - 1))).sum() for name in names])
        scale = np.sqrt(self._ones(names) / np.maximum(lost, 1.0 / n))
        return np.asarray(C * np.outer(scale, scale))


def require_phases(counts: Array, name: str, source: str) -> None:
    if (counts == 0).any():
        raise InputError(
            f"{source}: the gaps of {name} leave {np.mean(counts == 0):.0%} of the beat without a single sample; "
            "resample all channels to one rate if theirs differ, record more beats, or leave the channel out."
        )


def _serial_factor(means: Array) -> float:
    """(1 + r)/(1 - r) for the variance of the mean of a series with lag-1 correlation r, if that is significant."""
    means = means - means.mean()
    n, power = len(means), means @ means
    r = float(means[1:] @ means[:-1] / power) if power > 0.0 else 0.0
    r = min(r, limits.MOST_SERIAL)
    return (1.0 + r) / (1.0 - r) if n > 2 and r > limits.FIVE_PERCENT / np.sqrt(n) else 1.0


# --- what rounding to the steps of a converter leaves in a mean beat --------------------------------------------------

_WAVES = np.arange(1, 21)  # of the sawtooth: 97 % of its variance
_SIGMA = np.linspace(0.0, 1.0, 201)  # noise before rounding, in steps
_LEFT = (np.exp(-4.0 * np.pi**2 * np.outer(_SIGMA**2, _WAVES**2)) / _WAVES**2).sum(axis=1) / (2.0 * np.pi**2)


def rounding(beats: Array, step: float) -> float:
    """Standard deviation that rounding to ``step`` leaves in a sample of the mean of beats : (n, N), NaN in gaps.

    Where the noise σ of a sample is small beside the step q, all beats are rounded alike, and the mean of many keeps

        b² = q²/(2π²) Σ_m e^{-4π² m² σ²/q²} / m²      (q²/12 for σ = 0)

    of the variance; the rest, σ² + q²/12 - b², is scatter between beats, from which σ is found. A mean over beats whose
    values lie apart by a step or more, of noise or because the beats differ, is free of it.
    Source: B. Widrow and I. Kollár, Quantization Noise, Cambridge 2008, chapter on the characteristic function.
    """
    if not step > 0.0 or len(beats) < 2:
        return 0.0
    there = ~np.isnan(beats)
    counts = np.maximum(there.sum(axis=0), 2)
    middle = np.where(there, beats, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1)
    scatter = np.where(there, (beats - middle) ** 2, 0.0).sum(axis=0) / (counts - 1) / step**2
    # one phase has few beats to tell by: its neighbours help
    width = min(5, len(scatter))
    pooled = np.convolve(np.pad(scatter, width // 2, mode="wrap"), np.ones(width) / width, mode="valid")
    variance = _SIGMA**2 + 1.0 / 12.0 - _LEFT
    return step * float(np.sqrt(np.mean(np.interp(pooled, variance, _LEFT))))


def rounded_harmonics(beats: Array, step: float) -> Array:
    """Variance that rounding to ``step`` leaves in X_k = rfft(mean)/N of beats : (n, N) -> (N//2 + 1,).

    Rounding is a sawtooth of the signal x(φ), Σ_m (-1)^m q/(πm) sin(2πmx/q), of as many teeth as there are steps in
    the beat: at few steps a low harmonic, not white noise. Where the levels lie is accidental; over all their places

        V_k = q²/(4π²) Σ_m e^{-4π² m² σ²/q²}/m² (|Z_m,k|² + |Z_m,-k|²),  Z_m = Fourier coefficients of e^{2πi m x/q}

    which add up to the b² of :func:`rounding`; σ is the noise of that b². x is the mean beat of the harmonics above a
    tenth of a step: its own steps would say that it has no error.

    Measured on five waves, 15 beats of 110 samples, by bands of harmonics: the variance is 0.6 to 1.6 of what is
    said with scatter at 6 to 200 steps in the pulse and noise of up to 0.02 q, 0.6 to 2.2 at 2 to 4 steps; 0.5 to 1.5
    with noise of 0.1 and 0.3 q, which are on the safe side; 0.9 to 1.1 with q. As if white, b²/N, it was said up to 3
    times too small at 6 steps, 5 at 4, 9 at 2.
    """
    N = beats.shape[1]
    variance = (rounding(beats, step) / step) ** 2 if step > 0.0 else 0.0
    if not variance > 0.0:
        return np.zeros(N // 2 + 1)
    sigma = np.interp(variance, _LEFT[::-1], _SIGMA[::-1])
    c = np.fft.rfft(np.nanmean(beats, axis=0) / step)
    c[np.abs(c) < limits.STEP_SURE * N] = 0.0
    Z = np.abs(np.fft.fft(np.exp(2j * np.pi * np.outer(_WAVES, np.fft.irfft(c, N)))) / N) ** 2
    share = np.exp(-4.0 * np.pi**2 * (sigma * _WAVES) ** 2) / _WAVES**2 / (4.0 * np.pi**2)
    V = step**2 * (share @ Z)
    return np.asarray((V + V[-np.arange(N)])[: N // 2 + 1])
