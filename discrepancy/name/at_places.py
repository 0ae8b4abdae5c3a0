"""Name the laws that act at the places of the source map: each law of the catalogue there is refitted in full.

A law starts from the walls of the map, at the size that promises the best fit. Walls that were fitted without the free
sources would have absorbed a part of the effect. Then other laws are tried instead of the best one, and beside it
(:func:`with_moves`).
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from fitting.inference.fit import Array, Fit, Member, sizes_of
from fitting.inference.forward import Forward
from fitting.inference.gauss_newton import Trial
from fitting.inference.hypothesis import PlacedEffect, effect_of, joins, placed
from fitting.inference.models.network import NetworkProblem
from fitting.inference.places import NUMBER, Place
from fitting.inference.runs import Runs
from fitting.inference.source_maps.place_model import with_signals
from fitting.inference.source_maps.source_map import SourceMap, found_beside, is_noise
from solver.errors import InputError
from solver.laws.effect import ALL_PLACES, CHANNEL

from .. import thresholds as at
from .individual_walls import implausible
from .law_starts import Base, Responses, along, key_of, nearest
from .scoring import Compared, Named, exact, names_of, promised, there

_ROUNDS = 3  # at most, of moves from the best hypothesis, while they find a better one

_Key = tuple[str, str, float | None]  # of a place


def _laws(problem: NetworkProblem, found: SourceMap, i: int, terms: Sequence[PlacedEffect]) -> list[PlacedEffect]:
    """Candidate laws for the i-th place of the map: those of the place and its segment, and those of places that fit
    nearly as well beside the other places. Between two sites, only their laws distinguish a wall, a pressure drop, a
    leak and an outlet. A place must fit better than a map without an i-th place."""
    mine, others = found.places[i], {p.key for j, p in enumerate(found.places) if j != i}
    most = min([at.NEAR, *(r.above for r in found.rivals if {p.key for p in r.places} == others)])
    near = [mine]
    for rival in found.rivals:
        new = [p for p in rival.places if p.key not in others]
        if rival.above < most and len(new) == 1 and others <= {p.key for p in rival.places}:
            near.append(new[0])
    chosen = dict[tuple[str, int], PlacedEffect]()
    for place in near:
        for t in terms:
            if acts_at(t, place) or (place is mine and in_segment(t, place)):
                for each in along(problem, t, place):
                    chosen.setdefault(key_of(each), each)
    return list(chosen.values())


def in_segment(term: PlacedEffect, place: Place) -> bool:
    """True if a law acts in the segment of a place, or at its end."""
    return place.kind != CHANNEL and not term.is_sensor and term.place == place.segment


def acts_at(term: PlacedEffect, place: Place) -> bool:
    """True if a law can be the cause of the source at a place."""
    if place.kind == NUMBER:
        return in_segment(term, place)
    return effect_of(term).source == place.kind and term.place == place.name


def base(problem: NetworkProblem, found: SourceMap) -> Base:
    """The walls of the map, without laws."""
    return Base(Member((), problem.hypothesis(()), found.x), problem.target.whiten(found.J))


def single(problem: NetworkProblem, found: SourceMap, laws: Sequence[Sequence[PlacedEffect]], runs: Runs) -> list[Fit]:
    """Single laws of any place, refitted without the free sources of the map: one law may explain all of them."""
    every = {key_of(t): t for some in laws for t in some}
    plain, walls = found.forced(problem, []), found.standing_out(())
    chosen = nearest(plain, base(plain, walls), list(every.values()), runs)
    return refitted(plain, walls, [[(b.term, b.x)] for b in chosen], runs)


def _beside(
    problem: NetworkProblem, found: SourceMap, others: Sequence[int], laws: Sequence[PlacedEffect], runs: Runs
) -> list[Fit]:
    """The laws that may explain the record beside the sources of other places (their courses are those of the map),
    refitted; lowest cost first."""
    beside, walls = found.forced(problem, others), found.standing_out(others)
    few = [[(b.term, b.x)] for b in nearest(beside, base(beside, walls), laws, runs)]
    fits = refitted(beside, walls, few, runs, explaining=True)
    if fits and not _explains(fits):  # the best one may explain it with other sizes in each segment, or at another part
        best = min(fits, key=lambda f: f.cost)
        fits += there(beside.refit([(finer,) for finer in _finer(problem, best, best.terms[0])], best, runs))
    return sorted(fits, key=lambda f: f.cost)


def _explains(fits: Sequence[Fit]) -> bool:
    """True if the best of some fits leaves only noise."""
    best = min(fits, key=lambda f: f.cost, default=None)
    return best is not None and is_noise(best.chi2, len(best.z))


def together(
    problem: NetworkProblem, found: SourceMap, couples: Iterable[tuple[Sequence[Fit], Sequence[Fit]]], runs: Runs
) -> list[Fit]:
    """Pairs of laws at two places, refitted: from each place the laws that fit nearly as well as its best. A place
    contributes no law if its best law leaves more than noise beside the free sources of the other places."""
    both = [
        [(a.terms[0], _own(a)), (b.terms[0], _own(b))]
        for some, others in couples
        for a, b in product(_near(some), _near(others))
        if a.terms[0].label != b.terms[0].label and joins(b.terms[0], a.terms) and joins(a.terms[0], b.terms)
    ]
    return refitted(found.forced(problem, []), found.standing_out(()), both, runs)


def _near(fits: Sequence[Fit]) -> list[Fit]:
    """At most FEW/2 laws of a place that fit nearly as well as its best; none if the best leaves more than noise."""
    return [f for f in fits if f.cost < fits[0].cost + at.NEAR][: at.FEW // 2] if _explains(fits) else []


def _own(fit: Fit) -> Array:
    """The parameters of the single law of a fit."""
    x = dict(zip((u.name for u in fit.unknowns), fit.x, strict=True))
    return np.array([x[u.name] for u in fit.terms[0].unknowns])


def refitted(
    problem: NetworkProblem, found: SourceMap, hypotheses: Sequence[Sequence[tuple[PlacedEffect, Array]]], runs: Runs,
    explaining: bool = False,
) -> list[Fit]:  # fmt: skip
    """Fit hypotheses from the walls of the map and the starting sizes of their laws: first with a model error, as in
    the map, to converge from far off, then with the noise alone.

    explaining : drop hypotheses that leave more than noise even with the model error; they would leave more without it.
    """
    if not hypotheses:
        return []
    wide = problem.granted(at.AFAR)
    begin = base(wide, found)
    members = [begin.with_laws(problem, laws) for laws in hypotheses]
    fits = there(wide.searched_from(members, runs, begin.columns))
    fits = [f for f in fits if not explaining or is_noise(f.chi2, len(f.z))]
    return there(problem.relaxed(problem.restated(fits, wide), runs, rough=True))


def named_at(
    problem: NetworkProblem, found: SourceMap, terms: tuple[PlacedEffect, ...], runs: Runs
) -> Iterator[Compared]:
    """The comparison after every stage. found : the source map of the problem's record."""
    none = refitted(problem, found, [[]], runs) or there(problem.refit([()], runs=runs))
    if not none:
        raise InputError("the model as given cannot be simulated with this record")
    result = Compared.of(problem, none, {}, terms)
    yield result
    result, lawless = yield from _of_the_map(problem, found, none, terms, runs)
    columns = result.problem.columns(result.none.fit, result.sought, runs)
    yield (result := replace(result, columns=columns))
    if result.none.explains:
        yield (result := _also_promising(result, columns, runs))
    tried, known = set[str](), Responses()
    for turn in range(_ROUNDS):
        best, unexplained = result.best.key, _leaves(result)
        if unexplained and result.best.fit.terms:
            result = result.at_minimum(runs)
            yield (result := result.joined_by(_refined(result, runs)).polished(runs))
        first = result.none if result.none.explains else result.best
        if turn == 0 and _has_absorbed(first):
            yield (result := _from_plausible_walls(result, first.fit, found, runs))
            best, unexplained = result.best.key, _leaves(result)
        if lawless and not result.best.explains and lawless & _needed(result):
            break
        # if one place accounts for all that acts, a law that explains only a part of it is the wrong one
        more = unexplained and not (found.explains and len(found.places) == 1 and not result.best.explains)
        rests = _rests(_leading(result).terms, unexplained, more)
        yield (result := with_moves(result, runs, unexplained, more, tried, known))
        if result.best.key == best:
            break
        if not unexplained:  # from there on, beside the same laws, the same others promise the same
            tried |= {names_of(rest) for rest in rests}
    yield result.at_minimum(runs)


