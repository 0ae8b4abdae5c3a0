"""Network calibration: parameters of a whole network from a record of its inflow and of P, Q and R at some sites.

Gauss–Newton on the whitened harmonics of :mod:`fitting.records.noise`. With the residual z(x), unknowns x counted from
the network's own values and Gaussian priors of standard deviation s, it minimises

    |z(x)|² + Σ (x_i/s_i)²

One batch of harmonic balances gives z and its derivatives, by finite differences. A first search comes near. At what
it found the elements are halved once to measure the solver's own error, and the response to the inflow's noise is taken
there; with these weights a second search ends.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solver import NonPhysicalState, NotPeriodic, Settings
from solver.balance import NoSteadyState
from solver.errors import InputError
from solver.legible import endless
from solver.network import Network
from solver.units import INFLOW, SIGNAL_UNITS

from .inference.asked import parse_unknowns
from .inference.calibration import DERIVATIVE_ERROR, Problem, problem_of
from .inference.fit import Member
from .inference.gauss_newton import Rules, Search, search
from .inference.identify import sentences
from .inference.simulator import Meter
from .inference.unknown import Unknown, parameter_intervals, parameter_values, quantile
from .parameter_set import ParameterSet, Value, unit_of
from .provenance import software
from .records.amounts import sizes
from .records.beats import Beats
from .records.noise import (
    MAX_HARMONICS,
    check_flow_driven,
    degrees_of_freedom,
    harmonics_above_noise,
    pulses,
    solver_error,
)
from .threads import single_threaded

Array = np.ndarray
Progress = Callable[[float, str], None]

_FIRST_ERROR = 1e-3  # of a channel's pulse: the solver's own error is below it
# Squared parts of a standard deviation: from a tenth, one step with the second weights leads home; a hundredth is none
_NEAR, _SETTLED = 1e-2, 1e-4
_ALL_PRIOR = 0.95  # of a prior's standard deviation: who knows no better than that has learned nothing from the data
_FEWEST_STEPS = 20  # of the solver in a beat


@dataclass(frozen=True)
class Calibration:
    """The result. Covariances are of x (:class:`~fitting.inference.unknown.Unknown`), data and prior together.

    values, ci95 : SI, by FMU variable name. shrinkage : posterior over prior standard deviation, None without a prior.
    chi2, dof : of the data; where chi2/dof > 1 the data's covariance is multiplied by it. channels : whitened RMS per
    channel (1 = noise); rms : the same over the beat [SI]. singular_values : of the whitened Jacobian in prior units,
    largest first, 0 where its own error is as large; directions : its right singular vectors, (p, p), by row. report :
    what is not determined, at a bound, or not explained, one sentence each. history : cost after each iteration of both
    searches. harmonics : K.
    simulations : parameter sets that were simulated. others : the network's parameters that did not move [SI].
    beats : in the record; intervals are Student's t with 4 (beats - 1) degrees of freedom, what is known of the noise.
    """

    network: str
    unknowns: tuple[Unknown, ...]
    x: Array
    covariance: Array
    values: Mapping[str, float]
    ci95: Mapping[str, tuple[float, float]]
    shrinkage: tuple[float | None, ...]
    chi2: float
    dof: float
    channels: Mapping[str, float]
    rms: Mapping[str, float]
    singular_values: Array
    directions: Array
    at_bound: tuple[str, ...]
    report: tuple[str, ...]
    history: tuple[tuple[float, ...], tuple[float, ...]]
    converged: bool
    harmonics: int
    simulations: int
    seconds: float
    others: Mapping[str, float]
    laws: Mapping[str, str]
    beats: int
    source: str
    sha256: str
    told: Mapping[str, Any] = field(default_factory=dict)

    @property
    def cost(self) -> float:
        """What the search made small: χ² of the data and of the priors."""
        return self.history[1][-1]

    @property
    def sd(self) -> Array:
        """(p,) standard deviation of x."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def quantile(self) -> float:
        """Half a 95 % interval in standard deviations."""
        return quantile(degrees_of_freedom(self.beats, at_ends=True))

    @property
    def undetermined(self) -> frozenset[str]:
        """Values of which the data say next to nothing: their intervals are those of their priors, or have no end."""
        weak = {name for u, part in zip(self.unknowns, self.shrinkage, strict=True)
                if part is not None and part > _ALL_PRIOR for name, _ in u.moves}  # fmt: skip
        return frozenset(name for name, value in self.values.items() if name in weak or endless(value, self.ci95[name]))

    def parameter_set(self, name: str | None = None, complete: bool = False) -> ParameterSet:
        """The values that moved, with their intervals: start values of the network's FMU.

        complete : with all other parameters of the network too, for an FMU that was built with other values.
        """
        values = {each: Value(value, unit_of(each), self.ci95[each]) for each, value in self.values.items()}
        if complete:
            values |= {each: Value(x, unit_of(each)) for each, x in self.others.items()}
        provenance = {
            "method": "network calibration",
            "network": self.network,
            "record": self.source,
            "sha256": self.sha256,
            **({"columns": dict(self.told)} if self.told else {}),
            "beats": self.beats,
            "unknowns": {u.name: {"x": float(x), "sd": float(s), "prior_sd": u.prior_sd, "unit": u.unit, "kind": u.kind,
                                  "moves": dict(u.moves)}
                         for u, x, s in zip(self.unknowns, self.x, self.sd, strict=True)},
            "covariance": self.covariance.tolist(),
            "chi2_over_dof": self.chi2 / self.dof,
            "channels": dict(self.channels),
            "rms": {name: {"value": rms, "unit": SIGNAL_UNITS[name[-1]]} for name, rms in self.rms.items()},
            "undetermined": sorted(self.undetermined),
            "report": list(self.report),
            "software": software(),
        }  # fmt: skip
        return ParameterSet(name or f"{self.network} calibrated", values, self.laws, provenance)


