"""Name what acts at the places of the source map: the catalogue's laws there, each refitted in full.

A law begins where the map ended: with the walls that the map found, the other places keeping their free sources, at the
size with which it comes nearest to the record. Walls that were fitted without it would have taken up a part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from fitting.inference.beside import found_beside
from fitting.inference.fit import Fit, Member, sizes_of
from fitting.inference.gauss_newton import bounded_step
from fitting.inference.network import NetworkProblem
from fitting.inference.places import NUMBER, Place
from fitting.inference.simulator import Runs
from fitting.inference.source_map import SourceMap, is_noise
from fitting.inference.terms import Term, effect_of, joins, placed
from fitting.inference.unknown import bounds, penalty, precisions
from solver.effect import ALL_PLACES, CHANNEL, WALL
from solver.errors import InputError

from . import thresholds as at
from .animal import implausible
from .scoring import Compared, exact, names_of, promised, there

Array = np.ndarray

TYPICAL = (1.0,)  # sizes at which many laws are looked at
SIZES = (0.3, *TYPICAL, 3.0)  # sizes at which a law may begin, beside its own starts
FARTHER = 5.0  # times the size that was tried, at most, where its linear promise lies farther


@dataclass(frozen=True)
class Begun:
    """A law at the size, or sizes, at which its search begins. left : the cost that is promised from there."""

    term: Term
    x: Array
    left: float


def _beside(problem: NetworkProblem, found: SourceMap, i: int) -> tuple[NetworkProblem, SourceMap]:
    """The problem with the free sources, and the map with the numbers that stand out, of all places but one."""
    others = [j for j in range(len(found.signals)) if j != i]
    return found.forced(problem, others), found.standing_out(others)


def _laws(problem: NetworkProblem, found: SourceMap, i: int, terms: Sequence[Term]) -> list[Term]:
    """The laws of a place of the map and of its segment, and those of places that do nearly as well beside the others:
    between two sites a wall, a drop, a loss and an outlet are told apart by their laws alone. A place that does no
    better than none is no such place."""
    mine, others = found.places[i], {p.key for j, p in enumerate(found.places) if j != i}
    most = min([at.NEAR, *(r.above for r in found.rivals if {p.key for p in r.places} == others)])
    near = [mine]
    for rival in found.rivals:
        new = [p for p in rival.places if p.key not in others]
        if rival.above < most and len(new) == 1 and others <= {p.key for p in rival.places}:
            near.append(new[0])
    chosen = dict[tuple[str, int], Term]()
    for place in near:
        for t in terms:
            if acts_at(t, place) or (place is mine and in_segment(t, place)):
                for each in _along(problem, t, place):
                    chosen.setdefault((each.label, len(each.unknowns)), each)
    return list(chosen.values())


def in_segment(term: Term, place: Place) -> bool:
    """Whether a law acts in the segment of a place, or at its end."""
    return place.kind != CHANNEL and not term.is_sensor and term.place == place.segment


def acts_at(term: Term, place: Place) -> bool:
    """Whether a law may be what acts at a place."""
    if place.kind == NUMBER:
        return in_segment(term, place)
    return effect_of(term).source == place.kind and term.place == place.name


def _along(problem: NetworkProblem, term: Term, place: Place | None = None) -> list[Term]:
    """A law where it usually lies, and, of a part of a segment, begun where the map has it, or anywhere; a part of a
    wall anywhere alone, as it is mostly whole walls that differ."""
    whole = place is not None and (place.kind == NUMBER or effect_of(term).source == WALL)
    moved = None if whole else placed(problem.network, term, [0.0] * len(term.unknowns))
    if moved is None:
        return [term]
    first = len(term.unknowns)
    if place is not None and place.at is not None:
        (position, *_) = moved.unknowns[first:]
        x = (place.at - position.nominal) / position.size
        starts = [min(moved.starts, key=lambda start: abs(start[first] - x))]
        starts = [(*starts[0][:first], x, *starts[0][first + 1 :])]
    else:
        starts = list(moved.starts)
    return [term, replace(moved, starts=tuple(starts))]


def _nearest(
    problem: NetworkProblem, found: SourceMap, laws: Sequence[Term], runs: Runs, sizes: Sequence[float] = SIZES
) -> list[Begun]:
    """Laws at the size with which each promises to come nearest to the record, linear in the size and in the walls.

    problem : with what acts beside them. sizes : that are tried.
    """
    trials = [(t, x) for t in laws for x in _sizes(t, sizes)]
    (none,) = problem.observe([_member(problem, found, [])], runs)
    if none is None:
        return []
    shown = problem.observe([_member(problem, found, [each]) for each in trials], runs)
    z0, J = problem.residual(none), problem.target.whiten(found.J)
    best: dict[int, Begun] = {}
    for (t, x), X in zip(trials, shown, strict=True):
        if X is not None:
            begun = _promised(found, J, z0, problem.residual(X), t, x)
            if id(t) not in best or begun.left < best[id(t)].left:
                best[id(t)] = begun
    return sorted(best.values(), key=lambda b: b.left)


def _promised(found: SourceMap, J: Array, z0: Array, z: Array, term: Term, x: Array) -> Begun:
    """A law where it may begin, with the residual z there and z0 without it: its size and the walls moved to where they
    promise to leave least."""
    sizes = np.array([u.of_size for u in term.unknowns])
    lead = int(np.argmax(np.where(sizes, np.abs(x), -1.0)))
    low, high = (
        np.append(wall, own[lead]) for wall, own in zip(bounds(found.unknowns), bounds(term.unknowns), strict=True)
    )
    column = (z - z0) / x[lead] if x[lead] else np.zeros_like(z)
    prior = np.append(precisions(found.unknowns), 0.0)
    step = bounded_step(np.column_stack([J, column]), z, prior, np.append(found.x, x[lead]), low, high)
    size = float(np.clip(x[lead] + step[-1], *sorted((x[lead] / FARTHER, x[lead] * FARTHER))))
    begin = np.where(sizes, x * (size / x[lead] if x[lead] else 1.0), x)
    left = z + J @ step[:-1] + column * step[-1]
    return Begun(term, begin, float(left @ left) + penalty(prior[:-1], found.x + step[:-1]))


def _sizes(term: Term, sizes: Sequence[float]) -> list[Array]:
    """Where the search of a law may begin: its own starts, and these sizes, of either sign if it may be."""
    low, high = bounds(term.unknowns)
    found = [np.array(start) for start in term.starts if len(start) == len(term.unknowns)]
    if effect_of(term).rewires:
        return [np.clip(x, low, high) for x in (*found, np.zeros(len(low)))]
    along = list(found) if term.moves_along else [np.zeros(len(term.unknowns))]
    for start in along:
        for size in (sign * size for size in (sizes if len(along) == 1 else TYPICAL) for sign in (1.0, -1.0)):
            for which in _which(term):
                x = start.copy()
                x[which] = size
                found.append(x)
    inside = [x for x in found if np.all((x >= low) & (x <= high))]
    return inside or [np.clip(found[0], low, high)]


def _which(term: Term) -> list[list[int]]:
    """Of a law's numbers that are sizes each by itself, and all of them together."""
    sizes = [i for i, u in enumerate(term.unknowns) if u.of_size]
    return [*([i] for i in sizes), *([sizes] if len(sizes) > 1 else [])]


