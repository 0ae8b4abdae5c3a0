"""Free runs of FMUs through fmpy, and their gap to the record; ``discrepancy.name.confirmation`` tests a name by them.

The FMU is driven by the most probable wave, the inflow or the pressure of a bench, inferred from the whole record and
not only from its one noisy sensor. The gap is divided by the noise of sensors and drive: 1 is noise. The FMU is the
model that inference compared: one model has one gap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fitting.check.fmu_build import with_starts
from fitting.check.fmu_run import periodic_answer, read_fmu, steps_per_beat
from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Single
from fitting.inference.models.bench_observation import sense
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.simulator import as_shown
from fitting.records.channels.noise import check_flow_driven
from fitting.records.channels.spectral import interpolated
from solver import Settings, simulate
from solver.network.description import Network
from solver.quantities.units import INFLOW

from ..find.study import Study
from ..findings.outcome import Agreement
from .gap import Gap, gap

_OWN_BEATS = 2
_AT_REST = 1e-4  # of a pressure: if all vary by less, there are no waves to compare


@dataclass(frozen=True)
class Run:
    """A free run. X : (K+1, m) coefficients of the channels after their sensors, beats : (N,) each. stands_in : its
    origin, if it is not that of an FMU with the walls of the fit."""

    X: Array
    beats: Mapping[str, Array]
    gap: Gap
    stands_in: str = ""


def free_run(fmu: Path, study: Study, fit: Fit, wave: Array, starts: Mapping[str, float]) -> Run:
    """Run an FMU under a wave and compare it with the record. ``fit`` gives the sensor model; starts : by FMU variable.

    Raises RunFailed with the FMU's sentence.
    """
    described, T = read_fmu(fmu), study.fitted.T
    names = study.problem.signals
    values: dict[str, float | str] = {
        n: v for n, v in starts.items() if n in (*described.parameters, *described.inputs)
    }
    drive = study.problem.driven(wave)
    values.update(drive.values)
    with with_starts(described, values) as running:
        answer = periodic_answer(running, drive.variable, wave, T, values, drive.beats)
    waves = dict(answer.values)
    if drive.imposed is not None:
        waves[drive.imposed] = interpolated(wave, steps_per_beat(described, T))
    return compared(study, fit, np.stack([np.fft.rfft(waves[n], norm="forward") for n in names], axis=1))


def compared(study: Study, fit: Fit, X: Array) -> Run:
    """The run with coefficients X : (n, m) as the FMU gives them."""
    names, T = study.problem.signals, study.fitted.T
    X = X[: study.problem.K + 1]
    return of_coefficients(study, sense(fit.member, names, as_shown(study.problem.network, names, T, X), T))


def of_coefficients(study: Study, X: Array, stands_in: str = "") -> Run:
    """The run with coefficients X : (n, m) of the channels after their sensors and known filters."""
    X = X[: study.problem.K + 1]
    beats = np.fft.irfft(X, study.fitted.N, axis=0, norm="forward").T
    return Run(X, dict(zip(study.problem.signals, beats, strict=True)), gap(study, X), stands_in)


def parity(fmu: Path, network: Network) -> float | None:
    """Largest difference of an FMU from the direct solver over two beats from rest under the network's own inflow, as a
    fraction of an output's pulse. None if that inflow causes no motion: any two networks at rest agree.

    Raises RunFailed with the FMU's sentence, NonPhysicalState if the solution breaks down, ValueError if a pressure
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


def agreement(study: Study, fit: Fit, wave: Array, run: Run) -> Agreement | None:
    """An FMU's run against the inferred solution of the same hypothesis under the same wave; None if there is none.

    Both solve the same equations, by time steps and by harmonic balance, and are compared with equal elements: those of
    the search may be shorter. The gap is that of the search. What stands in for a run is not compared.
    """
    X, same = (None if run.stands_in else each.answer(wave, fit) for each in (study.problem, _as_built(study.problem)))
    if X is None or same is None:
        return None
    X = X[: len(run.X)]
    pulse = np.array([np.ptp(study.fitted.mean(name)) for name in study.problem.signals])
    apart = np.abs(run.X - same[: len(run.X)]) / pulse
    k, i = (int(n) for n in np.unravel_index(int(apart.argmax()), apart.shape))
    return Agreement(float(apart[k, i]), study.problem.signals[i], k, run.gap.total, gap(study, X).total)


def _as_built(problem: Single) -> Single:
    """The same with the elements of an FMU."""
    if not isinstance(problem, NetworkProblem):
        return problem
    settings = replace(problem.simulator.settings, element_length=Settings().element_length)
    return replace(problem, simulator=replace(problem.simulator, settings=settings, lengths=None))
