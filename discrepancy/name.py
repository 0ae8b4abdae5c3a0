"""Name the missing effect: which hypotheses of the catalogue explain the record, and which cannot be ruled out.

1. Walls with all in common: a score test of every effect at every place, the best refitted in full with what every
   animal has of its own under priors; a second effect beside the best where one alone leaves something, on a bench
   every two (:mod:`discrepancy.couples`).
2. Walls that differ (:mod:`discrepancy.walls`), where more than the model without effect is needed: every artery with
   deviations of its own, whose spread the record tells; the same again. A number that stands out from its kind is no
   deviation (:mod:`discrepancy.outliers`).
3. All are compared by evidence (:mod:`discrepancy.weigh`), exact and with an error of the model beside them.
4. The class holds all that the data cannot rule out (:mod:`discrepancy.verdict`). One effect is named only if the class
   has one member; of two together the best pair is, with the class beside it. Where more than noise remains beside the
   best, the answer is partial, and unknown if nothing of the catalogue earns its place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.simulator import OutOfTime, Runs
from fitting.inference.terms import Term
from solver.errors import InputError

from . import thresholds as at
from .along import moved_along
from .compare import Compared, hopeless, rewirings
from .couples import coupled
from .further import further
from .intervals import profiled
from .outliers import set_apart
from .verdict import Naming, decided
from .walls import with_own_walls
from .weigh import scores, shortlist

COMMON, INDIVIDUAL = "common", "individual"


def name(problem: Forward, terms: Sequence[Term], runs: Runs | None = None, walls: str | None = None) -> Naming:
    """The verdict on one record.

    walls : COMMON or INDIVIDUAL; default: as the record is more probable. Where time runs out (``runs``), the verdict
    is the best so far, and not complete.
    Raises InputError if the model as given cannot be simulated with this record.
    """
    runs = runs or Runs()
    stages, found, complete = _stages(problem, tuple(terms), runs, walls), None, True
    try:
        while (later := next(stages, None)) is not None:
            found = later
    except OutOfTime:
        complete = False
        if found is None:
            raise
    assert found is not None
    return profiled(decided(found, terms, complete), runs)


def _stages(problem: Forward, terms: tuple[Term, ...], runs: Runs, walls: str | None) -> Iterator[Compared]:
    """What is known after every stage; at last, with what stands out in the animal's walls."""
    found = None
    for found in _searched(problem, terms, runs, walls):
        yield found
    if found is not None:
        yield from set_apart(found, runs)


def _searched(problem: Forward, terms: tuple[Term, ...], runs: Runs, walls: str | None) -> Iterator[Compared]:
    """What is known after every stage of the search for effects."""
    own = problem.individual()
    if own is problem or walls == COMMON:
        for found in _with_common_walls(problem, terms, runs):
            yield found
        if problem.site is None:
            yield from further(found, runs)
        elif found.best.fit.terms and not found.best.explains:
            yield from coupled(found, runs)
    elif walls == INDIVIDUAL:
        yield from _with_individual_walls(own, terms, runs)
    else:
        yield from _with_either(problem, terms, runs)


def _with_individual_walls(own: Forward, terms: tuple[Term, ...], runs: Runs) -> Iterator[Compared]:
    """Walls that differ alone."""
    last = None
    for last in with_own_walls(own, terms, runs):
        yield last
    if last is None:
        raise InputError("the model with walls that differ cannot be simulated with this record")
    yield from further(last, runs)


def _with_either(problem: Forward, terms: tuple[Term, ...], runs: Runs) -> Iterator[Compared]:
    """Walls with all in common and, where something is missing, walls that differ; then more effects with both.

    Two effects of walls with all in common are tried even where an effect of walls that differ explains the record:
    they are fewer numbers; not where the best is hopeless. Raises OutOfTime, at the end, where walls with all in common
    had no time to be compared.
    """
    common, late = None, None
    try:
        # an animal farther off is left to walls that differ, which have the whole range
        for common in _with_common_walls(
            problem.within(at.FARTHEST), terms, runs.part(at.IN_COMMON), runs.part(at.BEGUN)
        ):
            yield common
            if hopeless(common):
                break
    except OutOfTime as error:  # far from any animal simulations are slow; walls that differ may still explain it
        runs.check()
        late = error
    if common is None:
        yield from _with_individual_walls(problem.individual(), terms, runs)
    else:
        yield from _beside(common, problem.individual(), terms, runs)
    if late is not None:
        raise late


def _beside(common: Compared, individual: Forward, terms: tuple[Term, ...], runs: Runs) -> Iterator[Compared]:
    """Walls that differ beside what is known of walls with all in common; then more effects with both."""
    if not common.best.fit.terms and common.none.explains:
        return
    found, own = common, None
    for own in with_own_walls(individual, terms, runs, common):
        yield (found := common.merged(own))
    if not found.best.fit.terms and found.best.explains:
        return
    if not (common.best.explains or hopeless(common)):
        for later in further(common, runs, 1 if found.best.explains else at.BRANCHES):
            yield (found := found.merged(later))
    if own is not None and not found.best.explains:
        for later in further(own, runs):
            yield (found := found.merged(later))
    if found.best.explains and (elsewhere := moved_along(found, runs)):
        yield found.joined_by(elsewhere)


def _with_common_walls(
    problem: Forward, terms: tuple[Term, ...], runs: Runs, begun: Runs | None = None
) -> Iterator[Compared]:
    """What is known after every stage. begun : of the first one, without effect; by default ``runs``."""
    (base,) = problem.refit([()], runs=begun or runs)
    if base is None:
        raise InputError("the model as given cannot be simulated with this record")
    found = Compared.of(problem, [base], {}, terms)
    if found.none.misfit < at.FAR_OFF:  # else the best hypothesis will tell how fine the steps must be
        found = found.polished(runs)
    yield found
    problem, base = found.problem, found.none.fit
    columns = problem.columns(base, terms, runs)
    # on a bench, every refit is cheaper than a wrong guess: a strong relaxation promises nothing where it begins
    most = at.SHORTLIST if problem.site is None else len(terms)
    plain = shortlist(scores(base, columns, terms), most)
    fits = [f for f in problem.refit([(t,) for t in plain], base, runs, columns) if f is not None]
    yield (found := Compared.of(problem, [_lower(problem, base, fits, runs), *fits], {False: columns}, terms))
    yield (found := _polished(found, runs))
    if rewiring := rewirings(found):
        problem, base = found.problem, found.none.fit
        lowest = min((n.fit.cost for n in found.ranked), default=base.cost)
        fits = [f for f in problem.refit(rewiring, base, runs, known=lowest) if f is not None]
        yield (found := _polished(found.joined_by(fits), runs))


def _polished(found: Compared, runs: Runs) -> Compared:
    """Polished where a hypothesis beats that without effect."""
    return found.polished(runs) if found.best.fit.terms else found


def _lower(problem: Forward, none: Fit, fits: Sequence[Fit], runs: Runs) -> Fit:
    """The fit without effect, repeated from a fit of lower cost whose effect vanished: a local minimum was left."""
    best = min(fits, key=lambda f: f.cost, default=none)
    own = {u.name for term in best.terms for u in term.unknowns}
    sizes = [abs(x) for u, x in zip(best.unknowns, best.x, strict=True) if u.name in own]
    if not sizes or max(sizes) > at.NO_SIZE or best.cost > none.cost - at.FIRST:
        return none
    (again,) = problem.refit([()], best, runs)
    return again if again is not None and again.cost < none.cost else none