def _member(problem: NetworkProblem, found: SourceMap, laws: Sequence[tuple[Term, Array]]) -> Member:
    """A hypothesis with the walls of the map and its laws where they begin."""
    terms = tuple(t for t, _ in laws)
    unknowns = problem.hypothesis(terms)
    x = dict(zip((u.name for u in found.unknowns), found.x, strict=True))
    for t, own in laws:
        x |= dict(zip((u.name for u in t.unknowns), own, strict=True))
    return Member(terms, unknowns, np.clip([x.get(u.name, 0.0) for u in unknowns], *bounds(unknowns)))


def single(problem: NetworkProblem, found: SourceMap, laws: Sequence[Sequence[Term]], runs: Runs) -> list[Fit]:
    """Laws of any place of the map, refitted without what the map has at the others: one may be all that acts."""
    every = {(t.label, len(t.unknowns)): t for some in laws for t in some}
    plain, walls = found.forced(problem, []), found.standing_out(())
    chosen = _few(_nearest(plain, walls, list(every.values()), runs))
    return refitted(plain, walls, [[(b.term, b.x)] for b in chosen], runs)


def alone(problem: NetworkProblem, found: SourceMap, laws: Sequence[Sequence[Term]], runs: Runs) -> list[list[Fit]]:
    """For every place the laws there that may explain the record beside the free sources of the other places, refitted
    beside these; nearest first."""
    fits = []
    for i, some in enumerate(laws):
        beside, walls = _beside(problem, found, i)
        few = [[(b.term, b.x)] for b in _few(_nearest(beside, walls, some, runs))]
        own = refitted(beside, walls, few, runs, explaining=True)
        fits.append(sorted(own, key=lambda f: f.cost))
    return fits


