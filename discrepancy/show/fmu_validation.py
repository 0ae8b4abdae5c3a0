"""Free runs of FMUs through fmpy, and their gap to the record; ``discrepancy.name.confirmation`` tests a name by them.

The FMU is driven by the most probable wave, the inflow or the pressure of a bench, inferred from the whole record and
not only from its one noisy sensor. The gap is divided by the noise of sensors and drive: 1 is noise. The FMU is the
model that inference compared: one model has one gap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fitting.check.fmu_build import with_starts
from fitting.check.fmu_run import periodic_answer, read_fmu, steps_per_beat
from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Single
from fitting.inference.models.bench_observation import sense
from fitting.inference.models.network import NetworkProblem
from fitting.inference.models.simulator import as_shown
from fitting.records.alignment.beats import Beats
from fitting.records.channels.noise import check_flow_driven, pulses
from fitting.records.channels.spectral import interpolated
from fitting.records.recordings import changes, sizes
from solver import Settings, simulate
from solver.network.description import Network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW

from ..find.study import Study
from ..findings.outcome import Agreement
from ..thresholds import NO_GAP

_OWN_BEATS = 2
_AT_REST = 1e-4  # of a pressure: if all vary by less, there are no waves to compare
_OCTAVES = (2, 4, 8, 16)


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


# --- the gap, in units of the noise -----------------------------------------------------------------------------------
# The unit is the covariance of the fits, without the errors of solver and model. On fitted beats the gap is then the
# misfit of the fit, and on held-out beats the misfit that the fit predicts.


@dataclass(frozen=True)
class Gap:
    """Whitened RMS of all channels, and by channel, on (fitted, held-out) beats; rms : by channel, of the beat [SI];
    pulsation : the same without the means. The total whitens all channels jointly, because breathing moves their means
    together, and noise of the flow meter moves all their harmonics together. above : the same from harmonic 2, 4, 8 …
    on. in_error : the total in units of noise and stated error of the network together, if it has one."""

    total: tuple[float, float]
    channels: Mapping[str, tuple[float, float]]
    rms: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pulsation: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    above: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    in_error: tuple[float, float] | None = None

    @property
    def is_noise(self) -> bool:
        """True if held-out beats show nothing but noise and the stated error of the network."""
        return (self.in_error or self.total)[1] <= NO_GAP


def gap(study: Study, X: Array) -> Gap:
    """The gap between coefficients X : (K+1, m), after sensors, and the record."""
    K, names, stated = len(X) - 1, study.problem.signals, stated_error(study)
    lowest = [k for k in _OCTAVES if k <= K]
    total, in_error, each, rms, pulsation, above = [], [], [], [], [], []
    for part in (study.fitted, study.held_out):
        D = X - study.problem.repeated(part, study.fitted, K)
        units = _Units(study.problem.noise(part, study.fitted)[: K + 1])
        total.append(units.rms(D))
        in_error.append(units.beside(stated).rms(D))
        w = _weights(K)
        whitened, power = w * np.abs(D) ** 2 / units.variance, w * np.abs(D) ** 2
        each.append(np.sqrt(whitened.sum(axis=0) / w.sum()))
        rms.append(np.sqrt(power.sum(axis=0)))
        pulsation.append(np.sqrt(power[1:].sum(axis=0)))
        of_harmonics = units.power(D)
        above.append([math.sqrt(of_harmonics[k:].sum() / (len(names) * w[k:].sum())) for k in lowest])
    by_channel, of_beat, of_pulsation = (
        {name: (float(pair[0][i]), float(pair[1][i])) for i, name in enumerate(names)}
        for pair in (each, rms, pulsation)
    )
    return Gap(
        (total[0], total[1]), by_channel, of_beat, of_pulsation,
        dict(zip(lowest, zip(*above, strict=True), strict=True)),
        (in_error[0], in_error[1]) if stated.any() else None,
    )  # fmt: skip


def stated_error(study: Study) -> Array:
    """Standard deviation (m,) of the network's stated error, the same at every harmonic."""
    return np.asarray(study.problem.accuracy * pulses(study.fitted, study.problem.signals))


@dataclass(frozen=True)
class _Units:
    """covariance : (K+1, m, m) of the mean of some beats about a free run, with or without an error of the model."""

    covariance: Array

    def beside(self, error: Array) -> _Units:
        """With an error of the model of standard deviation (m,)."""
        return _Units(self.covariance + np.diag(error**2))

    @property
    def variance(self) -> Array:
        """(K+1, m) of each coefficient."""
        return np.einsum("kii->ki", self.covariance).real

    def weighted(self, D: Array) -> Array:
        """w C⁻¹ D of differences D : (K+1, m)."""
        sd = np.sqrt(self.variance)
        correlation = self.covariance / sd[:, :, None] / sd[:, None, :]
        return _weights(len(D) - 1) * np.linalg.solve(correlation, (D / sd)[..., None])[..., 0] / sd

    def power(self, D: Array) -> Array:
        """(K+1,) contributions of harmonics to χ²."""
        return np.asarray((D.conj() * self.weighted(D)).real.sum(axis=1))

    def rms(self, D: Array) -> float:
        """Root mean square of differences D : (K+1, m) in units of the noise."""
        K, m = len(D) - 1, D.shape[1]
        return math.sqrt(float(self.power(D).sum()) / (m * (2 * K + 1)))