def _of_the_map(
    problem: NetworkProblem, found: SourceMap, none: Sequence[Fit], terms: tuple[PlacedEffect, ...], runs: Runs
) -> Generator[Compared, None, tuple[Compared, set[_Key]]]:
    """The comparison after every stage with the laws that act at the places of the map. Returns the last one, and the
    places that rule out that laws of the catalogue explain the record.

    The free source at a place may take any course, also that of every law there, so that the map bounds the laws.
    Suppose that the map leaves only noise and needs a source at each of its places. Two laws then explain the record
    only in two cases: if at each place one of them explains it instead of the source, beside the free sources of the
    other places; or if one law acts everywhere, and explains it beside the free source of the place where the other law
    acts. A place rules both out only if its laws leave more than noise even with the model error of the first fit: a
    law of another place may explain a smaller misfit with more evidence, because it has fewer numbers than a free
    source. A map with one place rules nothing out, because every other law is then cheaply compared.

    The sources of the other places have the courses of the map. Where several of them imitate one strong law, neither
    it nor a law at another place explains the record beside them. So a place counts only while the best hypothesis,
    too, needs a source there (:func:`_needed`).
    """
    laws = [_laws(problem, found, i, terms) for i in range(len(found.signals))]
    fits = [*none, *single(problem, found, laws, runs)]
    yield (result := exact(problem, fits, {}, terms, runs))
    every = range(len(laws)) if len(laws) > 1 and not result.best.explains else ()
    own = [_beside(problem, found, [j for j in every if j != i], laws[i], runs) for i in every]
    if own:
        fits += together(problem, found, combinations(own, 2), runs)
        yield (result := exact(problem, fits, {}, terms, runs))
    lawful = [i for i, some in enumerate(own) if _explains(some)]
    if result.best.explains or len(lawful) == len(laws):
        return result, set()
    everywhere = [t for t in result.sought if t.place == ALL_PLACES]
    fits += single(problem, found, [everywhere], runs)
    yield (result := exact(problem, fits, {}, terms, runs))
    if result.best.explains:
        return result, set()
    wide = [_beside(problem, found, [i], everywhere, runs) for i in lawful]
    fits += together(problem, found, [(own[i], some) for i, some in zip(lawful, wide, strict=True)], runs)
    yield (result := exact(problem, fits, {}, terms, runs))
    if not found.explains or any(_explains(some) for some in wide):
        return result, set()
    return result, {place.key for place, some in zip(found.places, own, strict=False) if not some}


