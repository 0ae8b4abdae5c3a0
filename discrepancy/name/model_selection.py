"""Select the missing effect: which hypotheses of the catalogue explain the record, and which cannot be ruled out.

In a network, the source map (:mod:`fitting.inference.source_maps.source_map`) first locates where something acts, with
individual walls. Then the laws of the catalogue are fitted there (:mod:`discrepancy.name.at_places`). A parameter that
is an outlier of its kind is no wall deviation (:mod:`discrepancy.name.individual_walls`). If nothing leaves only noise,
hypotheses are compared with their own model errors (:mod:`discrepancy.name.approximate`); in a first model at once.

On a bench, a refit costs a tenth of a second, so every effect of the wall and its sensors is refitted, and every pair
if no single effect explains the record. The best single effect does not reveal the pair: a lag beside a slow catheter
looks like another catheter, and a relaxation gains nothing until the lag is included.

All are compared by evidence (:mod:`discrepancy.name.scoring`), exact and with model discrepancy. The class contains all
that the data cannot rule out (:mod:`discrepancy.name.verdict`). A single effect is named only if the class has one
member; of pairs, the best is named, with its class. If the best leaves more than noise, the verdict is partial; if no
effect is worth its prior odds, it is unknown.

If there are several recordings of one subject, each is searched by itself first, and gives candidates. These, and
effects that the derivatives of all recordings together support, are refitted to all recordings
(:class:`~fitting.inference.joint.joint_record.Several`) and compared by one evidence. A second heart rate separates
viscosity and relaxation, which one rate cannot distinguish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from fitting.inference.extended_network import extended
from fitting.inference.fit import Array, Fit, Member
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import PlacedEffect, followers, joins
from fitting.inference.joint.joint_record import Several, derivatives
from fitting.inference.model_discrepancy import Beside
from fitting.inference.models.bench import Bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.source_maps.source_map import SourceMap, found_beside, map_beside, source_map
from fitting.inference.unknown import bounds
from solver.errors import InputError

from .. import thresholds as at
from ..options import COMMON
from .approximate import compared_first_model, compared_with_errors, from_afar, is_far, nearest
from .at_places import named_at
from .individual_walls import set_apart
from .intervals import profiled
from .scoring import Compared, Named, exact, last_of, names_of, promised, there
from .verdict import Naming, decided

Terms = tuple[PlacedEffect, ...]

_SEARCHED = 0.8  # of the time limit: most that the search may take
_MAPPED = 0.6  # of that: most that the source map may take
_NO_SIZE = 0.05  # of x: a smaller effect did not lower the cost itself


def name(problem: Forward, terms: Sequence[PlacedEffect], runs: Runs | None = None, walls: str | None = None) -> Naming:
    """The verdict on one record.

    walls : COMMON or INDIVIDUAL (default). The spread of individual walls is estimated from the record and may be zero.
    If the time limit of ``runs`` is reached, the verdict is the best so far and marked as incomplete.
    Raises InputError if the model as given cannot be simulated with this record.
    """
    runs = runs or Runs()
    whole, terms = problem if walls == COMMON else problem.individual(), tuple(terms)
    found = None
    if isinstance(whole, NetworkProblem) and whole.accuracy:
        return _verdict_on_first_model(whole, terms, runs)
    first = runs.part(_SEARCHED) if isinstance(whole, NetworkProblem) else runs
    if isinstance(whole, NetworkProblem):
        found = source_map(whole, first.part(_MAPPED))
        search = named_at(whole.at((), found.unknowns, found.x), found, terms, first)
    else:
        search = _of_bench(whole, terms, first)
    last, near = last_of(_with_outliers(search, first)), None
    if isinstance(last.problem, NetworkProblem) and last.best.explains:
        if (near := nearest(last.problem, last.none.fit, replace(runs, deadline=None))) is not None:
            last = last.with_none(near)
    elif isinstance(last.problem, NetworkProblem):
        last = compared_with_errors(last, runs)
        near = None if last.best.explains else last.none.fit
    naming = decided(last, _freed(last, found, runs))
    return replace(profiled(naming, runs), map=found, nearest=near)


def _verdict_on_first_model(problem: NetworkProblem, terms: Terms, runs: Runs) -> Naming:
    """The verdict on a first model. The source map only shows where something acts that no law explains."""
    found, naming = None, decided(compared_first_model(problem, terms, runs.part(_SEARCHED)), lambda n: None)
    if naming.verdict in ("partial", "unknown"):
        with suppress(OutOfTime):
            found = source_map(problem, runs.part(_MAPPED))
    return replace(profiled(naming, runs), map=found)


def _freed(found: Compared, where: SourceMap | None, runs: Runs) -> Callable[[Named], Beside | None]:
    """A function that adds model discrepancy to a hypothesis. On a bench, it is an error of the wall law. In a network,
    it is free sources: those of the map if the hypothesis has no effect, otherwise those that the evidence selects."""
    problem, runs = found.problem, replace(runs, deadline=None)
    if isinstance(problem, Bench):
        return lambda n: problem.beside(n.fit)
    assert isinstance(problem, NetworkProblem)

    def beside(n: Named) -> Beside | None:
        if n.fit.terms or where is None:
            return found_beside(problem, n.fit)
        return map_beside(problem, n.fit, where, runs) if where.signals else None

    return beside


def _with_outliers(search: Iterator[Compared], runs: Runs) -> Iterator[Compared]:
    """The comparison after every stage; last, after the outliers among the individual walls were treated."""
    known = None
    for known in search:
        yield known
    if known is not None:
        yield from set_apart(known, runs)


# --- one wall ---------------------------------------------------------------------------------------------------------


def _of_bench(problem: Forward, terms: Terms, runs: Runs) -> Iterator[Compared]:
    """The comparison for one wall after every stage."""
    (base,) = problem.refit([()], runs=runs)
    if base is None:
        raise InputError("the model as given cannot be simulated with this record")
    yield Compared.of(problem, [base], {}, terms)
    columns = problem.columns(base, terms, runs)
    fits = there(problem.refit([(t,) for t in terms if t.label in columns], base, runs, columns))
    yield (found := Compared.of(problem, [_lower(problem, base, fits, runs), *fits], columns, terms))
    if found.best.fit.terms and not found.best.explains:
        yield from coupled(found, runs)


def _lower(problem: Forward, none: Fit, fits: Sequence[Fit], runs: Runs) -> Fit:
    """The fit without effect, refitted from the best fit if the effect of that one vanished: a local minimum."""
    best = min(fits, key=lambda f: f.cost, default=none)
    own = {u.name for term in best.terms for u in term.unknowns}
    sizes = [abs(x) for u, x in zip(best.unknowns, best.x, strict=True) if u.name in own]
    if not sizes or max(sizes) > _NO_SIZE or best.cost > none.cost - at.FIRST:
        return none
    (again,) = problem.refit([()], best, runs)
    return again if again is not None and again.cost < none.cost else none


def coupled(found: Compared, runs: Runs) -> Iterator[Compared]:
    """Add all pairs of effects, started from zero. Then refit the pairs near the best, or that share an effect with it,
    from each of their single fits."""
    alone = {n.fit.terms[0]: n.fit for n in found.ranked if len(n.fit.terms) == 1}
    couples = [(a, b) for a, b in combinations(found.terms, 2) if joins(b, (a,))]
    for first, fit in alone.items():  # and effects that can act only if another one does
        network = extended(found.problem.network, fit)
        couples += [(first, after) for after in followers(network, found.problem.site, found.terms)]
    lowest = min(n.fit.cost for n in found.ranked)
    yield (found := found.joined_by(found.problem.refit(couples, runs=runs, known=lowest)))
    best = found.best
    near = {n.key for n in found.ranked if n.score < best.score + at.NEAR}
    for term, fit in alone.items():
        shared = term in best.fit.terms
        mine = [c for c in couples if term in c and (shared or names_of(c) in near)]
        found = found.joined_by(found.problem.refit(mine, fit, runs))
    yield found


# --- several recordings -----------------------------------------------------------------------------------------------


def name_together(problem: Several, alone: Sequence[Naming], terms: Terms, runs: Runs) -> Naming:
    """The verdict on all recordings. alone : the verdict on each by itself.

    It is incomplete if the time limit ended one of these, or the comparison.
    Raises OutOfTime if the limit is reached before the model without effect was refitted to all recordings.
    """
    if problem.accuracy:
        last = compared_first_model(problem, terms, runs, [n.fit.terms for naming in alone for n in naming.members])
    else:
        last = last_of(_stages(problem, alone, terms, runs))
        last = compared_with_errors(last, runs) if problem.site is None and not last.best.explains else last
    several, none, complete = last.problem, last.none.fit, all(naming.complete for naming in alone)
    assert isinstance(several, Several)
    freed = (lambda n: None) if problem.accuracy else (lambda n: several.beside(n.fit))
    naming = profiled(decided(replace(last, complete=complete and last.complete), freed), runs)
    far = problem.site is None and is_far(several, none)
    return replace(naming, nearest=none if far else None)


def _stages(problem: Several, alone: Sequence[Naming], terms: Terms, runs: Runs) -> Iterator[Compared]:
    """The comparison after every stage."""
    base = _base(problem, [naming.base.fit for naming in alone], runs)
    yield (found := Compared.of(problem, [base], {}, terms))
    columns = problem.columns(base, found.sought, runs)
    hypotheses = _hypotheses(found, alone, promised(base, found.sought, columns))
    for i in range(0, len(hypotheses), at.FEW):
        fits = _refitted(problem, hypotheses[i : i + at.FEW], alone, base, columns, runs)
        yield (found := replace(found.joined_by(fits), columns=columns))
    yield (found := _with_base(exact(problem, found.fits, columns, terms, runs), base, runs))
    if found.best.fit.terms and not found.best.explains:
        for more in coupled(found, runs) if problem.site else _with_one_more(found, runs):
            yield (found := _with_base(more, base, runs))
    yield (found := found.at_minimum(runs))
    if problem.site is None:
        yield from set_apart(found, runs)


def _base(problem: Several, alone: Sequence[Fit], runs: Runs) -> Fit:
    """The model without effect, fitted from the start of lowest cost: as given, a fit to one recording, or the mean of
    these.

    If that ends far from the recordings, the nearest is looked for (:func:`.approximate.nearest`).
    """
    members = [*problem.begin(()), *_of_each(problem, (), alone)]
    (found,) = problem.searched_from(problem.nearest([members], runs), runs)
    if found is None:
        found = from_afar(problem, problem.hypothesis(()), runs) if problem.site is None else None
    elif problem.site is None:
        with suppress(OutOfTime):
            found = nearest(problem, found, runs) or found
    if found is None:
        runs.check()
        raise InputError("the model as given cannot be simulated with these recordings")
    return found


def _of_each(problem: Several, terms: Terms, alone: Sequence[Fit]) -> list[Member]:
    """Starting points of a hypothesis: the fit to each recording, and their mean. alone : these fits."""
    unknowns, low_high = problem.hypothesis(terms), bounds(problem.hypothesis(terms))
    own = {
        f"{u.name} of {label}": x
        for fit, label in zip(alone, problem.labels, strict=True)
        for u, x in zip(fit.unknowns, fit.x, strict=True)
    }
    each = [{u.name: x for u, x in zip(fit.unknowns, fit.x, strict=True)} | own for fit in alone]
    points = [np.array([known.get(u.name, 0.0) for u in unknowns]) for known in each]
    return [Member(terms, unknowns, np.clip(x, *low_high)) for x in (*points, np.mean(points, axis=0))]


def _with_base(found: Compared, base: Fit, runs: Runs) -> Compared:
    """The comparison with the model without effect refitted under the last weights from ``base``. If much is missing,
    the one linear step to new weights leads other fits far off, and the FMUs are judged against this model."""
    (again,) = found.problem.refine([base], runs)
    return found if again is None else found.with_none(again)


def _hypotheses(
    found: Compared, alone: Sequence[Naming], columns: tuple[float, list[tuple[float, PlacedEffect]]]
) -> list[Terms]:
    """The hypotheses near the best of each recording, and those that promise most on all together."""
    chosen = dict[str, Terms]()
    for naming in alone:
        near = [n for n in naming.ranked if n.fit.terms and n.score < naming.ranked[0].score + at.NEAR]
        for n in near if found.problem.site else (*naming.members, *near[: at.FEW]):
            chosen.setdefault(n.key, n.fit.terms)
    for _, term in columns[1] if found.problem.site else columns[1][: at.FEW]:
        chosen.setdefault(term.label, (term,))
    return list(chosen.values())


def _refitted(
    problem: Several, hypotheses: Sequence[Terms], alone: Sequence[Naming], base: Fit, columns: dict[str, Array],
    runs: Runs,
) -> list[Fit]:  # fmt: skip
    """Hypotheses refitted to all recordings, each from the start of lowest cost: without effect, or a single fit."""
    choices, known = [], derivatives(base, hypotheses, columns)
    for terms in hypotheses:
        own = [{n.key: n.fit for n in naming.ranked}.get(names_of(terms)) for naming in alone]
        fits = [naming.base.fit if fit is None else fit for fit, naming in zip(own, alone, strict=True)]
        begun = [m for m, fit in zip(_of_each(problem, terms, fits), [*own, base], strict=True) if fit is not None]
        choices.append([*problem.begin(terms, base), *begun])
    return there(problem.searched_from(problem.nearest(choices, runs, base), runs, known))


def _with_one_more(found: Compared, runs: Runs) -> Iterator[Compared]:
    """Add second effects beside the best: the effects whose derivatives promise most."""
    first, problem = found.best.fit, found.problem
    if len(first.terms) >= at.MOST_EFFECTS:
        return
    labels = {t.label for t in first.terms}
    others = [t for t in found.sought if t.label not in labels and not t.rewires]
    best, gained = promised(first, others, problem.columns(first, others, runs))
    both = [(*first.terms, t) for score, t in gained[: at.FEW] if score < best - at.SECOND]
    if both:
        yield found.joined_by(problem.refit(both, first, runs)).polished(runs)
