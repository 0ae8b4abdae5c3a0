"""Plausibility of record and model together: wrong units, clocks and dead sensors are refused in one sentence each."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from fitting.inference.fit import Array
from fitting.records.alignment.period import repeats, usual_period
from fitting.records.limits import SURE
from fitting.records.read.record import Record
from solver.errors import InputError

from .study import Study, Unusable

_PERIODS = 0.02  # relative difference between the heart periods of two channels
_LATE = 0.08  # of the period: largest accepted shift of a channel from its best correlation
_ALIKE = 0.9  # least correlation at the best shift: the waveform is that of the artery and only its time is wrong
_MORE_ALIKE = 0.15  # least gain of correlation by the shift
_SIZE = {"P": 6.0, "Q": 25.0, "R": 6.0}  # limits of a channel's pulse over the model's; hidden effects stay below
_STRANGE = 0.5  # correlation of the median channel below which the waves are not of this network
_DEAD = 0.05  # of the usual pulse of a beat: a sensor with less is dead
_DEAD_FOR = 0.125  # fraction of dead beats that is refused


def check_record(record: Record) -> None:
    """Raise Unusable unless there is one period after which all channels repeat.

    The period that a channel shows by itself may be a part of it, as of a pulse that rings, or several, as of beats
    that alternate.
    """
    periods = {}
    for name, values in record.channels.items():
        try:
            periods[name] = usual_period({name: values}, record.dt, record.path).T
        except InputError:  # too noisy by itself; the channels together may have a period
            continue
    if not periods or any(
        all(_repeats(record, name, own, T) for name, own in periods.items()) for T in periods.values()
    ):
        return
    middle = float(np.median(list(periods.values())))
    name, T = max(periods.items(), key=lambda item: abs(math.log(item[1] / middle)))
    raise Unusable(
        f"{record.path}: channel {name} repeats every {T:.4g} s, the others every {middle:.4g} s: they were "
        f"not recorded together, or one clock is wrong; record all channels at once."
    )


def _repeats(record: Record, name: str, own: float, T: float) -> bool:
    """True if a channel, whose own period is ``own`` [s], repeats after T [s], as far as its beats tell: those of a
    fibrillating heart do not to 2 %."""
    if abs(T / own - max(round(T / own), 1)) <= _PERIODS:
        return True
    near, error = repeats(record.channels[name], record.dt, T)
    return abs(near - T) <= max(_PERIODS * T, SURE * error)


def check_beats(study: Study) -> None:
    """Raise Unusable if a sensor was dead for an eighth of the beats."""
    for name in study.fitted.values:
        beats = np.concatenate([study.fitted.values[name], study.held_out.values[name]])
        pulse = np.nanstd(beats, axis=1)
        dead = pulse < _DEAD * np.nanmedian(pulse)
        if dead.mean() > _DEAD_FOR:
            raise Unusable(
                f"{study.fitted.source}: channel {name} is flat in {int(dead.sum())} of {len(dead)} beats: its "
                f"sensor was dead there; leave these samples empty or leave the channel out."
            )


def check_waves(study: Study, simulated: Mapping[str, Array]) -> None:
    """Raise Unusable if the measured beats do not match this network in size, time or shape.

    simulated : (N,) beats of the model as given, by channel.
    """
    source, fits = study.fitted.source, {}
    for name in study.problem.signals:
        measured, model, largest = study.fitted.mean(name), simulated[name], _SIZE[name.rpartition(".")[2]]
        ratio = float(np.std(measured) / max(np.std(model), 1e-300))
        if not 1.0 / largest < ratio < largest:
            raise Unusable(
                f"{source}: the pulse of {name} is {ratio:.3g} times that of the model: a wrong unit, or a record of "
                "another network; check the column's unit and the network file."
            )
        fits[name] = _best_shift(measured, model)
    late = {
        name: shift * study.fitted.T
        for name, (shift, best, without) in fits.items()
        if abs(shift) > _LATE and best > _ALIKE and best - without > _MORE_ALIKE
    }
    if late:
        name, lag = max(late.items(), key=lambda item: abs(item[1]))
        others = f", and so do {len(late) - 1} more channels" if len(late) > 1 else ""
        raise Unusable(
            f"{source}: {name} comes {abs(lag) * 1e3:.0f} ms too {'late' if lag > 0.0 else 'early'} against what "
            f"drives the model{others}: the channels are not synchronised; shift them onto one clock."
        )
    middle = float(np.median([without for _, _, without in fits.values()]))
    if study.site is None and middle < _STRANGE:
        raise Unusable(
            f"{source}: its waves do not resemble those of network {study.network.name} (correlation about "
            f"{middle:.2f}); check that the record is of this network and that inlet.Q is the flow into it."
        )


def _best_shift(measured: Array, model: Array) -> tuple[float, float, float]:
    """The delay of the measured beat in periods at the best correlation, this correlation, and that without shift."""
    a, b = np.fft.rfft(measured - measured.mean()), np.fft.rfft(model - model.mean())
    size = float(np.linalg.norm(measured - measured.mean()) * np.linalg.norm(model - model.mean()))
    correlation = np.fft.irfft(a * np.conj(b), len(measured)) / max(size, 1e-300)
    at = int(np.argmax(correlation))
    shift = (at if at <= len(measured) // 2 else at - len(measured)) / len(measured)
    return shift, float(correlation[at]), float(correlation[0])
