"""Show: free runs of FMUs through fmpy, and the gap that they leave to the record, channel by channel.

The FMU is driven by the most probable wave: the inflow, or the pressure of a bench, as the whole record says it
was, not only the one noisy sensor. What is left is divided by the sensors' own noise: 1 is noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fitting.fmu_run import fourier, periodic_answer, read_fmu, steps_per_beat
from fitting.inference.fit import Fit
from fitting.inference.observation import mean_wander, sense
from fitting.records.noise import check_flow_driven
from fitting.records.spectral import shift
from solver import Settings, simulate, simulate_periodic
from solver.network import Network
from solver.units import INFLOW

from .study import Study

Array = np.ndarray

_OWN_BEATS = 2
_AT_REST = 1e-4  # of a pressure: where none varies by more, there are no waves to compare


@dataclass(frozen=True)
class Gap:
    """Whitened RMS of all channels, and by channel, on (fitted, held-out) beats."""

    total: tuple[float, float]
    channels: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Run:
    """A free run: X : (K+1, m) coefficients of the channels as their sensors show them, beats : (N,) each."""

    X: Array
    beats: Mapping[str, Array]
    gap: Gap


def free_run(fmu: Path, study: Study, fit: Fit, wave: Array, starts: Mapping[str, float]) -> Run:
    """Run an FMU under a wave and compare it. ``fit`` says what the sensors do; starts : by FMU variable.

    Raises RunFailed with the FMU's sentence.
    """
    described, T = read_fmu(fmu), study.fitted.T
    names = study.problem.signals
    values: dict[str, float | str] = {
        n: v for n, v in starts.items() if n in (*described.parameters, *described.inputs)
    }
    drive = study.problem.driven(wave)
    values.update(drive.values)
    rolled = np.roll(wave, -drive.first)
    answer = periodic_answer(described, drive.variable, rolled, T, values, drive.beats)
    waves = {name: shift(beat, drive.first / len(wave)) for name, beat in answer.values.items()}
    if drive.imposed is not None:
        waves[drive.imposed] = fourier(wave, steps_per_beat(described, T))
    return compared(study, fit, np.stack([np.fft.rfft(waves[n], norm="forward") for n in names], axis=1))


def compared(study: Study, fit: Fit, X: Array) -> Run:
    """The run of coefficients X : (n, m) as the FMU gives them."""
    problem, names = study.problem, study.problem.signals
    K = min(problem.K, len(X) - 1)
    X = sensed(study, fit, X[: K + 1])
    beats = {name: np.fft.irfft(x, study.fitted.N, norm="forward") for name, x in zip(names, X.T, strict=True)}
    S = np.einsum("kii->ki", study.fitted.covariance(names)).real[: K + 1]
    parts = []
    for part in (study.fitted, study.held_out):
        noise = S * (study.fitted.n_beats / part.n_beats)
        if part is not study.fitted:
            noise[0] = np.maximum(noise[0], mean_wander(part, study.fitted, names))
        parts.append(np.abs(X - problem.repeated(part, study.fitted, K)) ** 2 / np.maximum(noise, 1e-300))
    weight = np.where(np.arange(K + 1) == 0, 1.0, 2.0)[:, None]
    each = [np.sqrt((weight * p).sum(axis=0) / weight.sum()) for p in parts]
    total = tuple(float(np.sqrt(np.mean(e**2))) for e in each)
    by_channel = {n: (float(each[0][i]), float(each[1][i])) for i, n in enumerate(names)}
    return Run(X, beats, Gap((total[0], total[1]), by_channel))


def sensed(study: Study, fit: Fit, X: Array) -> Array:
    """What the measurement chain of a hypothesis makes of the coefficients."""
    return sense(fit.member, study.problem.signals, X, study.fitted.T)


def parity(network: Network, study: Study, wave: Array, run: Run, settings: Settings) -> float:
    """Largest difference of the FMU's free run (without sensors) from the direct solver, of a channel's pulse."""
    T, names = study.fitted.T, study.problem.signals
    N, k = len(wave), np.arange(len(wave) // 2 + 1)
    amplitude = np.fft.rfft(wave, norm="forward") * np.where((k > 0) & (2 * k != N), 2.0, 1.0)

    def inflow(t: Array) -> Array:
        return np.asarray((np.exp(2j * np.pi * np.mod(np.asarray(t) / T, 1.0)[..., None] * k) @ amplitude).real)

    beat = simulate_periodic(network, inflow, T, settings=settings, tolerance=1e-5)
    worst = 0.0
    for i, name in enumerate(names):
        X = np.fft.rfft(beat[name][:-1], norm="forward")[: len(run.X)]
        worst = max(worst, float(np.abs(X - run.X[:, i])[1:].max() / np.ptp(beat[name])))
    return worst


def own_parity(fmu: Path, network: Network) -> float | None:
    """Largest difference of an FMU from the direct solver over two beats from rest under the network's own inflow.

    Of an output's pulse; for an FMU that no record drives: that of a network of which one artery was on the bench.
    None where that inflow moves nothing: of two networks at rest, any two agree.
    Raises RunFailed with the FMU's sentence, NonPhysicalState if the solution breaks down, ValueError where a pressure
    drives the inlet.
    """
    check_flow_driven(network)
    described, T = read_fmu(fmu), network.inlet.T
    n = steps_per_beat(described, T)
    time = np.arange(n) * (T / n)
    wave = network.inlet.Q(time)
    answer = periodic_answer(described, INFLOW, wave, T, {}, _OWN_BEATS)

    def inflow(t: Array) -> Array:  # as the FMU interpolates its input
        return np.interp(t, time, wave, period=T)

    run = simulate(network, inflow, _OWN_BEATS * T, settings=Settings(dt=T / n))
    last = slice((_OWN_BEATS - 1) * n, _OWN_BEATS * n)
    pressures = [run[name][last] for name in answer.values if name.endswith(".P")]
    if all(np.ptp(P) <= _AT_REST * np.abs(P).max() for P in pressures):
        return None
    worst = 0.0
    for name, values in answer.values.items():
        direct = run[name][last]
        size = float(np.ptp(direct)) or float(np.abs(direct).max())
        worst = max(worst, float(np.abs(values - direct).max()) / size if size > 0.0 else 0.0)
    return worst
