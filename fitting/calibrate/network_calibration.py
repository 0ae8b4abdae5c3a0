"""Network calibration: parameters of a whole network from a record of its inflow and of P, Q and R at some sites.

Gauss–Newton on the whitened harmonics of :mod:`fitting.records.channels.noise`. With the residual z(x), unknowns x
relative to the network's own values and Gaussian priors of standard deviation s, it minimises

    |z(x)|² + Σ (x_i/s_i)²

One batch of harmonic balances gives z and its derivatives, by finite differences. A model error of the channels
represents missing physics; its size is estimated alternately with x (:mod:`fitting.inference.joint.model_error`). A
first search approaches the minimum. There, a halved element length measures the solver's own error, and the response to
the inflow's noise is computed; a second search with these weights gives the result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from solver import Settings
from solver.errors import InputError
from solver.network.description import Network
from solver.quantities.legible import number
from solver.quantities.units import INFLOW, of_signal
from solver.simulate import Progress

from ..inference.fit import Array, Fit
from ..inference.gauss_newton import Rules
from ..inference.intervals import Determined, sentences
from ..inference.joint.calibration import DERIVATIVE_ERROR, Problem, recorded, widening
from ..inference.joint.joint_record import Several
from ..inference.joint.model_error import CHANCE, MEANS, Ended, granted, minimum
from ..inference.models.simulator import Simulator
from ..inference.runs import Meter, Runs
from ..inference.unknown import Unknown, bounds, parameter_intervals, parameter_values, split_zeros
from ..inference.unknown_text import parse_unknowns, varied
from ..parallel.threads import single_threaded
from ..records.alignment.beats import Beats
from ..records.channels.noise import check_flow_driven, harmonics_above_noise, pulses, solver_error
from ..records.limits import MAX_HARMONICS
from ..records.recordings import labels_of, size_text, sizes
from .calibrated import ALL_PRIOR, Calibration, Recording, noise_known
from .first_search import ROUGH, first_search, late_flow

# Gain at which a search ends, as squared fractions of a standard deviation. From a tenth, one step with the second
# weights reaches the minimum; a hundredth is negligible. If the model lacks more than noise, a tenth is, too
_NEAR, _SETTLED = 1e-2, 1e-4
_FEWEST_STEPS = 20  # of the solver in a beat


@single_threaded
def calibrate(
    beats: Beats | Sequence[Beats],
    network: Network,
    unknowns: Iterable[str | Unknown],
    *,
    varies: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    settings: Settings | None = None,
    max_iterations: int = 40,
    x0: Array | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find the unknowns ("all.E", "CA.phi0:0.1", "CA.outlet.R_t:none" …) of a network from recordings of it.

    beats : recordings with inlet.Q and channels named as the network's outputs; ``channels`` selects some, default all.
    varies : unknowns with a value for each recording, "*.outlet.R2"; others, walls and geometry, are common.
    settings : of the solver: the element length, and dt, default 1 ms, for networks too large for harmonic balance.
    x0 : (p,) start of the search (:mod:`fitting.calibrate.multistart` uses many). Default: the network's own values,
    and if these have no periodic beat, or the search ends far from the record, up to 8 other starts. progress : called
    with a fraction of the work and a label.
    Raises ValueError, one sentence, for unknowns or channels that the network does not have, a record without inlet.Q
    or with a phase that was never measured, a beat shorter than 20 steps, and a network that fails with this inflow
    from every start.
    """
    started = time.perf_counter()
    settings = settings or Settings()
    given = [beats] if isinstance(beats, Beats) else list(beats)
    found = parse_unknowns(unknowns, network)
    check_flow_driven(network)
    stages = _Stages(progress)
    meter = Meter(stages.simulated)
    labels = labels_of([each.source for each in given])
    everything, records = varied(found, varies, labels), list[tuple[Beats, Simulator]]()
    for each in given:
        names = _channels(each, network, channels)
        records.append(recorded(each, network, names, _harmonics(each, names, settings), settings))
    problem = Problem(everything, tuple(records), Several((), tuple(labels)), Runs(meter))

    stages.begin(0.0, 0.6, "first search")
    rules = Rules(_NEAR, math.inf, max_iterations, error=DERIVATIVE_ERROR)
    first, near, notes = first_search(problem, x0, rules)

    stages.begin(0.6, 1.0, "second search")
    first, near = _cut(first, near)
    last, unmeasured = _weighted(first, near.fit)
    rules = rules if near.errors.any() else replace(rules, gain=_SETTLED)
    best = minimum(last.whole, last.whole.restated([near.fit], first.whole)[0], rules, last.runs)
    notes = [*notes, *unmeasured, *late_flow(last, best, replace(rules, gain=ROUGH))]
    if progress:
        progress(1.0, "done")
    return _result(last, near, best, notes, labels, found, meter, time.perf_counter() - started)


