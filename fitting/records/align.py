"""A record cut into aligned beats: at a period that is found or given, or each beat by itself where they vary."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.errors import InputError

from ..threads import single_threaded
from .beats import Beats, require_phases
from .harmonic_model import Normal, evaluate, highest
from .period import FEWEST, Found, strict_period, usual_period
from .record import Array, Record
from .rounding import converter_step
from .spikes import without_spikes
from .timing import without_jitter, without_slope
from .unequal import Whole, unequal
from .upstrokes import without_gaps

_WHOLE = 1e-6  # samples that the beats may slip against the samples over the whole record and still be reshaped
_UNSTEADY = 0.1  # of the period: beats longer or shorter by more are refused
_SLIP_OF_CUTS = 2.0  # samples by which a beat may be off the others where it was cut, its shape included
_SLIP = 0.02  # of a period over the whole record, by which a given period may differ from the one that is found
_VAGUE = 0.1  # of a beat, by which a given period may differ from the mean of beats that vary
_TURN = 8  # harmonics above N/8: half a sample is a sixteenth of a turn and more


@single_threaded
def align(record: Record, period: float | None = None) -> Beats:
    """The record as whole beats that start at its first sample, moved onto the strict period where they jitter.

    period : [s], by default found. Where beats are equal it is taken as it is, or several beats long; where they
    vary it says which beats are meant, and each is cut by itself. Equal beats have N = round(T/dt) samples; where T is
    no multiple of dt they are resampled by a harmonic model. Jitter is removed if it is significant.
    Raises ValueError if there is no period, or another one than the given, fewer than two whole beats, or a phase that
    a channel never measured.
    """
    dt, n = record.dt, len(record.time)
    if period is None:
        usual = usual_period(record.channels, record.dt, record.path)
        (T, whole), said = _near(record, usual), usual.said
    else:
        T, whole, said = _given(period, record)
    if whole is not None:
        return _cut(record, whole, said)
    f = dt / T
    N, n_beats = round(1.0 / f), int((n + 0.5) * f)  # half a sample of tolerance: noise must not cost the last beat
    if N < FEWEST:
        raise InputError(
            f"{record.path}: {1 / f:.2g} samples in a period of {T:.4g} s are too few; sample {FEWEST} times a beat or "
            f"more often, or check the unit of its time column."
        )
    if n_beats < 2:
        raise InputError(
            f"{record.path}: {n_beats} whole beat in {n * dt:.4g} s of record with a period of {T:.4g} s; "
            "record at least two whole beats."
        )
    record, spikes, steps = _cleaned(record, np.minimum(_nearest(f, N, n_beats), n - 1))
    if abs(N * f - 1.0) * n < _WHOLE and n_beats * N <= n:
        cut = {name: each[: n_beats * N].reshape(n_beats, N) for name, each in record.channels.items()}
        for name, each in cut.items():
            require_phases((~np.isnan(each)).sum(axis=0), name, record.path)
    else:
        cut = _resample(record, f, N, n_beats)
    values, shifts = without_jitter({name: without_slope(each) for name, each in cut.items()}, T)
    beats = Beats(record.path, record.sha256, T, values, shifts, spikes, steps, None, record.told, said)
    if beats.unsteadiness > _UNSTEADY:
        raise InputError(
            f"{record.path}: the heart rate is not steady: if cut every {T:.4g} s, a beat is shifted against the one "
            f"before by up to {beats.unsteadiness:.0%} of that, and more than {_UNSTEADY:.0%} cannot be aligned; "
            "use a stretch of the record with a steady rate."
        )
    return beats


def _nearest(f: float, N: int, n_beats: int) -> Array:
    """(n_beats, N) the sample that is nearest to each phase."""
    return np.rint(np.arange(n_beats * N) / (N * f)).astype(np.intp).reshape(n_beats, N)


def _cleaned(record: Record, samples: Array, slip: float = 0.0) -> tuple[Record, dict[str, int], dict[str, float]]:
    """The record with gaps for spikes, their numbers, and the steps of the channels' converters."""
    steps = {name: step for name, each in record.channels.items() if (step := converter_step(each)) > 0.0}
    cleaned = {
        name: without_spikes(each, samples, steps.get(name, 0.0), slip) for name, each in record.channels.items()
    }
    spikes = {name: count for name, (_, count) in cleaned.items() if count}
    return replace(record, channels={name: each for name, (each, _) in cleaned.items()}), spikes, steps


