"""Validation of a name by FMUs: free runs through fmpy, their gap to the record, and the test of the name.

The FMU is driven by the most probable wave, the inflow or the pressure of a bench, inferred from the whole record and
not only from its one noisy sensor. The gap is divided by the noise of sensors and drive: 1 is noise. No effect is named
that does not shrink the gap to held-out beats. The FMU is the model that inference compared: one model has one gap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, MMHG

from .. import thresholds as at
from ..find.study import Study
from ..findings.map_marks import label_text
from ..findings.outcome import Agreement
from ..findings.recorded import Recorded
from ..name.individual_walls import implausible
from ..name.verdict import Naming
from .gap import Gap, changed, gap

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


# --- the test of a name by the runs -----------------------------------------------------------------------------------


def confirmed(
    naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None, losses: Sequence[Mapping[str, float]] = ()
) -> Naming:
    """The naming if the free runs support it; otherwise without a name, with the numbers as the reason.

    The FMU with the effects must run. χ² of held-out beats must fall by more than chance over all recordings together
    and in each in which the effect has a d' of 12 (it then falls in 96 %), and rise by more than chance in none; the
    same holds for recordings held out as a whole. If the gap without the effects is only noise, the same test names an
    effect, because χ² reveals it before the gap of all data does. The test names no partial effect then, and none in a
    network with a stated error, which may take any form. A partial effect must close most of the gap. A verdict
    ``none`` becomes unknown if the model explains the record only with implausible parameters, or if it is a first
    model, whose radii are free, and a mean pressure falls by more than arteries make it.

    each : results per recording. before, after : over all fitted ones. losses : of mean pressure
    [Pa] by channel that are larger than in arteries, per recording.
    """
    naming = _borne_out(naming, each, before, after)
    if naming.verdict != "none":
        return naming
    if odd := implausible(naming.base.fit):
        return _only_with(naming, _far(odd), "it is another subject, or the catalogue lacks the effect")
    largest = {name: max(each.get(name, 0.0) for each in losses) for each in losses for name in each}
    if largest:
        lost = " and ".join(f"{x / MMHG:.2g} mmHg on the way to {name}" for name, x in largest.items())
        consequence = "the zero or the height of a sensor is off, or an artery is narrowed"
        return _only_with(naming, f"arteries so narrow that the mean pressure falls by {lost}", consequence)
    return naming


def _borne_out(naming: Naming, each: Sequence[Recorded], before: Gap, after: Gap | None) -> Naming:
    best, left = label_text(naming.best.label), before.total[1]
    none = naming.verdict == "none"
    failed = "" if before.is_noise else next((r.failed for r in each if r.failed and (none or r.gap_after is None)), "")
    if failed and none:
        return _without(naming, "unknown", f"the model fits the record, but this cannot be judged: {failed}")
    if not naming.adds and naming.verdict != "unknown":
        return naming
    fitted, unseen = ([r for r in each if r.fitted is mine] for mine in (True, False))
    why = "" if after is None else not_fallen(fitted, len(each) > 1) or not_fallen(unseen)
    if before.is_noise and (after is None or why or before.in_error is not None or naming.verdict == "partial"):
        found = f"{best} was found but not named" if after else "no effect was named"
        more = "no more than noise"
        if before.in_error is not None:
            more = f"{before.in_error[1]:.3g} times noise and stated error of the model together"
        reason = f"{found}: without it the gap to held-out beats is {left:.3g} times the noise, {more}"
        return _without(naming, "none", reason)
    if failed:
        nearest = f"{best} comes nearest, but cannot be judged" if naming.best.label else "no effect can be judged"
        return _without(naming, "unknown", f"{nearest}: {failed}")
    if after is None:
        return naming
    if not why and naming.verdict == "partial" and after.total[1] > (1.0 - at.PART_CLOSED) * left:
        why = "most of it remains" + _closed_above(before, after)
    if why:
        nearest = f"{best} comes nearest, but with it the gap of the FMU to held-out beats {changed(before, after)}"
        return _without(naming, "unknown", f"{nearest}: {why}")
    return naming


def _closed_above(before: Gap, after: Gap) -> str:
    """The lowest harmonic from which on an effect closes most of the gap, in words; "" if it does so nowhere.

    An effect of high harmonics, such as that of a catheter, is hidden in the whole gap by a network that is wrong in
    the low ones.
    """
    for k, (_, first) in before.above.items():
        last = after.above.get(k, (math.inf, math.inf))[1]
        if first > at.NO_GAP and last <= (1.0 - at.PART_CLOSED) * first:
            return f", but from harmonic {k} on it falls from {number(first)} to {number(last)} times the noise"
    return ""


def not_fallen(each: Sequence[Recorded], labelled: bool = True) -> str:
    """The reason why some recordings do not support a name or a law; "" if they do, or if there are none."""
    compared = [(r, r.fallen, r.sd) for r in each if r.fallen is not None and r.sd is not None]
    if not compared:
        return ""
    fallen, sd = sum(f for _, f, _ in compared), math.sqrt(sum(s**2 for _, _, s in compared))
    if fallen <= at.FALL * sd:
        over = f"over {', '.join(r.label for r, _, _ in compared)} " if labelled else ""
        return over + _no_fall(fallen, sd)
    for r, own, spread in compared:
        if own < -at.FALL * spread or ((r.d or 0.0) >= at.VISIBLE and own <= at.FALL * spread):
            return f"in {r.label} {_no_fall(own, spread)}"
    return ""


def _only_with(naming: Naming, implausible_values: str, consequence: str) -> Naming:
    """The verdict ``unknown`` of a model that explains the record only with implausible values."""
    reason = f"the model fits the record only with {implausible_values}"
    sentence = f"{reason[0].upper()}{reason[1:]}: {consequence}."
    return replace(_without(naming, "unknown", reason), only_with=sentence)


def _far(odd: Mapping[str, float]) -> str:
    """Implausible parameters with their distances in stated spreads, in words."""
    them = ", ".join(f"{name} {abs(x):.2g} stated spreads {'above' if x > 0 else 'below'}" for name, x in odd.items())
    return f"{them} the file's"


def _no_fall(fallen: float, sd: float) -> str:
    """The change of χ² of the held-out beats with its standard deviation, if it does not fall by more than chance."""
    if fallen < -at.FALL * sd:
        return f"chi2 rises by {-fallen:.3g} ± {sd:.2g}"
    return f"chi2 {'rises' if fallen < 0.0 else 'falls'} by {abs(fallen):.3g} ± {sd:.2g}, no more than chance"


def _without(naming: Naming, verdict: str, reason: str) -> Naming:
    """The naming without a name. The confidence is the probability that the name was wrong, at most INCOMPLETE."""
    doubt = 1.0 - naming.confidence if naming.adds else naming.confidence
    return replace(naming, verdict=verdict, members=(), confidence=min(doubt, at.INCOMPLETE), reason=reason)


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
