"""A record cut into aligned beats: at a period that is found or given, or each beat by itself where they vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from solver.errors import InputError

from ...parallel.threads import single_threaded
from .. import limits
from ..read.record import Array, Record
from ..read.sensors import converter_step, without_gaps
from .beats import Beats, require_phases
from .equal_beats import Grid, check_steady, grid, strict_period, without_jitter
from .period import PeriodFound, usual_period
from .sensor_faults import limited_sensors, without_spikes
from .variable_beats import VariableBeats, cut_variable, find_upstrokes


@single_threaded
def align(record: Record, period: float | None = None) -> Beats:
    """The record as whole beats, moved onto the strict period where they jitter.

    Equal beats start at the first sample of the record, variable ones at the feet of their upstrokes.

    period : [s], by default found. A period of equal beats is used exactly, and may span several beats. If beats vary,
    it only identifies the beats, and each is cut by itself. Equal beats have N = round(T/dt) samples; where T is no
    multiple of dt they are resampled by a harmonic model. Jitter is removed if it is significant. Raises ValueError if
    there is no period, or another one than the given, fewer than two whole beats, or a phase that a channel never
    measured.
    """
    if period is not None:
        _check(period, record)
    steps = {name: step for name, x in record.channels.items() if (step := converter_step(x)) > 0.0}
    cut, T, notes = _cut(record, period, steps)
    channels, spikes = without_spikes(record.channels, cut, steps)
    for name, x in channels.items():
        require_phases((~np.isnan(x[cut.samples])).sum(axis=0), name, record.path)
    values: Mapping[str, Array] = {name: cut.of(x) for name, x in channels.items()}
    shifts, singly = np.zeros(len(cut.samples)), None
    if isinstance(cut, VariableBeats):
        singly = replace(cut, channels={name: without_gaps(x) for name, x in channels.items()})
    else:
        values, shifts = without_jitter(values, T)
    notes = (*record.said, *notes, *limited_sensors(record.channels, values, steps, T))
    beats = Beats(record.path, record.sha256, T, values, shifts, spikes, steps, singly, record.told, notes)
    check_steady(beats.unsteadiness, T, record.path)
    return beats


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
    if period < limits.FEWEST_SAMPLES * record.dt:
        grid(period, record.dt, len(record.time), record.path)


def _cut(
    record: Record, period: float | None, steps: Mapping[str, float]
) -> tuple[VariableBeats | Grid, float, tuple[str, ...]]:
    """The cut of the record, its period [s], and notes on doubts.

    Raises ValueError if the period cannot be determined, or is neither the given one nor a whole part of it.
    """
    channels, dt, source, n = record.channels, record.dt, record.path, len(record.time)
    try:
        usual = usual_period(channels, dt, source)
    except InputError:  # too irregular or too short to tell: then the word of the user counts
        if period is None:
            raise
        usual, stated = PeriodFound(period), False
    else:
        stated = True
    if period is not None and abs(period / usual.other - 1.0) <= limits.NEAR:  # the record does not tell which
        usual = replace(usual, T=period)
    found = find_upstrokes(channels, usual.T / dt)
    singly, T = None if found is None else cut_variable(channels, dt, found), usual.T
    if singly is not None:
        T = singly.T
    elif stated:
        T = T if found is None else dt * found.line[0]
        ordinary, _ = without_spikes(channels, grid(T, dt, n, source), steps)
        T = strict_period(ordinary, dt, T, source)
    notes = usual.said
    if period is not None:
        count = max(1, round(period / T))
        off = abs(period / T - count)
        if off > limits.NEAR if singly is not None else off / count * n * dt / period > limits.VARIES:
            raise InputError(
                f"{source}: period = {period:.4g} s: the record repeats every {T:.4g} s; give that, or leave it out."
            )
        notes = ()
        if singly is None:
            T = float(period)
        elif count > 1:
            notes = (
                f"the given period of {period:.4g} s holds {count} beats; they vary, so that each was cut by itself.",
            )
    return singly or grid(T, dt, n, source), T, notes