def _cut(record: Record, whole: Whole, said: tuple[str, ...]) -> Beats:
    """Beats of unequal length. Raises ValueError if fewer than two are left, or a phase was never measured."""
    samples = np.minimum(whole.edges[whole.serving][:, None] + np.arange(whole.N), len(record.time) - 1)
    record, spikes, steps = _cleaned(record, samples, _SLIP_OF_CUTS)
    values = {name: whole.of(each) for name, each in record.channels.items()}
    for name, each in values.items():
        require_phases((~np.isnan(each)).sum(axis=0), name, record.path)
    whole = replace(whole, channels={name: without_gaps(each) for name, each in record.channels.items()})
    shifts = np.zeros(len(whole.serving))
    return Beats(record.path, record.sha256, whole.T, values, shifts, spikes, steps, whole, record.told, said)


def _near(record: Record, usual: Found) -> tuple[float, Whole | None]:
    """The strict period near the usual one, or the beats if they vary. Raises ValueError if they cannot be told."""
    whole = unequal(record.channels, record.dt, usual.T)
    if whole is not None:
        return whole.T, whole
    T = strict_period(usual.T, record.channels, record.dt)
    if T is None:
        raise InputError(
            f"{record.path}: the heart rate is not steady: beats come every {usual.T:.3g} s or so, but no period fits "
            "the whole record, and their upstrokes are too unlike or too irregular to cut each by itself; "
            "use a stretch of the record with a steady rate."
        )
    return T, None


def _given(period: float, record: Record) -> tuple[float, Whole | None, tuple[str, ...]]:
    """The period that was given, or a whole number of beats, unless the record says otherwise; and beats that vary."""
    source, span = record.path, len(record.time) * record.dt
    if not (np.isfinite(period) and period > 0.0):
        raise InputError(f"{source}: period = {period!r} s: must be a positive, finite number.")
    if 2.0 * period > span * (1.0 + 1e-9):
        raise InputError(
            f"{source}: period = {period:.4g} s: longer than half of the {span:.4g} s of record; "
            "give a shorter one or record at least two whole beats."
        )
    if period < FEWEST * record.dt:
        return float(period), None, ()  # refused for that
    try:
        usual = usual_period(record.channels, record.dt, source)
        if abs(period / usual.other - 1.0) <= _VAGUE:  # which of the two it is, the record does not say
            usual = replace(usual, T=float(period))
        T, whole = _near(record, usual)
    except InputError:  # too irregular or too short to tell: then the word of the user counts
        whole = unequal(record.channels, record.dt, period)
        T = float(period) if whole is None else whole.T
    beats = period / T
    count = max(1, round(beats))
    slip = abs(beats / count - 1.0) * span / period
    if abs(beats - count) > _VAGUE if whole is not None else slip > _SLIP:
        raise InputError(
            f"{source}: period = {period:.4g} s: the record repeats every {T:.4g} s; give that, or leave it out."
        )
    said: tuple[str, ...] = ()
    if whole is not None and count > 1:
        said = (f"the given period of {period:.4g} s holds {count} beats; they vary, so that each was cut by itself.",)
    return float(period), whole, said


def _resample(record: Record, f: float, N: int, n_beats: int) -> dict[str, Array]:
    """The harmonic model at the phases j/N plus the residual of the nearest sample.

    The model carries the pulse exactly; the residual is moved by less than half a sample but not averaged, so that
    white noise keeps its variance. At high harmonics that little motion is a large part of a turn and would add noise
    to the mean beat; there the residual's mean is taken out again, and the mean beat is the model. At low harmonics it
    is needed: drift leaks into the model of a record that is no whole number of beats, the residual makes up for it.
    """
    n = len(record.time)
    nearest = np.minimum(_nearest(f, N, n_beats), n - 1)
    shared: Normal | None = None
    cut = {}
    for name, values in record.channels.items():
        there = ~np.isnan(values)
        whole = bool(there.all())
        require_phases(there[nearest].sum(axis=0), name, record.path)
        middle = values[there].mean()
        x = np.where(there, values - middle, 0.0)
        if whole and shared is None:
            shared = Normal.of(None, f, highest(f, n, n), n)
        measured = int(there.sum())
        normal = shared if whole and shared else Normal.of(there.astype(float), f, highest(f, n, measured), n)
        c = normal.solve(x)
        residual = values - middle - evaluate(c, f, n)
        moved = residual[nearest]
        spectrum = np.fft.rfft(moved.mean(axis=0) if whole else np.nanmean(moved, axis=0))
        spectrum[len(c) :] = spectrum[: N // _TURN] = 0.0
        cut[name] = moved - np.fft.irfft(spectrum, N) + (evaluate(c, 1.0 / N, N) + middle)
    return cut
