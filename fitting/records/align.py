"""A record cut into aligned beats: at a period that is found or given, or each beat by itself where they vary."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver.errors import InputError

from ..threads import single_threaded
from . import thresholds as limit
from .beats import Beats, require_phases
from .harmonic_model import evaluate, harmonics
from .period import strict_period, usual_period
from .record import Array, Record
from .rounding import converter_step
from .spikes import without_spikes
from .timing import without_jitter, without_slope
from .unequal import Whole, unequal
from .upstrokes import without_gaps


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
    cleaned = {name: without_spikes(x, samples, steps.get(name, 0.0), slip) for name, x in record.channels.items()}
    spikes = {name: count for name, (_, count) in cleaned.items() if count}
    channels = {name: each for name, (each, _) in cleaned.items()}
    for name, each in channels.items():
        require_phases((~np.isnan(each[samples])).sum(axis=0), name, record.path)
    if whole is None:
        equal = {name: without_slope(_equal(each, record.dt / T, samples)) for name, each in channels.items()}
        values, shifts = without_jitter(equal, T)
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
    if abs(beats - count) > limit.NEAR if whole is not None else slip > limit.SLIP:
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