def _needed(result: Compared) -> set[_Key]:
    """The places where free sources beside the best hypothesis gain evidence."""
    assert isinstance(result.problem, NetworkProblem)
    beside = found_beside(result.problem, result.best.fit)
    return {place.key for place in beside.places} if beside else set()


def _also_promising(result: Compared, columns: Mapping[str, Array], runs: Runs) -> Compared:
    """If the model without effect explains the record, add the laws whose columns promise more evidence. Weak laws that
    act everywhere are no single place of a map, and few sensors cannot locate them."""
    base, tried = result.none.fit, {n.label for n in result.ranked}
    best, gained = promised(base, result.sought, columns)
    near = [t for k, (score, t) in enumerate(gained) if k < at.FEW or score < gained[0][0] + at.RULED_OUT]
    worth = {t.label for score, t in gained if score < best - at.FIRST}
    chosen = [t for t in near if t.label in worth - tried]
    if not chosen:
        return result
    return result.joined_by(result.problem.refit([(t,) for t in chosen], base, runs, columns)).polished(runs)


def _has_absorbed(first: Named) -> bool:
    """True if another law may act beside a hypothesis, whose walls are implausible because they have absorbed it.
    A model without a law that leaves more than noise has already been compared with all laws from the map's walls."""
    room = len(first.fit.terms) < at.MOST_EFFECTS
    return room and bool(first.explains or first.fit.terms) and bool(implausible(first.fit))