def _few(begun: Sequence[Begun]) -> list[Begun]:
    """The laws that are refitted: the nearest, all that promise so much that they might not be ruled out beside the
    nearest (few sensors see many alike), and every outlet of another kind, which begins far off."""
    most = begun[0].left + at.RULED_OUT if begun else 0.0
    return [b for k, b in enumerate(begun) if k < at.FEW or b.left < most or b.term.rewires]


def together(problem: NetworkProblem, found: SourceMap, fits: Sequence[Sequence[Fit]], runs: Runs) -> list[Fit]:
    """Laws of two places together, each of those that do nearly as well as the best at its place, refitted; where none
    leaves noise alone beside the free sources of the other places, no law is what acts there."""
    near = [
        [f for f in some if f.cost < some[0].cost + at.NEAR][: at.BRANCHES]
        for some in fits
        if some and is_noise(some[0].chi2, len(some[0].z))
    ]
    both = [
        [(a.terms[0], _own(a)), (b.terms[0], _own(b))]
        for some, others in combinations(near, 2)
        for a, b in product(some, others)
        if a.terms[0].label != b.terms[0].label and joins(b.terms[0], a.terms) and joins(a.terms[0], b.terms)
    ]
    return refitted(found.forced(problem, []), found.standing_out(()), both, runs)


def _own(fit: Fit) -> Array:
    """Where a single law ended."""
    x = dict(zip((u.name for u in fit.unknowns), fit.x, strict=True))
    return np.array([x[u.name] for u in fit.terms[0].unknowns])


def refitted(
    problem: NetworkProblem, found: SourceMap, hypotheses: Sequence[Sequence[tuple[Term, Array]]], runs: Runs,
    explaining: bool = False,
) -> list[Fit]:  # fmt: skip
    """Hypotheses searched for from the walls of the map, and where their laws begin: from afar first, with an error
    granted to the model as in the map, and then to the noise.

    explaining : those alone that may leave noise alone: what leaves more with an error granted leaves more without.
    """
    if not hypotheses:
        return []
    wide = problem.granted(at.AFAR)
    white = wide.target.whiten(found.J)
    known = {u.name: column for u, column in zip(found.unknowns, white.T, strict=True)}
    members = [_member(problem, found, laws) for laws in hypotheses]
    seen = there(wide.searched_from(members, runs, known))
    seen = [f for f in seen if not explaining or is_noise(f.chi2, len(f.z))]
    return there(problem.relaxed(problem.restated(seen, wide), runs))