@single_threaded
def calibrate(
    beats: Beats,
    network: Network,
    unknowns: Iterable[str | Unknown],
    *,
    channels: Sequence[str] | None = None,
    settings: Settings | None = None,
    max_iterations: int = 20,
    x0: Array | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find the unknowns ("all.E", "CA.phi0:0.1", "CA.outlet.R_t:none" …) of a network from a record of it.

    beats : a record with inlet.Q and channels named as the network's outputs; of these ``channels``, default all.
    settings : of the solver: the elements' length, and dt, default 1 ms, where no balance is found. x0 : (p,) where the
    search begins, default 0, the network's own values (:mod:`fitting.starts` tries many). progress : called with a
    fraction of the work and a label.
    Raises ValueError, one sentence, for unknowns that the network has not, channels that it has not, a record without
    inlet.Q or with a phase that was never measured, a beat shorter than 20 steps, and a network that breaks down with
    this inflow where the search begins.
    """
    started = time.perf_counter()
    settings = settings or Settings()
    found = parse_unknowns(unknowns, network)
    check_flow_driven(network)
    names = _channels(beats, network, channels)
    K = _harmonics(beats, names, settings)
    told = _Stages(progress)
    meter = Meter(told.simulated)
    problem = problem_of(beats, network, found, names, K, settings, meter)
    pulse = pulses(beats, names)

    x, given = (np.zeros(len(found)), "as given") if x0 is None else (x0, "at this start")
    first = problem.with_target(x, np.full((K + 1, len(names)), _FIRST_ERROR) * pulse)
    told.begin(0.0, 0.6, "first search")
    with _refusal(f"{beats.source}: with its inflow, network {network.name} {given} cannot be simulated"):
        batch = first.batch(x)
    rules = Rules(_NEAR, math.inf, max_iterations, error=DERIVATIVE_ERROR)
    near = _minimum(first, x, batch, rules)

    told.begin(0.6, 1.0, "second search")
    assert near.here is not None
    x, batch = near.x, near.here.memory
    with _refusal(f"{beats.source}: network {network.name} as found cannot be simulated with shorter elements"):
        last = problem.with_target(x, solver_error(batch[0], problem.finer().simulate(x[None])[0], pulse))
    best = _minimum(last, x, batch, replace(rules, gain=_SETTLED))
    if progress:
        progress(1.0, "done")
    return _result(last, near, best, time.perf_counter() - started)


def _minimum(problem: Problem, x: Array, batch: Array, rules: Rules) -> Search:
    """The search from x : (p,), whose batch is known."""
    found = Search(Member((), problem.unknowns, x), rules, problem.point(x, batch))
    search(problem.evaluated, [found])
    return found


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
    """K: as far as any channel is above its noise, both record and solver resolve it, and at most 40."""
    steps = math.ceil(beats.T / settings.dt - 1e-9)
    if steps < _FEWEST_STEPS:
        raise InputError(
            f"{beats.source}: its period of {beats.T:g} s has {steps} steps of {settings.dt:g} s, fewer than "
            f"{_FEWEST_STEPS}; choose a smaller dt or check the unit of its time."
        )
    return harmonics_above_noise(beats, names, min(MAX_HARMONICS, (beats.N - 1) // 2, steps // 2 - 1))


# --- its stages ---------------------------------------------------------------------------------------------------


class _Stages:
    """Tells how far each stage of the search is, which takes some four simulations."""

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


@contextmanager
def _refusal(what: str) -> Iterator[None]:
    """A simulation that breaks down where there is nothing to go back to, as one sentence."""
    try:
        yield
    except (NonPhysicalState, NotPeriodic, NoSteadyState) as error:
        raise InputError(f"{what}: {error}") from None


# --- the result ---------------------------------------------------------------------------------------------------


def _result(problem: Problem, near: Search, best: Search, seconds: float) -> Calibration:
    assert problem.target is not None and best.here is not None
    x, point, unknowns, network = best.x, best.here, problem.unknowns, problem.simulator.network
    chi2 = float(point.z @ point.z)
    dof = max(1.0, len(point.z) - problem.determined(point, 1.0).effective)
    known = problem.determined(point, max(1.0, chi2 / dof))
    close = np.minimum(x - problem.bounds[0], problem.bounds[1] - x) <= 1e-9 * problem.typical
    at_bound = tuple(u.name for u, there in zip(unknowns, close, strict=True) if there)
    channels = problem.target.channel_rms(point.memory[0])
    rms = problem.target.channel_size(point.memory[0])
    sd = np.sqrt(np.diag(known.covariance))
    terms = [f"ln {u.name}" if u.kind == "scale" else u.name for u in unknowns]
    report = [
        *(f"{name} stopped at the end of its allowed range" for name in at_bound),
        *sentences([u.name for u in unknowns], [u.prior_sd for u in unknowns], known, terms),
        *_misfit(chi2 / dof, dof, channels, rms),
        *(text.rstrip(".") for text in problem.beats.warnings),
    ]
    if not best.converged:
        report.append("the search did not settle: no further step lowered the misfit, or the iterations were used up")
    values = parameter_values(unknowns, network, x)
    return Calibration(
        network=network.name,
        unknowns=unknowns,
        x=x,
        covariance=known.covariance,
        values={name: float(value) for name, value in values.items()},
        ci95=parameter_intervals(
            unknowns, network, x, known.covariance, degrees_of_freedom(problem.beats.n_beats, at_ends=True)
        ),
        shrinkage=tuple(u.prior_sd and float(s) / u.prior_sd for u, s in zip(unknowns, sd, strict=True)),
        chi2=chi2,
        dof=dof,
        channels=channels,
        rms=rms,
        singular_values=known.singular_values,
        directions=known.directions,
        at_bound=at_bound,
        report=tuple(report),
        history=(tuple(near.history), tuple(best.history)),
        converged=best.converged,
        harmonics=problem.simulator.K,
        simulations=problem.meter.simulations,
        seconds=seconds,
        others={
            name: value
            for name, value in network.parameters().items()
            if name not in values and not network.parameter_quantities()[name].input
        },
        laws={
            "network.elastic_law": network.elastic_law,
            "network.viscous_law": network.viscous_law,
        },
        beats=problem.beats.n_beats,
        source=problem.beats.source,
        sha256=problem.beats.sha256,
        told=problem.beats.told,
    )  # fmt: skip


def _misfit(ratio: float, dof: float, channels: Mapping[str, float], rms: Mapping[str, float]) -> list[str]:
    """A sentence if χ²/dof is above 1 by more than chance (four standard deviations)."""
    if ratio <= 1.0 + 4.0 * math.sqrt(2.0 / dof):
        return []
    worst = max(channels, key=lambda name: channels[name])
    return [
        f"the network does not explain the record to its noise: chi2/dof = {ratio:.3g}, worst in {worst} "
        f"({channels[worst]:.3g} times its noise); rms of what is left: {sizes(rms, channels)}; the intervals are "
        f"widened by {math.sqrt(ratio):.3g}"
    ]
