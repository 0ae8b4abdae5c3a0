"""A record cut into aligned beats: at a period that is found or given, or each beat by itself where they vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver.errors import InputError

from ...parallel.threads import single_threaded
from .. import thresholds as limit
from ..read.record import Array, Record
from .beats import Beats, require_phases
from .harmonic_model import evaluate, harmonics
from .period import strict_period, usual_period
from .rounding import converter_step
from .upstrokes import without_gaps
from .variable_beats import Whole, unequal

_ROBUST = 1.4826  # standard deviation over median absolute deviation, of a Gaussian
_LEAST = 1e-6  # of the range: rounding is no scatter
_EXACT = 1e-7  # of the pulse: noise that is assumed at least when beats are timed


@single_threaded
def align(record: Record, period: float | None = None) -> Beats:
    """The record as whole beats that start at its first sample, moved onto the strict period where they jitter.

    period : [s], by default found. Where beats are equal it is taken as it is, or several beats long; where they
    vary it says which beats are meant, and each is cut by itself. Equal beats have N = round(T/dt) samples; where T is
    no multiple of dt they are resampled by a harmonic model. Jitter is removed if it is significant.
    Raises ValueError if there is no period, or another one than the given, fewer than two whole beats, or a phase that
    a channel never measured.
    """
    if period is not None:
        _check(period, record)
    T, whole, said = _rhythm(record, period)
    samples = np.minimum(_grid(record, T) if whole is None else whole.samples, len(record.time) - 1)
    steps = {name: step for name, each in record.channels.items() if (step := converter_step(each)) > 0.0}
    slip = 0.0 if whole is None else limit.SLIP_OF_CUTS
    cleaned = {name: _without_spikes(x, samples, steps.get(name, 0.0), slip) for name, x in record.channels.items()}
    spikes = {name: count for name, (_, count) in cleaned.items() if count}
    channels = {name: each for name, (each, _) in cleaned.items()}
    for name, each in channels.items():
        require_phases((~np.isnan(each[samples])).sum(axis=0), name, record.path)
    if whole is None:
        equal = {name: _without_slope(_equal(each, record.dt / T, samples)) for name, each in channels.items()}
        values, shifts = _without_jitter(equal, T)
    else:
        T, values, shifts = whole.T, {name: whole.of(each) for name, each in channels.items()}, np.zeros(len(samples))
        whole = replace(whole, channels={name: without_gaps(each) for name, each in channels.items()})
    beats = Beats(record.path, record.sha256, T, values, shifts, spikes, steps, whole, record.told,
                  (*record.said, *said))  # fmt: skip
    if beats.unsteadiness > limit.NEAR:
        raise InputError(
            f"{record.path}: the heart rate is not steady: if cut every {T:.4g} s, a beat is shifted against the one "
            f"before by up to {beats.unsteadiness:.0%} of that, and more than {limit.NEAR:.0%} cannot be aligned; "
            "use a stretch of the record with a steady rate."
        )
    return beats


def _grid(record: Record, T: float) -> Array:
    """(n_beats, N) the sample that is nearest to each phase of equal beats. Raises ValueError if there are too few."""
    f, n = record.dt / T, len(record.time)
    N, n_beats = round(1.0 / f), int((n + 0.5) * f)  # half a sample of tolerance: noise must not cost the last beat
    if N < limit.FEWEST_SAMPLES:
        raise InputError(
            f"{record.path}: {1 / f:.2g} samples in a period of {T:.4g} s are too few; sample "
            f"{limit.FEWEST_SAMPLES} times a beat or more often, or check the unit of its time column."
        )
    if n_beats < 2:
        raise InputError(
            f"{record.path}: {n_beats} whole beat in {n * record.dt:.4g} s of record with a period of {T:.4g} s; "
            "record at least two whole beats."
        )
    return np.rint(np.arange(n_beats * N) / (N * f)).astype(np.intp).reshape(n_beats, N)


def _check(period: float, record: Record) -> None:
    """Raise ValueError for a period [s] of which the record cannot hold two."""
    span = len(record.time) * record.dt
    if not (np.isfinite(period) and period > 0.0):
        raise InputError(f"{record.path}: period = {period!r} s: must be a positive, finite number.")
    if 2.0 * period > span * (1.0 + 1e-9):
        raise InputError(
            f"{record.path}: period = {period:.4g} s: longer than half of the {span:.4g} s of record; "
            "give a shorter one or record at least two whole beats."
        )
    if period < limit.FEWEST_SAMPLES * record.dt:
        _grid(record, period)


def _rhythm(record: Record, period: float | None) -> tuple[float, Whole | None, tuple[str, ...]]:
    """The strict period [s], the beats if they vary, and what is doubtful. Raises ValueError if it cannot be told, or
    is not the given one or a whole part of it."""
    channels, dt, source = record.channels, record.dt, record.path
    try:
        usual = usual_period(channels, dt, source)
        if period is not None and abs(period / usual.other - 1.0) <= limit.NEAR:  # of the two, the record does not say
            usual = replace(usual, T=period)
        whole = unequal(channels, dt, usual.T)
        T = strict_period(usual.T, channels, dt) if whole is None else whole.T
        if T is None:
            raise InputError(
                f"{source}: the heart rate is not steady: beats come every {usual.T:.3g} s or so, but no period fits "
                "the whole record, and their upstrokes are too unlike or too irregular to cut each by itself; "
                "use a stretch of the record with a steady rate."
            )
    except InputError:  # too irregular or too short to tell: then the word of the user counts
        if period is None:
            raise
        whole = unequal(channels, dt, period)
        T = period if whole is None else whole.T
    if period is None:
        return T, whole, usual.said
    beats = period / T
    count = max(1, round(beats))
    slip = abs(beats / count - 1.0) * len(record.time) * dt / period
    if abs(beats - count) > limit.NEAR if whole is not None else slip > limit.VARIES:
        raise InputError(
            f"{source}: period = {period:.4g} s: the record repeats every {T:.4g} s; give that, or leave it out."
        )
    said: tuple[str, ...] = ()
    if whole is not None and count > 1:
        said = (f"the given period of {period:.4g} s holds {count} beats; they vary, so that each was cut by itself.",)
    return float(period), whole, said


def _equal(x: Array, f: float, samples: Array) -> Array:
    """Equal beats of a channel : (n_beats, N); samples : the nearest to each phase j/N; f : cycles a sample.

    Samples as they are if the beats keep step with them, else the harmonic model plus the residual of the nearest one.

    The model carries the pulse exactly; the residual is moved by less than half a sample but not averaged, so that
    white noise keeps its variance. At high harmonics that little motion is a large part of a turn and would add noise
    to the mean beat; there the residual's mean is taken out again, and the mean beat is the model. At low harmonics it
    is needed: drift leaks into the model of a record that is no whole number of beats, the residual makes up for it.
    """
    (n_beats, N), n = samples.shape, len(x)
    if abs(N * f - 1.0) * n < limit.IN_STEP and n_beats * N <= n:
        return np.asarray(x[samples])
    c = harmonics(x, f)
    moved = (x - evaluate(c, f, n))[samples]
    spectrum = np.fft.rfft(np.nanmean(moved, axis=0))
    spectrum[len(c) :] = spectrum[: N // limit.MOVED] = 0.0
    return np.asarray(moved - np.fft.irfft(spectrum, N) + evaluate(c, 1.0 / N, N))


# --- spikes -----------------------------------------------------------------------------------------------------------


def _without_spikes(values: Array, samples: Array, step: float, slip: float) -> tuple[Array, int]:
    """A channel with gaps in place of its spikes, and their number: single samples far off everything around them.

    A spike raises the scatter as much as the mean, so the intervals grow and χ² stays at 1, while the fit is wrong. A
    sample becomes a gap if it is off both the other beats at its phase and its own neighbours: a beat that differs as a
    whole, an ectopic one, is not touched.

    samples : (n_beats, N) the sample at each phase of each beat. step : of the channel's converter, whose rounding is
    no spike. slip : samples by which beats may be off one another.
    """
    n_beats, N = samples.shape
    if n_beats < limit.FEWEST_BEATS:
        return values, 0
    nearest = samples.ravel()
    beats = values[nearest].reshape(n_beats, N)
    gaps = np.isnan(beats)
    if gaps.all(axis=0).any() or gaps.all(axis=1).any():
        return values, 0  # refused later, or nothing to compare with
    median = np.nanmedian if gaps.any() else np.median
    usual = median(beats, axis=0)
    off = beats - usual
    off -= median(off, axis=1)[:, None]
    size = _ROBUST * median(np.abs(off), axis=0)
    least = np.maximum(np.median(size), _LEAST * np.ptp(values[~np.isnan(values)]))
    far = np.maximum(limit.FAR * np.maximum(size, least), limit.STEPS * step + slip * np.abs(np.gradient(usual)))
    off = np.nan_to_num(off)
    suspect = np.abs(off) > far
    if not suspect.any():
        return values, 0
    flat = off.ravel()
    around = np.lib.stride_tricks.sliding_window_view(np.pad(flat, 2, "edge"), 5)
    alone = np.abs(flat - np.median(around, axis=-1)).reshape(off.shape)
    # most of it by itself: the samples of a smooth artefact have neighbours like them
    spikes = np.unique(nearest[(suspect & (alone > far) & (alone > 0.5 * np.abs(off))).ravel()])
    cleaned = values.copy()
    cleaned[spikes] = np.nan
    return cleaned, len(spikes)


# --- timing and drift -------------------------------------------------------------------------------------------------


def _without_jitter(values: Mapping[str, Array], T: float) -> tuple[Mapping[str, Array], Array]:
    """Values with significant jitter taken out, and the shifts [s]; the same values and zeros if there is none."""
    from scipy.stats import f as f_distribution  # takes half a second

    n_beats, N = next(iter(values.values())).shape
    turns, excess, dof, means = _timing(np.stack([_spectra(beats) for beats in values.values()]), N)
    if n_beats < 3 or f_distribution.sf(excess / (n_beats - 2), n_beats - 2, dof) > limit.JITTER:
        return values, np.zeros(n_beats)
    moved = {}
    for (name, beats), mean in zip(values.items(), means, strict=True):
        k = np.arange(1, len(mean) + 1)
        change = np.zeros((n_beats, N // 2 + 1), complex)
        change[:, 1 : len(mean) + 1] = (1.0 - np.exp(-2j * np.pi * np.outer(turns, k))) * mean
        moved[name] = beats + np.fft.irfft(change * N, N, axis=1)  # the model moves back, the residual stays
    return moved, turns * T


def _timing(F: Array, N: int) -> tuple[Array, float, float, Array]:
    """Shift of each beat [periods], χ² of the shifts, degrees of freedom of the noise in it, and the mean beats where
    they are above it : (m, K), of the coefficients 1 … K of m channels, F : (m, n_beats, K), of beats of N samples.

    Beat b is modelled as the mean beat s_b later: F_bk = m_k e^{-2πi k s_b} + noise of variance S_k + a straight line
    (drift). To first order the shifts are weighted projections on the derivative of the mean beat, all channels
    jointly; repeated until they stand still.
    """
    _, n_beats, K = F.shape
    k = np.arange(1, K + 1)
    line = np.fft.rfft(np.arange(N) / N)[k] / N
    turns, excess, S = np.zeros(n_beats), 0.0, None
    for _ in range(8):
        turned = F * np.exp(2j * np.pi * np.outer(turns, k))
        mean = turned.mean(axis=1)
        turned -= mean[:, None]
        S = _pooled((np.abs(turned) ** 2).sum(axis=1)) / (n_beats - 1) if S is None else S
        S = np.maximum(S, _EXACT**2 * (np.abs(mean) ** 2).sum(axis=1, keepdims=True))
        mean *= np.abs(mean) ** 2 > limit.SURE**2 * S / n_beats
        tau, size = -2j * np.pi * k * mean, _inner(line, line, S)
        template = tau - line * (_inner(tau, line, S) / size)
        information = float(_inner(template, template, S).sum())
        if not information > 0.0:
            return np.zeros(n_beats), 0.0, 1.0, mean
        change = (turned @ (template.conj() / S)[..., None]).real.sum(axis=0)[:, 0] / information
        change -= change.mean()
        left = turned - change[:, None] * tau[:, None]
        left -= (left @ (line.conj() / S)[..., None]).real / size[:, None] * line
        # the share of each harmonic's two numbers that shift and line have taken away
        taken = (np.abs(line) ** 2 / size + np.abs(template) ** 2 / information) / (2.0 * S)
        S = _pooled((np.abs(left) ** 2).sum(axis=1)) / (_pooled(1.0 - taken) * (n_beats - 1))
        turns = turns + change
        excess = 2.0 * information * float(turns @ turns)
        if np.abs(change).max() ** 2 * information < 1e-6:
            break
    return turns, excess, 2.0 * (2 * limit.NEIGHBOURS + 1) * max(n_beats - 2, 1), mean


def _spectra(beats: Array) -> Array:
    """Fourier coefficients 1.._TIMING of each beat : (n_beats, K), gaps filled with the mean beat."""
    there = ~np.isnan(beats)
    if not there.all():
        beats = np.where(there, beats, np.nanmean(beats, axis=0))
    N = beats.shape[1]
    return np.fft.rfft(beats, axis=1)[:, 1 : min(limit.TIMING, (N - 1) // 2) + 1] / N


def _inner(a: Array, b: Array, S: Array) -> Array:
    """(m, 1), each harmonic in units of its noise."""
    return np.asarray(((a.conj() * b).real / S).sum(axis=-1, keepdims=True))


def _pooled(S: Array) -> Array:
    """The mean over neighbouring harmonics, fewer at the ends : (m, K)."""
    K = S.shape[1]
    total = np.concatenate([np.zeros((len(S), 1)), np.cumsum(S, axis=1)], axis=1)
    low, high = np.maximum(np.arange(K) - limit.NEIGHBOURS, 0), np.minimum(np.arange(K) + limit.NEIGHBOURS + 1, K)
    return np.asarray((total[:, high] - total[:, low]) / (high - low))


def _without_slope(beats: Array) -> Array:
    """Beats without the slope that the slow drift from beat to beat has within each of them.

    A drift puts the same ramp into every beat: the scatter between beats does not show it, the mean beat has it. Its
    slope is that of the beats' levels; the levels themselves stay, and count as scatter of the mean.
    """
    if len(beats) < 3:
        return beats
    measured = np.flatnonzero(~np.isnan(beats).all(axis=1))
    deviations = beats[measured] - np.nanmean(beats, axis=0)
    levels = np.interp(np.arange(len(beats)), measured, np.nanmean(deviations, axis=1))  # also of a beat in a gap
    N = beats.shape[1]
    return np.asarray(beats - np.outer(np.gradient(levels), (np.arange(N) + 0.5) / N - 0.5))