def named_at(problem: NetworkProblem, found: SourceMap, terms: tuple[Term, ...], runs: Runs) -> Iterator[Compared]:
    """What is known after every stage. found : the map of the problem's record."""
    none = refitted(problem, found, [[]], runs)
    if not none:
        raise InputError("the model as given cannot be simulated with this record")
    result = Compared.of(problem, none, {}, terms)
    yield result
    laws = [_laws(problem, found, i, terms) for i in range(len(found.signals))]
    fits = [*none, *single(problem, found, laws, runs)]
    yield (result := exact(problem, fits, {}, terms, runs))
    if len(laws) > 1 and not result.best.explains:
        fits += together(problem, found, alone(problem, found, laws, runs), runs)
        yield (result := exact(problem, fits, {}, terms, runs))
    columns = result.problem.columns(result.none.fit, result.sought, runs)
    yield (result := result.with_columns(columns))
    if result.none.explains:
        yield (result := _also_promising(result, columns, runs))
        if implausible(result.none.fit):
            yield (result := _of_the_file(result, found, runs))
    left = _left(result)
    if not result.best.explains and (left or not result.best.fit.terms):
        yield (result := _elsewhere(result, found, runs))
        left = _left(result)
    if left:
        result = result.at_minimum(runs)
        more = [*_refined(result, runs), *_with_one_more(result, found, left, runs)]
        yield (result := result.joined_by(more).polished(runs))
    if alike := _one_replaced(result, runs):
        yield (result := result.joined_by(alike).polished(runs))
    yield result.at_minimum(runs)


def _also_promising(result: Compared, columns: Mapping[str, Array], runs: Runs) -> Compared:
    """With the laws that add evidence to the model without effect by their columns, where that explains the record:
    weak ones that act everywhere are no single place, and few sensors show none."""
    base, tried = result.none.fit, {n.label for n in result.ranked}
    best, gained = promised(base, result.sought, columns)
    near = [t for k, (score, t) in enumerate(gained) if k < at.FEW or score < gained[0][0] + at.RULED_OUT]
    worth = {t.label for score, t in gained if score < best - at.FIRST}
    chosen = [t for t in near if t.label in worth - tried]
    if not chosen:
        return result
    return result.joined_by(result.problem.refit([(t,) for t in chosen], base, runs, columns)).polished(runs)


def _of_the_file(result: Compared, found: SourceMap, runs: Runs) -> Compared:
    """With the laws that promise most from the walls of the file, and every outlet of another kind: where the model
    without effect explains the record as an animal alone that there hardly is, its walls say nothing of where to begin.
    """
    problem = result.problem
    assert isinstance(problem, NetworkProblem)
    plain, walls = found.forced(problem, []), replace(found, x=np.zeros(len(found.x)))
    laws = [t for t in result.terms if t.rewires or t in result.sought]
    chosen = _few(_nearest(plain.granted(at.AFAR), walls, laws, runs, TYPICAL))
    return result.joined_by(refitted(plain, walls, [[(b.term, b.x)] for b in chosen], runs)).polished(runs)


def _elsewhere(result: Compared, found: SourceMap, runs: Runs) -> Compared:
    """With the laws that promise most from the walls of the map: those that act everywhere, as what changes every wave
    is no source of a fixed shape, and those anywhere. A map that explains the record knows where it is: there, or where
    its rivals are."""
    problem, tried = result.problem, {n.label for n in result.ranked}
    assert isinstance(problem, NetworkProblem)
    plain, walls = found.forced(problem, []), found.standing_out(())
    known = {p.segment for places in (found.places, *(r.places for r in found.rivals)) for p in places}
    sought = [
        t for t in result.terms if not t.rewires and (not found.explains or t.place == ALL_PLACES or t.place in known)
    ]
    # a part of a wall anywhere, too, also where every wall differs: it is whole walls that do
    laws = [
        each
        for t in sought
        for each in _along(problem, t)
        if each.moves_along or (t.label not in tried and t in result.sought)
    ]
    likely = [b.term for b in _nearest(plain, walls, laws, runs, TYPICAL)[: 2 * at.FEW]]
    chosen = _nearest(plain, walls, likely, runs)[: at.FEW]
    fits = refitted(plain, walls, [[(b.term, b.x)] for b in chosen], runs)
    return result.joined_by(fits).polished(runs)