def _cut(problem: Problem, near: Ended) -> tuple[Problem, Ended]:
    """The problem and the end of its search with elements for the lengths there: the search kept those of its start."""
    if not any(name.endswith(".L") for u in problem.unknowns for name in u.variables):  # moves no elements
        return problem, near
    errors = [part.error for part in problem.parts]
    problem = problem.cut(near.fit.x).weighted(near.fit.x, errors)
    return problem, replace(near, fit=problem.at(near.fit.x))


def _weighted(problem: Problem, near: Fit) -> tuple[Problem, list[str]]:
    """The problem with the weights at the end of the first search, including the solver's own error."""
    errors, unmeasured = [], list[str]()
    for i, (part, rows) in enumerate(zip(problem.parts, problem.whole.rows, strict=True)):
        X = part.target.X + part.target.unwhiten(near.z[rows, None])[..., 0]
        finer = replace(part, simulator=part.simulator.finer())
        (X_finer,) = finer.observe([problem.whole.member(near.member, i)], problem.runs)
        if X_finer is None:
            errors.append(part.error)
            unmeasured = ["no beat was found with shorter elements, so the solver's own error was not measured"]
        else:
            errors.append(solver_error(X, X_finer, pulses(part.beats, part.signals)))
    return problem.weighted(near.x, errors), unmeasured


# --- the record ----------------------------------------------------------------------------------------------------


def _channels(beats: Beats, network: Network, chosen: Sequence[str] | None) -> tuple[str, ...]:
    if INFLOW not in beats.values:
        raise InputError(
            f"{beats.source}: it has no {INFLOW}, which drives the simulation; record the inflow, or fit the wall of "
            "one site from its P and R."
        )
    recorded = [name for name in beats.values if name != INFLOW]
    names = tuple(recorded if chosen is None else chosen)
    for name in names:
        if name not in recorded:
            raise InputError(f"channel {name}: {beats.source} has no such channel; it has {', '.join(recorded)}.")
        if name not in network.output_units():
            sites = ", ".join(site.name for site in network.sites)
            raise InputError(
                f"{beats.source}: its channel {name} is no output of network {network.name} (sites {sites}); "
                "add the site to the network or choose other channels."
            )
    if not names:
        raise InputError(f"{beats.source}: it has no channel but {INFLOW}; P, Q or R at one site at least is needed.")
    return names