def _from_plausible_walls(result: Compared, first: Fit, found: SourceMap, runs: Runs) -> Compared:
    """Add the laws that promise most beside those of a fit, and every change of outlet kind, from the walls of the map
    without outliers; from those of the file if the map has no places. The walls of the fit have absorbed other physics,
    and so are no guide to a starting point."""
    problem, own = result.problem, dict(zip((u.name for u in first.unknowns), first.x, strict=True))
    assert isinstance(problem, NetworkProblem)
    plain, x = found.forced(problem, []), found.standing_out(()).x if found.places else np.zeros(len(found.x))
    wide, walls = plain.granted(at.AFAR), replace(found, x=x)
    kept = [(t, np.array([own[u.name] for u in t.unknowns])) for t in first.terms]
    member = base(wide, walls).with_laws(wide, kept)
    (point,) = wide.points([Trial(member, np.arange(len(member.x)), None, np.zeros(len(member.x)))], runs)
    if point is None:
        return result
    here = {t.label for t in first.terms}
    other = [t for t in result.terms if t.label not in here and joins(t, first.terms)]
    laws = [t for t in other if t.rewires or t in result.sought]
    chosen = nearest(wide, Base(member, point.J), laws, runs)
    fits = refitted(plain, walls, [[*kept, (b.term, b.x)] for b in chosen], runs)
    return result.joined_by(fits).polished(runs)


def _leaves(result: Compared) -> bool:
    """True if the best hypothesis leaves more than noise, or free sources beside it gain evidence."""
    assert isinstance(result.problem, NetworkProblem)
    return not result.best.explains or found_beside(result.problem, result.best.fit) is not None


def _refined(result: Compared, runs: Runs) -> list[Fit]:
    """Refinements of the best laws: a law that acts everywhere gets one size per segment, and a localised law a free
    position and length."""
    first, problem, hypotheses = result.best.fit, result.problem, list[tuple[PlacedEffect, ...]]()
    for i, t in enumerate(first.terms):
        for finer in _finer(problem, first, t):
            hypotheses.append((*first.terms[:i], finer, *first.terms[i + 1 :]))
            if len(first.terms) > 1:  # the other law may have stood in for this one
                hypotheses.append((finer,))
    return there(problem.refit(hypotheses, first, runs)) if hypotheses else []


def _finer(problem: Forward, fit: Fit, term: PlacedEffect) -> list[PlacedEffect]:
    """The refinements of a law of a fit."""
    found = (problem.refined(fit, term), placed(problem.network, term, sizes_of(fit, term)))
    return [finer for finer in found if finer is not None]


# --- moves from the best hypothesis -----------------------------------------------------------------------------------
# Another law, at any place, instead of one of its laws or all of them, or beside it. Few sensors cannot distinguish an
# external pressure of one artery from one of its neighbour, a flexible law absorbs a missing second law, and a law that
# acts everywhere is no place of a map. A name requires that all of these were refitted.