def _left(result: Compared) -> tuple[Place, ...]:
    """Where something acts beside the law, or the laws, of the best hypothesis."""
    assert isinstance(result.problem, NetworkProblem)
    found = found_beside(result.problem, result.best.fit) if result.best.fit.terms else None
    return () if found is None else found.places


def _with_one_more(result: Compared, found: SourceMap, left: Sequence[Place], runs: Runs) -> list[Fit]:
    """The best law with another, where something acts beside it, that adds evidence beside it by its columns. Where one
    place is enough for all that acts, a law that explains a part of it is the wrong one, and no second one is missing.
    """
    first, problem = result.best.fit, result.problem
    if len(first.terms) >= at.MOST_EFFECTS or (found.explains and len(found.places) == 1 and not result.best.explains):
        return []
    labels = {t.label for t in first.terms}
    able = [t for t in result.sought if t.label not in labels and not t.rewires and joins(t, first.terms)]
    others = [t for t in able if any(acts_at(t, place) or in_segment(t, place) for place in left)]
    columns = problem.columns(first, others, runs)
    best, gained = promised(first, others, columns)
    both = [(*first.terms, t) for score, t in gained[: at.FEW] if score < best - at.SECOND]
    return there(problem.refit(both, first, runs, columns)) if both else []


def _one_replaced(result: Compared, runs: Runs) -> list[Fit]:
    """The best two laws with one of them replaced by another law of its place that was found alone: of two that look
    alike the more flexible one was the better while the other effect was missing, which it made up for. The best, be it
    one that is never named for what the record cannot show."""
    best, problem, members = min(result.every, key=lambda n: n.score).fit, result.problem, list[Member]()
    assert isinstance(problem, NetworkProblem)
    tried = {n.key for n in result.ranked}
    x = dict(zip((u.name for u in best.unknowns), best.x, strict=True))
    single = [n.fit for n in result.ranked if len(n.fit.terms) == 1 and not n.fit.terms[0].rewires]
    for i, t in enumerate(best.terms if len(best.terms) > 1 else ()):
        rest = (*best.terms[:i], *best.terms[i + 1 :])
        for fit in (f for f in single if f.terms[0].place == t.place and joins(f.terms[0], rest)):
            terms = (*rest, *fit.terms)
            if names_of(terms) not in tried and fit.terms[0].label not in {r.label for r in rest}:
                own = x | dict(zip((u.name for u in fit.terms[0].unknowns), _own(fit), strict=True))
                unknowns = problem.hypothesis(terms)
                members.append(Member(terms, unknowns, np.array([own.get(u.name, 0.0) for u in unknowns])))
    return there(problem.searched_from(members, runs, best.columns)) if members else []


def _refined(result: Compared, runs: Runs) -> list[Fit]:
    """The best law finer: one that acts everywhere with a size of its own for every segment, one of a part of a segment
    wherever it lies, and however long it is."""
    first, problem, hypotheses = result.best.fit, result.problem, list[tuple[Term, ...]]()
    for i, t in enumerate(first.terms):
        for finer in (problem.refined(first, t), placed(problem.network, t, sizes_of(first, t))):
            if finer is not None:
                hypotheses.append((*first.terms[:i], finer, *first.terms[i + 1 :]))
                if len(first.terms) > 1:  # the other one may have stood in for it
                    hypotheses.append((finer,))
    return there(problem.refit(hypotheses, first, runs)) if hypotheses else []
