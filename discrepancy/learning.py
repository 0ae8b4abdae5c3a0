"""Learn a law of what no effect of the catalogue explains: some of the few terms that an effect says a law may have.

    σ = … + Σ c_j f_j(ε, ε̇),    c_j >= 0

Each f_j is odd in the strain rate and does not fall with it, so that the law gives out energy over no loop
(:class:`solver.laws.LearnedStress`). Terms are added one by one while the evidence gains more than their price, each
hypothesis refitted in full with all walls; what the others made dispensable is dropped. The law begins beside no
effect, and beside what explains a part. It lies in the one wall of a bench, or in walls where the source map has
something, and in all walls alike. Whether it stands is for its FMU to say, on the held-out beats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any

import numpy as np

from fitting.fmu_run import RunFailed
from fitting.inference import hierarchy
from fitting.inference.added import estimates, extended
from fitting.inference.bench import Bench
from fitting.inference.fit import Fit, misfit
from fitting.inference.forward import Forward
from fitting.inference.network import NetworkProblem
from fitting.inference.simulator import OutOfTime, Runs
from fitting.inference.terms import Term, effect_of, searched
from fitting.inference.unknown import quantile
from fitting.records.record import Record
from fitting.workers import Workers
from solver import effects
from solver.effect import ALL_PLACES, WALL, Effect
from solver.loop import derivative_matrix
from solver.network import Network, Site
from solver.simulate import BROKEN

from . import thresholds as at
from .confirm import agreement
from .learned_law import LearnedLaw
from .scoring import weighed
from .show import Run, fall, gap
from .study import Study
from .verdict import Naming

Array = np.ndarray

_TRIED = 2  # terms that promise most, refitted at every step
_ALONG = (0.0, 0.5, 1.0)  # x/L where a segment's strains are seen
_SAMPLES = 4  # of a beat for each harmonic
_AGREE = 1e-3  # of a pulse, by which an FMU may differ from what was inferred

Runner = Callable[[Study, Network, Fit], tuple[Run, bytes]]
Stage = Callable[[str, Callable[[], Any]], Any]


@dataclass(frozen=True)
class Learnt:
    """A law that the evidence favours.

    fit : with its term last. keys : of the terms that it has. ranges : by variable, where it holds. seen : by segment,
    lowest and highest strain [-] and highest strain rate [1/s] of the record. score : -2 ln of evidence and prior.
    instead : effects of a part, which it does without.
    """

    fit: Fit
    keys: tuple[str, ...]
    ranges: Mapping[str, float]
    seen: Mapping[str, tuple[float, float, float]]
    score: float
    instead: tuple[str, ...] = ()

    @property
    def term(self) -> Term:
        return self.fit.terms[-1]


def learns(naming: Naming) -> bool:
    """Whether more than noise remains that no effect of the catalogue explains."""
    return naming.verdict == "partial" or (naming.verdict == "unknown" and not naming.base.explains)


def law_of(
    study: Study, naming: Naming, before: Run, record: Record, run: Runner, jobs: int, until: float, stage: Stage
) -> LearnedLaw | None:
    """A law of what remains, if there is one, its FMU bears it out (:func:`stands`), and time is left.

    jobs : processes that simulate, until a time of ``time.monotonic`` [s]. stage : keeps what was found.
    """
    with suppress(OutOfTime, RunFailed), Workers(jobs) as workers:
        runs = Runs(deadline=until, clock=monotonic, workers=workers)
        found: Learnt | None = stage("learned", lambda: learnt(study, naming, runs))
        return None if found is None else stands(study, found, before, record, run)
    return None


def learnt(study: Study, naming: Naming, runs: Runs) -> Learnt | None:
    """The most probable law of what remains; None where none is worth its price.

    study : with the problem as it was prepared, without the errors of the model that a partial answer grants.
    """
    problem = study.problem.individual() if naming.problem.deviations else study.problem
    problem = problem.sharpened(naming.base.fit, runs)
    starts = [naming.base.fit, *([naming.best.fit] if naming.verdict == "partial" else [])]
    begun = [f for start in starts for f in _again(problem, start, runs)]
    found: list[Learnt] = []
    for effect in (e for e in effects.ALL if e.library and e.source == WALL):
        places = _places(naming, effect, problem)
        waves = _waves(problem, naming.base.fit, runs) if places else {}
        for place in places if waves else ():
            ranges, seen = _range(effect, place, waves)
            path = _Path(in_range(problem, ranges), effect, place, 2.0 * math.log(len(places)), runs)
            for here in begun:
                fit, keys, score = path.walked(here, weighed(problem, here, study.terms).score)
                if keys:
                    gone = () if here.terms else tuple(t.label for t in starts[-1].terms)
                    found.append(Learnt(fit, keys, ranges, seen, score, gone))
    return min(found, key=lambda law: law.score, default=None)


def _range(
    effect: Effect, place: str, waves: Mapping[str, tuple[Array, Array]]
) -> tuple[dict[str, float], dict[str, tuple[float, float, float]]]:
    """Where a law at a place holds, by variable, and what was seen by segment; in all walls it is one and the same."""
    own = {place: waves[place]} if place in waves else waves
    strain, rate = (np.concatenate([np.ravel(each[i]) for each in own.values()]) for i in (0, 1))
    seen = {s: (float(e.min()), float(e.max()), float(np.abs(r).max())) for s, (e, r) in own.items()}
    return {f"{s}.{key}": x for s in own for key, x in effect.valid(strain, rate).items()}, seen


def in_range(problem: Forward, ranges: Mapping[str, float]) -> Forward:
    """The same problem with a network that knows where a learned law holds, and has none yet."""
    network = problem.network.with_terms(ranges)
    if isinstance(problem, NetworkProblem):
        return replace(problem, network=network, simulator=replace(problem.simulator, network=network))
    assert isinstance(problem, Bench)
    return replace(problem, network=network)


def _again(problem: Forward, fit: Fit, runs: Runs) -> list[Fit]:
    """A fit searched on from where it is under the weights of this problem."""
    network = problem.site is None
    found = problem.refine([fit], runs) if network else problem.refit([fit.terms], fit, runs)
    return [f for f in found if f is not None]


@dataclass(frozen=True)
class _Path:
    """A forward path at one place. choice : -2 ln of the prior of the place."""

    problem: Forward
    effect: Effect
    place: str
    choice: float
    runs: Runs

    def term(self, keys: Sequence[str]) -> Term:
        """A law of some terms, all of them sizes."""
        own = self.effect.learned(self.problem.network, self.place, keys)
        return Term(self.effect.name, self.place, (self.place,), tuple(searched(self.effect, c) for c in own))

    def price(self, keys: Sequence[str]) -> float:
        """-2 ln of the prior of a law: a first term as a first effect, each further one as a second."""
        each = 2.0 * math.log(len(self.effect.library))
        return self.choice + at.FIRST + each + (len(keys) - 1) * (at.SECOND + each) if keys else 0.0

    def walked(self, here: Fit, first: float) -> tuple[Fit, tuple[str, ...], float]:
        """The fit, its terms and its score, from a fit without any, of score ``first``."""
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
        if len(keys) > 2:  # the last two were chosen beside all others
            fewer = tried([tuple(k for k in keys if k != gone) for gone in keys[:-2]])
            score, keys, best = min([(score, keys, best), *fewer], key=lambda each: each[0])
        return best, keys, score

    def _promising(self, best: Fit, keys: Sequence[str]) -> list[str]:
        """The terms that promise the most evidence beside those that are there, by their columns."""
        left = [key for key in self.effect.library if key not in keys]
        whole = self.term(left)
        columns = self.problem.columns(best, [whole], self.runs).get(whole.label)
        if columns is None:
            return left
        promised = []
        for key, unknown, column in zip(left, whole.unknowns, columns.T, strict=True):
            J, x = np.column_stack([best.J, column]), np.append(best.x, 0.0)
            linear = hierarchy.Linear.of_columns(best.z, J, x, (*best.unknowns, unknown), best.log_volume)
            promised.append((linear.inferred().score, key))
        return [key for _, key in sorted(promised)[:_TRIED]]


# --- its FMU ----------------------------------------------------------------------------------------------------------


def stands(study: Study, found: Learnt, before: Run, record: Record, run: Runner) -> LearnedLaw | None:
    """A law whose FMU bears it out: it shrinks the gap to the held-out beats by more than chance, and closes most of
    it where it leaves more than noise; and it is the model that was inferred. Else None.

    before : the run without it. run : a law's FMU under the record's wave, and the FMU that is delivered.
    """
    own = replace(study, problem=in_range(study.problem, found.ranges))
    network = extended(own.problem.network, found.fit)
    after, archive = run(own, network, found.fit)
    left = gap(own, before.X).total
    fallen, sd = fall(own, before, after)
    alike = agreement(own, found.fit, own.problem.wave(own.fitted, found.fit), after)
    if alike is not None and not alike.difference <= _AGREE:
        return None
    explains = misfit(found.fit, own.problem.dof_of_noise) < at.MISFIT
    if fallen <= at.FALL * sd or not (explains or after.gap.total[1] <= (1.0 - at.PART_CLOSED) * left[1]):
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
        before=left,
        after=after.gap.total,
        record=(record.path, record.sha256),
        network=network,
        archive=archive,
    )


# --- where, and in which range ----------------------------------------------------------------------------------------


def _places(naming: Naming, effect: Effect, problem: Forward) -> list[str]:
    """The wall of a bench; in a network those of the map, or that cannot be told from it, and all together."""
    if problem.site is not None:
        return [problem.site]
    if naming.map is None:
        return []
    near = [p for r in naming.map.rivals if r.above < at.RULED_OUT for p in r.places]
    walls = [p.name for p in (*naming.map.places, *near) if p.kind == effect.source]
    return list(dict.fromkeys([*walls, ALL_PLACES])) if walls else []


def _waves(problem: Forward, fit: Fit, runs: Runs) -> dict[str, tuple[Array, Array]]:
    """Strains ε and strain rates [1/s] of every segment over a beat; nothing where the simulation breaks down."""
    network = extended(problem.network, fit)
    if isinstance(problem, Bench):
        radii = {problem.site: problem.start[None]}
        T = problem.loop.T
    else:
        assert isinstance(problem, NetworkProblem)
        radii, T = _radii(problem, network, runs), problem.simulator.T
    found = {}
    for name, R in radii.items():
        strain = R / network.segment(name).R0 - 1.0
        found[name] = strain, strain @ derivative_matrix(R.shape[1], T).T
    return found


def _radii(problem: NetworkProblem, network: Network, runs: Runs) -> dict[str, Array]:
    """(3, N) [m] along every segment."""
    sites = [(s.name, Site(f"{s.name}_{i}_strain", s.name, x)) for s in network.segments for i, x in enumerate(_ALONG)]
    seen = replace(network, sites=tuple(site for _, site in sites), channels=())
    simulator = replace(problem.simulator, network=seen, names=tuple(f"{site.name}.R" for _, site in sites))
    try:
        (X,) = simulator.coefficients(seen, {}, runs)
    except BROKEN:
        return {}
    if np.isnan(X).any():
        return {}
    waves = np.fft.irfft(X, _SAMPLES * problem.K, axis=0, norm="forward").T
    return {s.name: waves[[i for i, (name, _) in enumerate(sites) if name == s.name]] for s in network.segments}