def with_moves(
    result: Compared, runs: Runs, unexplained: bool = False, more: bool = False, tried: Collection[str] = (),
    known: Responses | None = None,
) -> Compared:  # fmt: skip
    """Refit the laws that promise to explain the record instead of one law of the best hypothesis or all of them, and
    those whose search ended far above its predicted cost.

    unexplained : the best hypothesis leaves a misfit; searches then start with a model error, and the moves end as soon
    as another hypothesis explains the record; the next round starts from it. more : another law may act beside it.
    tried : laws beside which others were tried before. known : responses to laws in earlier moves; new ones are added.
    """
    best, first = _leading(result), result.best.key
    weights = result.problem
    assert isinstance(weights, NetworkProblem)
    problem, known = with_signals(weights, []), {} if known is None else known  # without free sources
    for rest in _rests(best.terms, unexplained, more):
        if names_of(rest) in tried:
            continue
        if result.problem is not weights:  # fits of one comparison have the same weights
            weights = result.problem
            assert isinstance(weights, NetworkProblem)
            before, problem = problem, with_signals(weights, [])
            (best,) = problem.restated([best], before)
        base = without(problem, best, rest, runs)
        if base is None:
            continue
        most = best.cost - at.SECOND if rest == best.terms else result.none.fit.cost
        chosen = _promising_beside(problem, result, best, base, most, unexplained, runs, known)
        if rest and names_of(rest) not in {n.key for n in result.every}:  # a pair must be better than each law alone
            chosen.append(base.member)
        if chosen and unexplained:
            wide = problem.granted(at.AFAR)
            columns = base.rewhitened(wide, problem).columns
            moved = problem.restated(there(wide.searched_from(chosen, runs, columns)), wide)
            result = result.joined_by(problem.relaxed(moved, runs, rough=True)).polished(runs)
        elif chosen:
            result = result.joined_by(problem.searched_from(chosen, runs, best.columns, best.cost)).polished(runs)
        if unexplained and result.best.key != first and result.best.explains:
            break
    return result


def _promising_beside(
    problem: NetworkProblem, result: Compared, best: Fit, base: Base, most: float, unexplained: bool, runs: Runs,
    responses: Responses,
) -> list[Member]:  # fmt: skip
    """The starts of laws beside those of ``base`` that promise a cost below ``most`` and below their known cost."""
    others, labels = base.member.terms, {t.label for t in base.member.terms}
    known, members = {n.key: n.fit.cost for n in result.ranked}, dict[tuple[str, bool], Member]()
    plain = [t for t in result.sought if t.label not in labels and joins(t, others)]
    # a part of another segment may do what a part of one does
    anywhere = unexplained or any(t.moves_along for t in best.terms)
    laws = [each for t in plain for each in along(problem, t)] if anywhere else plain
    for begun in nearest(problem, base, laws, runs, most, responses):
        key = names_of((*others, begun.term))
        if begun.left < known.get(key, np.inf) - at.RULED_OUT:
            members.setdefault((key, begun.term.moves_along), base.promised(problem, begun))
    return list(members.values())


def _leading(result: Compared) -> Fit:
    """The most probable hypothesis, even one that is never named."""
    return min(result.every, key=lambda n: n.score).fit


def _rests(terms: tuple[PlacedEffect, ...], unexplained: bool, more: bool) -> list[tuple[PlacedEffect, ...]]:
    """The laws kept by each move: none, each one of a pair, and all if another one may act beside them."""
    rests = [(), *((t,) for t in terms if len(terms) > 1)] if terms or unexplained else []
    return [*rests, terms] if terms and more and len(terms) < at.MOST_EFFECTS else rests


def without(problem: NetworkProblem, fit: Fit, remaining: tuple[PlacedEffect, ...], runs: Runs) -> Base | None:
    """The point of a fit reduced to the remaining laws. Parameters of an outlet that a removed law had replaced return
    to nominal. None if that point cannot be simulated."""
    unknowns, columns = problem.hypothesis(remaining), fit.columns
    x = dict(zip((u.name for u in fit.unknowns), fit.x, strict=True))
    member = Member(remaining, unknowns, np.array([x.get(u.name, 0.0) for u in unknowns]))
    missing = np.flatnonzero([u.name not in columns for u in unknowns])
    if len(missing):
        (point,) = problem.points([Trial(member, missing, None, np.zeros(len(unknowns)))], runs)
        if point is None:
            return None
        columns |= {unknowns[i].name: column for i, column in zip(missing, point.J.T, strict=True)}
    return Base(member, np.stack([columns[u.name] for u in unknowns], axis=1))
