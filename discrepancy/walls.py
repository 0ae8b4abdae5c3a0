"""Walls that differ: every artery and outlet with deviations of its own, and the effects that are left after them.

What the model lacks must not be taken up by walls that are bent out of shape for it, nor the other way round. So the
first look is from afar: with an error of the model of some per cent of every channel's pulse, under which the walls
move no further than they are likely to. From there every effect is judged by what it adds to the evidence, each with
the spread of walls that suits it best, looking closer and closer; the best are refitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.hierarchy import Linear
from fitting.inference.misfit import settled
from fitting.inference.parts import beside_sites
from fitting.inference.simulator import Runs
from fitting.inference.terms import Term, of_animal

from . import thresholds as at
from .compare import Compared, rewirings
from .weigh import weighed

Array = np.ndarray
Look = tuple[Sequence[Term], Mapping[str, Array]]  # effects, and the columns of those that do not break down


def with_own_walls(
    problem: Forward, terms: tuple[Term, ...], runs: Runs, common: Compared | None = None
) -> Iterator[Compared]:
    """What is known after every stage. problem : with deviations.

    common : what is known of walls that have all in common. Where it explains the record, and an animal without effect
    whose walls differ is less probable, no effect of walls that differ is looked for.
    """
    sought = tuple(t for t in terms if not of_animal(problem.network, t))
    rival = common if common is not None and common.best.explains else None
    afar = _seen(problem, at.AFAR)
    base = _from_afar(afar, common, runs)
    if base is None:
        return
    bent = base.chi2 > at.BENT * len(base.z)
    yield Compared.of(problem, [settled(f) for f in problem.restated([base], afar)], {}, terms)
    if rival is not None:
        near = _seen(problem, at.CLOSER[-1])
        found = _exact(problem, near, near.restated([base], afar), {}, terms, runs)
        yield found
        if found.none.score > rival.restated(found.problem).best.score:
            return
    looks = [(sought, afar.columns(base, sought, runs)), *_beside_sites(afar, base, sought, runs)]
    near, chosen, none, within = afar, dict[Term, None](), 0.0, at.NEAR
    for part in at.CLOSER:
        closer = _seen(problem, part)
        (base,) = closer.restated([base], near)
        looks, near = [(some, closer.rewhitened(columns, near)) for some, columns in looks], closer
        none, promised = _promised(base, looks)
        chosen |= {t: None for score, t in promised[: at.EACH] if score < none}
    columns = looks[0][1]
    if not chosen or promised[0][0] > none - at.NEAR:  # an animal without effect is not ruled out
        found = _exact(problem, near, [base], columns, terms, runs)
        yield found
        if found.none.explains:
            problem, near, base = found.problem, found.problem, found.none.fit
            columns = found.columns_of(found.none)
            chosen, within = _left_over(base, columns, sought), at.IN_DOUBT
    if chosen:
        hypotheses = [(t,) for t in chosen]
        fits = [f for f in near.refit(hypotheses, base, runs, columns) if f is not None]
        found = _exact(problem, near, [base, *fits], columns, terms, runs, within)
        yield found
        if found.best.fit.terms and not found.none.explains:  # walls may have stuck where an effect freed them
            again = [(), *_stuck(found), *_others_there(found)]
            fits = [f for f in found.problem.refit(again, found.best.fit, runs) if f is not None]
            yield (found := found.joined_by(fits))
    yield (found := found.at_minimum(runs))
    yield from _begun_again(found, list(chosen)[: at.EACH] if bent else [], runs)


def _begun_again(found: Compared, effects: Sequence[Term], runs: Runs) -> Iterator[Compared]:
    """With outlets of another kind, and where nothing explains the record some effects, from the walls of the file."""
    anew = rewirings(found)
    if not found.best.explains:
        anew += [(t,) for t in effects]
    if anew:
        yield (found := _from_the_file(found, anew, runs))
        if others := _instead(found):
            yield (found := _from_the_file(found, others, runs))
    if found.best.fit.terms and found.best.explains:  # an animal without effect begins at those walls, too
        fits = [f for f in found.problem.refit([()], found.best.fit, runs) if f is not None]
        yield found.joined_by(fits)


def _from_the_file(found: Compared, hypotheses: Sequence[tuple[Term, ...]], runs: Runs) -> Compared:
    """With hypotheses begun at the walls of the file: those fitted without an effect have taken up a part of it."""
    afar = _seen(found.problem, at.AFAR)
    fits = [f for f in afar.refit(hypotheses, runs=runs) if f is not None]
    seen = afar.restated([found.none.fit], found.problem)
    columns = afar.rewhitened(found.columns_of(found.none), found.problem)
    return found.merged(_exact(found.problem, afar, [*seen, *fits], columns, found.terms, runs))


def _instead(found: Compared) -> list[tuple[Term, ...]]:
    """Where an outlet of another kind is best: the other effects at its place, which three numbers can imitate."""
    places = {t.place for t in found.best.fit.terms if t.rewires}
    return [(t,) for t in found.sought if t.place in places and not t.rewires]


def _from_afar(afar: Forward, common: Compared | None, runs: Runs) -> Fit | None:
    """Walls without effect; begun again from what all arteries have in common where they end far from the record."""
    (base,) = afar.refit([()], runs=runs)
    if common is None or (base is not None and base.chi2 < at.STALLED * len(base.z)):
        return base
    (again,) = afar.refit([()], common.none.fit, runs)
    return min((f for f in (base, again) if f is not None), key=lambda f: f.cost, default=None)


def _stuck(found: Compared) -> list[tuple[Term, ...]]:
    """The best hypotheses whose search had no end."""
    return [n.fit.terms for n in found.ranked if not n.fit.converged][: at.STUCK]


def _others_there(found: Compared) -> list[tuple[Term, ...]]:
    """The other effects at the place of the best, where that leaves something: from walls bent for want of any effect
    they may have promised little."""
    if found.best.explains:
        return []
    (best,) = found.best.fit.terms
    tried = {n.label for n in found.ranked}
    return [(t,) for t in found.sought if t.place == best.place and not t.rewires and t.label not in tried]


def _seen(problem: Forward, part: float) -> Forward:
    """The record with an error of the model of this part of every channel."""
    return problem.widened(np.full(len(problem.parts), part))


def _beside_sites(problem: Forward, base: Fit, terms: Sequence[Term], runs: Runs) -> list[Look]:
    """What effects on one side of the sites of their segments do."""
    found = [beside_sites(problem.network, t) for t in terms]
    sides = [tuple(f[i] for f in found if i < len(f)) for i in range(max(map(len, found), default=0))]
    return [(some, problem.columns(base, [t.held() for t in some], runs)) for some in sides]


def _promised(base: Fit, looks: Sequence[Look]) -> tuple[float, list[tuple[float, Term]]]:
    """-2 ln evidence without effect, and what the columns of every effect promise, best first."""
    found = []
    for term, column in ((t, columns[t.label]) for terms, columns in looks for t in terms if t.label in columns):
        unknowns = [u for u in term.unknowns if u.of_size or not term.moves_along]
        x, J = np.concatenate([base.x, np.zeros(len(unknowns))]), np.column_stack([base.J, column])
        linear = Linear.of_columns(base.z, J, x, (*base.unknowns, *unknowns), base.log_volume)
        found.append((linear.inferred().score, term))
    return Linear.of(base).inferred().score, sorted(found, key=lambda each: each[0])


def _left_over(none: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> dict[Term, None]:
    """The few effects that may still add to what explains the record already."""
    best, promised = _promised(none, [(terms, columns)])
    return {t: None for score, t in promised[: at.EACH] if score < best - at.WORTH}


def _exact(
    problem: Forward, near: Forward, fits: Sequence[Fit], columns: Mapping[str, Array], terms: tuple[Term, ...],
    runs: Runs, within: float = at.NEAR,
) -> Compared:  # fmt: skip
    """The hypotheses within reach of the best, searched on without an error of the model; the others as they are."""
    order = sorted((weighed(near, f, terms).score, i) for i, f in enumerate(fits))
    exact = problem.restated(fits, near)
    sharp = problem.sharpened(exact[order[0][1]], runs)
    exact = sharp.restated(exact, problem)
    found = {i: settled(f) for i, f in enumerate(exact)}
    left = set(found)
    again = [i for score, i in order if score < order[0][0] + within]
    while again := again[: at.REFINED]:  # until none that was not searched on looks better than those that were
        left -= set(again)
        for i, fit in zip(again, sharp.refine([exact[i] for i in again], runs), strict=True):
            if fit is not None:
                found[i] = fit
            elif exact[i].terms:
                del found[i]
        score = {i: weighed(sharp, f, terms).score for i, f in found.items()}
        lowest = min((score[i] for i in found if i not in left), default=np.inf)
        again = sorted((i for i in left if score[i] < lowest), key=score.__getitem__)
    return Compared.of(sharp, list(found.values()), {True: sharp.rewhitened(columns, near)}, terms)
