"""Learn a law of the misfit that no effect of the catalogue explains, from the terms in the library of an effect.

    σ = … + Σ c_j f_j(ε, ε̇)   of a wall,    Q = … + Σ c_j f_j(P - P_venous)   of an outlet,    c_j >= 0

Each f_j of a wall is odd and nondecreasing in the strain rate, and each of an outlet flows down the pressure, so that a
law generates energy over no loop (:mod:`solver.laws.learned`). Terms are added one by one (forward selection) while the
evidence gains more than their price; each hypothesis is refitted in full with all walls. Then dispensable terms are
dropped. The search starts without effects, and from the effects of a partial verdict. The law acts in the one wall of a
bench, or in walls and outlets where the source map has something, and in all alike. Its FMU must confirm it on the
held-out beats, and on recordings that are held out whole; otherwise tables over the beat describe the sources of the
map without explaining them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from time import monotonic
from typing import Any

import numpy as np

from fitting.check.fmu_run import RunFailed
from fitting.inference import hierarchy
from fitting.inference.extended_network import estimates, extended
from fitting.inference.fit import Array, Fit, misfit
from fitting.inference.forward import Single
from fitting.inference.hypothesis import PlacedEffect, effect_of, searched
from fitting.inference.models.bench import Bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.source_maps.source_map import SourceMap
from fitting.inference.unknown import parameter_values, quantile
from fitting.parallel.workers import Workers
from solver.errors import InputError
from solver.laws import effects
from solver.laws.effect import ALL_PLACES, OUTFLOW, OUTLET, WALL, Effect
from solver.loop import derivative_matrix
from solver.mesh.sources import BY_KIND, Source
from solver.network.curve import Curve
from solver.network.description import Network, Site
from solver.network.table_source import KINDS, TableSource
from solver.simulate import BROKEN

from .. import thresholds as at
from ..find.study import Study
from ..findings.outcome import LearnedLaw
from ..findings.recorded import Pair, Recorded
from ..name.confirmation import not_fallen
from ..name.scoring import there, weighed
from ..name.verdict import Naming
from ..show.fmu_validation import Run, agreement, fall, gap

_TRIED = 2  # most promising terms, refitted at every step
_ALONG = (0.0, 0.5, 1.0)  # x/L at which the strains of a segment are evaluated
_SAMPLES = 4  # per beat for each harmonic

_NONE = np.zeros(0)
NOTHING = Fit((), (), _NONE, _NONE, np.zeros((0, 0)), np.zeros(0, int), np.zeros(0, int))  # the network without changes
_NAMES = {kind: name for name, kind in BY_KIND.items()}

Stage = Callable[[str, Callable[[], Any]], Any]
Runner = Callable[[Study, Network, Fit], tuple[Run, Callable[[], bytes]]]


@dataclass(frozen=True)
class Learnt:
    """A law that the evidence favours.

    fit : with the law as its last term. keys : of its library terms. ranges : of validity, by variable. seen : by
    segment, lowest and highest strain [-] and highest strain rate [1/s] of the record. score : -2 ln of evidence times
    prior. instead : effects of a partial verdict that it replaces.
    """

    fit: Fit
    keys: tuple[str, ...]
    ranges: Mapping[str, float]
    seen: Mapping[str, tuple[float, float, float]]
    score: float
    instead: tuple[str, ...] = ()

    @property
    def term(self) -> PlacedEffect:
        return self.fit.terms[-1]


Unseen = Callable[[Learnt], Sequence[Recorded]]


def learns(naming: Naming) -> bool:
    """True if more than noise remains that no effect of the catalogue explains."""
    return naming.verdict == "partial" or (naming.verdict == "unknown" and not naming.base.explains)


def law_of(
    study: Study,
    naming: Naming,
    before: Run,
    run: Runner,
    unseen: Unseen,
    jobs: int,
    until: float,
    stage: Stage,
) -> LearnedLaw | None:
    """A law of the remaining misfit, if one is found in time and its FMU confirms it (:func:`stands`); otherwise the
    tables that describe the misfit.

    unseen : as in :func:`stands`. jobs : number of simulating processes. until : deadline in ``time.monotonic`` [s].
    stage : stores the found law.
    """
    with suppress(OutOfTime, RunFailed), Workers(jobs) as workers:
        runs = Runs(deadline=until, clock=monotonic, workers=workers)
        found: Learnt | None = stage("learned", lambda: learnt(study, naming, runs))
        law = None if found is None else stands(study, found, before, run, unseen)
        if law is not None:
            return law
    return described(study, naming, before, run)


def learnt(study: Study, naming: Naming, runs: Runs) -> Learnt | None:
    """The most probable law of the remaining misfit; None if none is worth its price.

    study : with the problem as prepared, without the model discrepancy of a partial verdict.
    """
    problem = study.problem.individual() if naming.problem.deviations else study.problem
    problem = problem.sharpened(naming.base.fit, runs)
    starts = [naming.base.fit, *([naming.best.fit] if naming.verdict == "partial" else [])]
    # continued under the weights of this problem
    again = [problem.refit([f.terms], f, runs) if problem.site else problem.refine([f], runs) for f in starts]
    begun = [f for some in again for f in there(some)]
    found: list[Learnt] = []
    for effect in (e for e in effects.ALL if e.library):
        places = _places(naming, effect, problem)
        states = _states(effect, problem, naming.base.fit, runs) if places else {}
        for place in places if states else ():
            ranges, seen = _range(effect, problem.network, place, states)
            path = _Path(in_range(problem, ranges), effect, place, 2.0 * math.log(len(places)), runs)
            for here in begun:
                fit, keys, score = path.walked(here, weighed(problem, here, study.terms).score)
                if keys:
                    gone = () if here.terms else tuple(t.label for t in starts[-1].terms)
                    found.append(Learnt(fit, keys, ranges, seen, score, gone))
    return min(found, key=lambda law: law.score, default=None)


def _range(
    effect: Effect, network: Network, place: str, states: Mapping[str, tuple[Array, Array]]
) -> tuple[dict[str, float], dict[str, tuple[float, float, float]]]:
    """The range of validity of a law at a place, by variable, and the range of the data by segment. For all places it
    is common."""
    own = {place: states[place]} if place in states else states
    state, rate = (np.concatenate([np.ravel(each[i]) for each in own.values()]) for i in (0, 1))
    seen = {s: (float(x.min()), float(x.max()), float(np.abs(r).max())) for s, (x, r) in own.items()}
    variables = {s: effect.variables(network, s) for s in own}
    return {variables[s][key][0]: x for s in own for key, x in effect.valid(state, rate).items()}, seen


def in_range(problem: Single, ranges: Mapping[str, float]) -> Single:
    """The same problem with a network that contains the ranges of a learned law, but not yet the law."""
    return with_network(problem, problem.network.with_terms(ranges))


@dataclass(frozen=True)
class _Path:
    """A forward selection at one place. choice : -2 ln of the prior of the place."""

    problem: Single
    effect: Effect
    place: str
    choice: float
    runs: Runs

    def term(self, keys: Sequence[str]) -> PlacedEffect:
        """A law with some library terms, all of them size parameters."""
        own = self.effect.learned(self.problem.network, self.place, keys)
        return PlacedEffect(self.effect.name, self.place, (self.place,), tuple(searched(self.effect, c) for c in own))

    def price(self, keys: Sequence[str]) -> float:
        """-2 ln of the prior of a law: its first term is priced as a first effect, each further one as a second."""
        each = 2.0 * math.log(len(self.effect.library))
        return self.choice + at.FIRST + each + (len(keys) - 1) * (at.SECOND + each) if keys else 0.0

    def walked(self, here: Fit, first: float) -> tuple[Fit, tuple[str, ...], float]:
        """The fit, its terms and its score, from a fit without a law and its score ``first``."""
        plain = first - hierarchy.score(here)
        beside, best, keys, score = here.terms, here, tuple[str, ...](), first

        def tried(some: Sequence[tuple[str, ...]]) -> list[tuple[float, tuple[str, ...], Fit]]:
            fits = self.problem.refit([(*beside, self.term(each)) for each in some], best, self.runs)
            pairs = zip(some, fits, strict=True)
            return [(hierarchy.score(f) + plain + self.price(each), each, f) for each, f in pairs if f is not None]

        while len(keys) < len(self.effect.library):
            more = tried([(*keys, key) for key in self._promising(best, keys)])
            if not more or (nearest := min(more, key=lambda each: each[0]))[0] >= score:
                break
            score, keys, best = nearest
        if len(keys) > 2:  # earlier terms may have become dispensable; the last two were chosen beside all others
            fewer = tried([tuple(k for k in keys if k != gone) for gone in keys[:-2]])
            score, keys, best = min([(score, keys, best), *fewer], key=lambda each: each[0])
        return best, keys, score

    def _promising(self, best: Fit, keys: Sequence[str]) -> list[str]:
        """The remaining terms whose columns promise the most evidence."""
        unused = [key for key in self.effect.library if key not in keys]
        whole = self.term(unused)
        columns = self.problem.columns(best, [whole], self.runs).get(whole.label)
        if columns is None:
            return unused
        promised = []
        for key, unknown, column in zip(unused, whole.unknowns, columns.T, strict=True):
            J, x = np.column_stack([best.J, column]), np.append(best.x, 0.0)
            linear = hierarchy.Linear.of_columns(best.z, J, x, (*best.unknowns, unknown), best.log_volume)
            promised.append((linear.inferred().score, key))
        return [key for _, key in sorted(promised)[:_TRIED]]


# --- its FMU ----------------------------------------------------------------------------------------------------------


def stands(study: Study, found: Learnt, before: Run, run: Runner, unseen: Unseen = lambda law: ()) -> LearnedLaw | None:
    """The law if its FMU confirms it, otherwise None. The FMU must agree with the inferred model and shrink the gap to
    the held-out beats by more than chance; if it leaves more than noise, it must close most of the gap.

    before : the run without it. run : runs a law's FMU under the record's wave; it also returns a
    function that builds the FMU to deliver. unseen : runs it under recordings that are held out whole; there the gap
    must fall as for a name (:func:`discrepancy.name.confirmation.confirmed`).
    """
    own = replace(study, problem=in_range(study.problem, found.ranges))
    network = extended(own.problem.network, found.fit)
    after, archive = run(own, network, found.fit)
    alike = agreement(own, found.fit, own.problem.wave(own.fitted, found.fit), after)
    if alike is not None and not alike.difference <= at.AGREE:
        return None
    explains = misfit(found.fit, own.problem.dof_of_noise) < at.MISFIT
    if (remaining_gap := gap_that_falls(own, before, after, explains)) is None:
        return None
    elsewhere = tuple(unseen(found))
    if not_fallen(elsewhere):
        return None
    fit, term = hierarchy.with_widths(found.fit), found.term
    return LearnedLaw(
        name=term.effect,
        where=term.where,
        formula=effect_of(term).formula(found.keys),
        parameters=estimates(own.problem.network, fit, term, quantile(own.problem.dof_of_noise)),
        seen=found.seen,
        beside=tuple(t.label for t in found.fit.terms[:-1]),
        instead=found.instead,
        before=remaining_gap,
        after=after.gap.total,
        record=(study.fitted.source, study.fitted.sha256),
        network=network,
        archive=archive(),
        kind=study.problem.kind,
        elsewhere={r.label: (r.gap_before[1], r.gap_after[1]) for r in elsewhere if r.gap_after},
    )


# --- where, and in which range ----------------------------------------------------------------------------------------


def _places(naming: Naming, effect: Effect, problem: Single) -> list[str]:
    """The wall of a bench. In a network the places of the map and their rivals, and all together; an outlet also if its
    segment has an outflow source."""
    if problem.site is not None:
        return [problem.site] if effect.source == WALL else []
    if naming.map is None:
        return []
    near = [p for r in naming.map.rivals if r.above < at.RULED_OUT for p in r.places]
    places, kinds = effect.where(problem.network), {effect.source, OUTFLOW if effect.source == OUTLET else ""}
    found = [p.name for p in (*naming.map.places, *near) if p.kind in kinds and p.name in places]
    return list(dict.fromkeys([*found, ALL_PLACES])) if found else []


def _states(effect: Effect, problem: Single, fit: Fit, runs: Runs) -> dict[str, tuple[Array, Array]]:
    """The state variables of an effect's laws over a beat, with their rates: strains ε of every segment, or P -
    P_venous [Pa] of every outlet at which it acts. Empty if the simulation breaks down."""
    network = extended(problem.network, fit)
    if isinstance(problem, Bench):
        strain = problem.start[None] / network.segment(problem.site).R0 - 1.0
        return {problem.site: (strain, strain @ derivative_matrix(strain.shape[1], problem.loop.T).T)}
    assert isinstance(problem, NetworkProblem)
    names, sites = list[tuple[str, str]](), list[Site]()
    for place in effect.where(network):
        if place != ALL_PLACES and effect.source == WALL:
            sites += [Site(f"{place}_{i}_strain", place, x) for i, x in enumerate(_ALONG)]
            names += [(place, f"{site.name}.R") for site in sites[-len(_ALONG) :]]
        elif place != ALL_PLACES:
            names.append((place, f"{place}.outlet.P"))
    waves = _beats(problem, replace(network, sites=tuple(sites), channels=()), [name for _, name in names], runs)
    found = {}
    for place in dict.fromkeys(place for place, _ in names) if len(waves) else ():
        own = waves[[i for i, (of, _) in enumerate(names) if of == place]]
        if effect.source == WALL:
            state = own / network.segment(place).R0 - 1.0
        else:
            state = own - next(o.P_venous for o in network.outlets if o.segment == place)
        found[place] = state, state @ derivative_matrix(own.shape[1], problem.simulator.T).T
    return found


def _beats(problem: NetworkProblem, network: Network, names: Sequence[str], runs: Runs) -> Array:
    """(len(names), N) outputs of a network over a beat; empty if the simulation breaks down."""
    simulator = replace(problem.simulator, network=network, names=tuple(names))
    try:
        (X,) = simulator.coefficients(network, {}, runs)
    except BROKEN:
        return np.zeros((0, 0))
    if np.isnan(X).any():
        return np.zeros((0, 0))
    return np.fft.irfft(X, _SAMPLES * problem.K, axis=0, norm="forward").T


# --- tables, if no law is found ---------------------------------------------------------------------------------------


def described(study: Study, naming: Naming, before: Run, run: Runner) -> LearnedLaw | None:
    """The tables of a map, if their FMU shrinks the gap to the held-out beats by more than chance and closes most of
    it. None for a bench, and if only sensors and outlying parameters act.

    before : the run without them. run : as in :func:`discrepancy.add.learning.law_of`.
    """
    found = naming.map
    if found is None or study.problem.site is not None:
        return None
    try:
        if not (tables := tuple(tables_of(found, study.fitted.T))):
            return None
        values = {name: float(x) for name, x in parameter_values(found.unknowns, study.network, found.x).items()}
        network = replace(study.network.with_parameters(values), sources=tables)
        own = replace(study, problem=with_network(study.problem, network))
        after, archive = run(own, network, NOTHING)
    except (RunFailed, InputError):
        return None
    if (remaining_gap := gap_that_falls(study, before, after)) is None:
        return None
    return LearnedLaw(
        name="table_source",
        kind=study.problem.kind,
        where=tuple(dict.fromkeys(table.segment for table in tables)),
        formula=" and ".join(dict.fromkeys(s.place.label for s in found.signals if s.place.sources)),
        before=remaining_gap,
        after=after.gap.total,
        record=(study.fitted.source, study.fitted.sha256),
        network=network,
        archive=archive(),
        is_law=False,
    )


def gap_that_falls(study: Study, before: Run, after: Run, explains: bool = False) -> Pair | None:
    """The gap of the run ``before`` on (fitted, held-out) beats if that to the held-out beats falls by more than chance
    in the run ``after`` and, unless this ``explains`` the record, most of it closes; else None."""
    remaining, (fallen, sd) = gap(study, before.X).total, fall(study, before.X, after.X)
    closes = explains or after.gap.total[1] <= (1.0 - at.PART_CLOSED) * remaining[1]
    return remaining if fallen > at.FALL * sd and closes else None


def with_network(problem: Single, network: Network) -> Single:
    """The same problem with another network of the same topology."""
    if isinstance(problem, NetworkProblem):
        return replace(problem, simulator=replace(problem.simulator, network=network))
    assert isinstance(problem, Bench)
    return replace(problem, network=network)


def tables_of(found: SourceMap, T: float) -> Iterator[TableSource]:
    """The tables of all sources that are in the equations, over beats of T [s]."""
    for signal in found.signals:
        for source, g in zip(signal.place.sources, signal.g.T, strict=False):
            if type(source) in _NAMES:
                yield _table(source, g, T)


def _table(source: Source, g: Array, T: float) -> TableSource:
    """g : (K+1,) harmonics."""
    kind = _NAMES[type(source)]
    how = {f.name: float(getattr(source, f.name)) for f in fields(source) if f.name != "place"}
    series = Curve.series(KINDS[kind][0], float(g[0].real), 2.0 * g[1:].real, -2.0 * g[1:].imag, T)
    return TableSource(kind, source.place, series, how)
