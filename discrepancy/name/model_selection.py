"""Name the missing effect: which hypotheses of the catalogue explain the record, and which cannot be ruled out.

A network: where something acts is found first (:mod:`fitting.inference.source_maps.source_map`), with what every artery
has of its own; then which laws of the catalogue are what acts there (:mod:`discrepancy.name.at_places`). A number that
stands out from its kind is no deviation (:mod:`discrepancy.name.individual_walls`).

A bench: every effect of the one wall and its sensors is refitted, as a refit costs a tenth of a second, and every two
where none explains the record. What two effects are is not seen from the best single one: a lag beside a slow catheter
is another catheter from afar, and a relaxation is nothing where its search begins, until the lag is there.

All are compared by evidence (:mod:`discrepancy.name.scoring`), exact and with an error of the model beside them. The
class holds all that the data cannot rule out (:mod:`discrepancy.name.verdict`). One effect is named only if the class
has one member; of two together the best pair is, with the class beside it. Where more than noise remains beside the
best, the answer is partial, and unknown if nothing of the catalogue earns its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

from fitting.inference.extended_network import extended
from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import Term, followers, joins
from fitting.inference.model_discrepancy import Beside
from fitting.inference.models.bench import Bench
from fitting.inference.models.network import NetworkProblem
from fitting.inference.runs import Runs
from fitting.inference.source_maps.beside import found_beside, map_beside, without_errors
from fitting.inference.source_maps.source_map import SourceMap, source_map
from solver.errors import InputError

from .. import thresholds as at
from .at_places import named_at
from .individual_walls import set_apart
from .intervals import profiled
from .nearest import compared_with, nearest
from .scoring import Compared, Named, last_of, names_of, there
from .verdict import Naming, decided

COMMON, INDIVIDUAL = "common", "individual"
_MAPPED = 0.6  # of the time limit, at most, which the source map may take
_NO_SIZE = 0.05  # of x: an effect smaller than that did not lower the cost itself


def name(problem: Forward, terms: Sequence[Term], runs: Runs | None = None, walls: str | None = None) -> Naming:
    """The verdict on one record.

    walls : COMMON or INDIVIDUAL; default: INDIVIDUAL, whose spread the record tells and which may be none. Where time
    runs out (``runs``), the verdict is the best so far, and not complete.
    Raises InputError if the model as given cannot be simulated with this record.
    """
    runs = runs or Runs()
    whole, terms = problem if walls == COMMON else problem.individual(), tuple(terms)
    found = None
    if isinstance(whole, NetworkProblem):
        found = source_map(whole, runs.part(_MAPPED))
        search = named_at(whole.at((), found.unknowns, found.x), found, terms, runs)
    else:
        search = _of_bench(whole, terms, runs)
    known, complete = last_of(_with_what_stands_out(search, runs))
    near = nearest(known, replace(runs, deadline=None))
    if near is not None:
        known, ended = last_of(compared_with(known, near, runs))
        near, complete = known.none.fit, complete and ended
    naming = decided(known, terms, _freed(known, found, runs), complete)
    return replace(profiled(naming, runs), map=found, nearest=near)


def _freed(found: Compared, where: SourceMap | None, runs: Runs) -> Callable[[Named], Beside | None]:
    """Free sources beside a hypothesis of a network: those of the map beside no effect, those by evidence beside a law;
    one that leaves more than noise, and beside which none is worth its price, competes as it is. On a bench, an error
    of the wall law."""
    problem, runs = found.problem, replace(runs, deadline=None)
    if isinstance(problem, Bench):
        return lambda n: problem.beside(n.fit)
    assert isinstance(problem, NetworkProblem)

    def beside(n: Named) -> Beside | None:
        if n.fit.terms or where is None:
            none = None if n.explains else without_errors(problem, n.fit)
            return found_beside(problem, n.fit) or none
        return map_beside(problem, n.fit, where, runs) if where.signals else None

    return beside


def _with_what_stands_out(search: Iterator[Compared], runs: Runs) -> Iterator[Compared]:
    """What is known after every stage; at last, with what stands out in the animal's walls."""
    known = None
    for known in search:
        yield known
    if known is not None:
        yield from set_apart(known, runs)


# --- one wall ---------------------------------------------------------------------------------------------------------


def _of_bench(problem: Forward, terms: tuple[Term, ...], runs: Runs) -> Iterator[Compared]:
    """What is known of one wall after every stage."""
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
    """The fit without effect, repeated from a fit of lower cost whose effect vanished: a local minimum was left."""
    best = min(fits, key=lambda f: f.cost, default=none)
    own = {u.name for term in best.terms for u in term.unknowns}
    sizes = [abs(x) for u, x in zip(best.unknowns, best.x, strict=True) if u.name in own]
    if not sizes or max(sizes) > _NO_SIZE or best.cost > none.cost - at.FIRST:
        return none
    (again,) = problem.refit([()], best, runs)
    return again if again is not None and again.cost < none.cost else none


def coupled(found: Compared, runs: Runs) -> Iterator[Compared]:
    """With every two effects, searched from nothing, and then again those that are near the best, or share one with it,
    from either of the two alone."""
    alone = {n.fit.terms[0]: n.fit for n in found.ranked if len(n.fit.terms) == 1}
    couples = [(a, b) for a, b in combinations(found.terms, 2) if joins(b, (a,))]
    for first, fit in alone.items():  # and each that can act only where another does
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