def _harmonics(beats: Beats, names: Sequence[str], settings: Settings) -> int:
    """K: the highest harmonic of any channel above its noise that both record and solver resolve, at most 40."""
    steps = math.ceil(beats.T / settings.dt - 1e-9)
    if steps < _FEWEST_STEPS:
        raise InputError(
            f"{beats.source}: its period of {beats.T:g} s has {steps} steps of {settings.dt:g} s, fewer than "
            f"{_FEWEST_STEPS}; choose a smaller dt or check the unit of its time."
        )
    return harmonics_above_noise(beats, names, min(MAX_HARMONICS, (beats.N - 1) // 2, steps // 2 - 1))


# --- its stages ---------------------------------------------------------------------------------------------------


class _Stages:
    """Reports the progress of each stage of the search, which takes about four simulations."""

    def __init__(self, progress: Progress | None) -> None:
        self.progress = progress
        self.begin(0.0, 1.0, "")

    def begin(self, low: float, high: float, label: str) -> None:
        self.span, self.label, self.done = (low, high), label, 0

    def simulated(self, _: int) -> None:
        self.done += 1
        if self.progress:
            low, high = self.span
            self.progress(low + (high - low) * (1.0 - 0.6**self.done), f"{self.label}, simulation {self.done}")


# --- the result ---------------------------------------------------------------------------------------------------


def _result(
    problem: Problem, near: Ended, best: Ended, notes: Sequence[str], labels: Sequence[str],
    asked: Sequence[Unknown], meter: Meter, seconds: float,
) -> Calibration:  # fmt: skip
    x, unknowns, network = best.fit.x, problem.unknowns, problem.parts[0].network
    chi2 = best.fit.chi2  # of the noise alone
    dof = max(1.0, len(best.fit.z) - problem.determined(best.fit.J).effective)
    known = _known(problem, best, chi2 / dof)
    low, high = bounds(unknowns)
    close = np.minimum(x - low, high - x) <= 1e-9 * problem.typical
    at_bound = tuple(u.name for u, there in zip(unknowns, close, strict=True) if there)
    which = [set(problem.own(i)[1]) for i in range(len(problem.parts))]
    common = [i for i in range(len(x)) if all(i in own for own in which)]
    own = {variable for i, u in enumerate(unknowns) if i not in common for variable in u.variables}
    recordings = _recordings(problem, best.fit, known, labels, [u.name for u in asked], own)
    shared, covariance = tuple(unknowns[i] for i in common), known.covariance[np.ix_(common, common)]
    every = {n: float(v) for n, v in parameter_values(shared, network, x[common]).items() if n not in own}
    values, zeros = split_zeros(every, network)
    noise = noise_known([part.beats.n_beats for part in problem.parts])
    ci95 = parameter_intervals(shared, network, x[common], covariance, noise)
    sd = np.sqrt(np.diag(known.covariance))
    weak = {u.name for u, s in zip(unknowns, sd, strict=True) if u.prior_sd and s > ALL_PRIOR * u.prior_sd}
    terms = [f"ln {u.name}" if u.kind == "scale" else u.name for u in unknowns]
    report = [
        *(f"{name} reached a bound of its allowed range" for name in at_bound),
        *sentences([u.name for u in unknowns], [u.prior_sd for u in unknowns], known, terms),
        *(_zero(name, value, ci95[name], name in weak) for name, value in zeros.items()),
        *_misfit(chi2 / dof, dof, recordings, best.errors),
        *notes,
        *dict.fromkeys(text.rstrip(".") for part in problem.parts for text in part.beats.warnings),
    ]
    if not best.converged:
        report.append("the search did not converge: no step lowered the misfit, or it reached its iteration limit")
    return Calibration(
        network=network.name,
        recordings=recordings,
        unknowns=unknowns,
        x=x,
        covariance=known.covariance,
        values=values,
        ci95={name: ci95[name] for name in values},
        shrinkage=tuple(u.prior_sd and float(s) / u.prior_sd for u, s in zip(unknowns, sd, strict=True)),
        chi2=chi2,
        dof=dof,
        singular_values=known.singular_values,
        at_bound=at_bound,
        report=tuple(report),
        history=(near.history, best.history),
        converged=best.converged,
        simulations=meter.simulations,
        seconds=seconds,
        others={
            name: value
            for name, value in network.parameters().items()
            if name not in values and name not in own and not network.parameter_quantities()[name].input
        },
        laws={
            "network.elastic_law": network.elastic_law,
            "network.viscous_law": network.viscous_law,
        },
        zeros={name: (value, ci95[name]) for name, value in zeros.items()},
        model_errors=(float(best.errors[0]), float(best.errors[1])),
    )  # fmt: skip


def _known(problem: Problem, best: Ended, ratio: float) -> Determined:
    """The parameters that the data determine, with the model error; ratio : χ²/dof without it."""
    if not best.errors.any():
        return problem.determined(best.fit.J, max(1.0, ratio))
    wide = replace(problem, whole=granted(problem.whole, best.errors))
    (fit,) = wide.whole.restated([best.fit], problem.whole)
    return wide.determined(fit.J, widening(wide, fit.z, wide.determined(fit.J).effective))


def _recordings(
    problem: Problem, fit: Fit, known: Determined, labels: Sequence[str], names: Sequence[str], own: Collection[str],
) -> tuple[Recording, ...]:  # fmt: skip
    """Each recording: the fit to its data, and its own values."""
    found, determined = [], problem.determined(fit.J)
    paid = np.einsum("np,pq,nq->n", fit.J, determined.covariance, fit.J)  # leverage of each datum
    paid *= determined.effective / max(float(paid.sum()), np.finfo(float).tiny)
    for i, (part, rows, label) in enumerate(zip(problem.parts, problem.whole.rows, labels, strict=True)):
        (unknowns, at), beats, network = problem.own(i), part.beats, part.network
        z, x = fit.z[rows], fit.x[at]
        values = {n: float(v) for n, v in parameter_values(unknowns, network, x).items() if n in own}
        covariance, noise = known.covariance[np.ix_(at, at)], noise_known([beats.n_beats])
        ci95 = parameter_intervals(unknowns, network, x, covariance, noise)
        rms = dict(zip(part.signals, part.rms(z).tolist(), strict=True))
        off = part.target.unwhiten(z[:, None])[0, :, 0].real
        far = np.abs(off) / pulses(beats, part.signals)
        means = {part.signals[i]: float(off[i]) for i in np.argsort(-far) if far[i] > MEANS}
        found.append(Recording(
            label, beats.source, beats.sha256, beats.n_beats, tuple(int(j) for j in at), tuple(names), values,
            {name: ci95[name] for name in values}, float(z @ z), max(1.0, len(z) - float(paid[rows].sum())),
            part.target.channel_rms(z), rms, means, part.K, beats.told,
        ))  # fmt: skip
    return tuple(found)


def _zero(name: str, value: float, ci95: tuple[float, float], undetermined: bool) -> str:
    """A sentence on a sensor's zero that was found, and how to make it known unless the data do not determine it."""
    channel, _, _ = name.rpartition(".")
    unit, factor = of_signal(channel)
    estimate, low, high = (number(factor * each) for each in (value, *ci95))
    found = f"the zero of {channel} is {estimate} {unit} ({low} to {high})"
    known = f'--filter "{channel}=zero {factor * value:.4g} {unit}"'
    return found if undetermined else f"{found}; to other commands it is known by {known}"


def _misfit(ratio: float, dof: float, recordings: Sequence[Recording], errors: Array) -> list[str]:
    """A sentence if χ²/dof is significantly above 1."""
    if ratio <= 1.0 + CHANCE * math.sqrt(2.0 / dof):
        return []
    recording = max(recordings, key=lambda each: max(each.channels.values()))
    worst = max(recording.channels, key=lambda name: recording.channels[name])
    where = f"{worst} of {recording.label}" if len(recordings) > 1 else worst
    there = " there" if len(recordings) > 1 else ""
    means, rest = (f"{100.0 * a:.2g} %" for a in errors)
    allowed = (
        f"the intervals allow a model error of {rest} of each channel's pulsation in the harmonics (rms) and {means} "
        "in the means (sd)"
    )
    if recording.means and len(recordings) * len(recording.channels) > 1:
        farthest, off = next(iter(recording.means.items()))
        side = "above" if off > 0.0 else "below"
        allowed += (
            f"; the mean of {farthest} is {size_text(farthest, abs(off))} {side} the record's: if its zero or height "
            f"is off, free it (--free {farthest}.zero)"
        )
    return [
        f"the network does not explain the record to its noise: chi2/dof = {ratio:.3g}, worst in {where} "
        f"({recording.channels[worst]:.3g} times its noise); "
        f"rms residual{there}: {sizes(recording.rms, recording.channels)}; "
        + (allowed if errors.any() else f"the intervals are widened by {math.sqrt(ratio):.3g}")
    ]