def fall(study: Study, before: Array, after: Array) -> tuple[float, float]:
    """The decrease of χ² of the held-out beats from coefficients b to others a : (K+1, m), and its standard deviation.

    With y of the mean of n beats, Σ w ((b - y)† C⁻¹ (b - y) - (a - y)† C⁻¹ (a - y)) is linear in y: its noise is that
    of 2 Σ w Re((a - b)† C⁻¹ y), estimated from the scatter between beats, without the variation that follows the drive;
    that of the means, which drift, is C's. C : :class:`_Units` with the stated error of the network, which adds to that
    noise.
    """
    names, K, stated = study.problem.signals, len(before) - 1, stated_error(study)
    units = _Units(study.problem.noise(study.held_out, study.fitted)[: K + 1]).beside(stated)
    y = study.problem.repeated(study.held_out, study.fitted, K)
    value = float((units.power(before - y) - units.power(after - y)).sum())
    slope = 2.0 * units.weighted(after - before)
    scatter, free = 0.0, 0
    for part in (study.fitted, study.held_out):
        steady = study.problem.steady(part, study.fitted)
        pulsation = np.stack([_pulsation(steady, name, K) for name in names], axis=2)
        each = np.einsum("bki,ki->b", pulsation, slope[1:].conj()).real
        scatter += float(((each - each.mean()) ** 2).sum())
        free += len(each) - 1
    own = float((0.5 * np.abs(slope[1:]) ** 2 @ stated**2).sum())  # of a complex coefficient, half in its real part
    means = float((slope[0].conj() @ units.covariance[0] @ slope[0]).real)
    return value, math.sqrt(scatter / free / study.held_out.n_beats + own + means)


def _pulsation(part: Beats, name: str, K: int) -> Array:
    """(n_beats, K) coefficients 1 … K of the beats of a channel, with gaps filled by the mean beat."""
    beats = part.values[name]
    whole = np.where(np.isnan(beats), part.mean(name), beats)
    return np.fft.rfft(whole, norm="forward")[:, 1 : K + 1]


def _weights(K: int) -> Array:
    """(K+1, 1) 1 for the real mean, 2 for complex coefficients."""
    return np.where(np.arange(K + 1) == 0, 1.0, 2.0)[:, None]


def change(before: Gap, after: Gap) -> str:
    """The change of the gap to held-out beats, in words after the subject."""
    first, last = (number(each.total[1]) for each in (before, after))
    if first == last:
        return f"stays at {first}"
    return f"{'falls' if after.total[1] < before.total[1] else 'rises'} from {first} to {last}"


def changed(before: Gap, after: Gap) -> str:
    """The same with its unit and, in brackets, the RMS of channels before and after: "Ao.P from 1.3 to 0.9 mmHg"; of
    the pulsation if the means are most of a channel's RMS and a channel keeps more than half of its RMS, because means
    that wander count little in the gap."""
    stays = any(held_out(after.rms)[name] > 0.5 * x for name, x in held_out(before.rms).items())
    without = stays and (_of_means(before) or _of_means(after))
    first, last = (held_out(each.pulsation if without else each.rms) for each in (before, after))
    rms = changes(first, last, held_out(before.channels))
    text = f"rms without the means: {rms}" if without else rms
    return f"{change(before, after)} times the noise" + (f" ({text})" if rms else "")


def _of_means(gap: Gap) -> bool:
    """True if means are most of the RMS of a channel on held-out beats."""
    whole, pulsation = held_out(gap.rms), held_out(gap.pulsation)
    return any(pulsation[name] ** 2 < 0.5 * whole[name] ** 2 for name in pulsation)


def left(gap: Gap) -> str:
    """The gap to held-out beats with its unit and, in brackets, the RMS of the channels: "1.3 mmHg of Ao.P". The RMS
    without the means follows if the means are most of it for a channel: means wander between beats, and zeros of
    sensors may be off."""
    texts = [sizes(held_out(each), held_out(gap.channels)) for each in (gap.rms, gap.pulsation)]
    rms = "; without the means ".join(texts if _of_means(gap) else texts[:1])
    return f"{gap.total[1]:.3g} times the noise" + (f" ({rms})" if rms else "")


def held_out(pairs: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """The value on the held-out beats of each pair (fitted, held-out)."""
    return {name: pair[1] for name, pair in pairs.items()}
