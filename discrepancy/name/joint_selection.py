"""Name the missing effect from several recordings of one subject: candidates of each, compared on all together.

Each recording is searched by itself first, and gives candidates. These, and effects that the derivatives of all
recordings together support, are refitted to all (:class:`~fitting.inference.joint.joint_record.Several`) and compared
by one evidence. A second heart rate separates viscosity and relaxation, which one rate cannot distinguish.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from fitting.inference.fit import Array, Fit, Member
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.joint.joint_record import Several, derivatives
from fitting.inference.runs import OutOfTime, Runs
from fitting.inference.unknown import bounds
from solver.errors import InputError

from .. import thresholds as at
from .approximate import Comparison, compared_first_model, compared_with_errors, from_afar, is_far, nearest
from .individual_walls import set_apart
from .intervals import profiled
from .model_selection import coupled
from .scoring import Compared, exact, last_of, names_of, promised, there
from .verdict import Naming, decided

Terms = tuple[PlacedEffect, ...]


def name_together(problem: Several, alone: Sequence[Naming], terms: Terms, runs: Runs) -> Naming:
    """The verdict on all recordings. alone : the verdict on each by itself.

    It is incomplete if the time limit ended one of these, or the comparison.
    Raises OutOfTime if the limit is reached before the model without effect was refitted to all recordings.
    """
    complete = all(naming.complete for naming in alone)
    if problem.accuracy:
        last = compared_first_model(problem, terms, runs, [n.fit.terms for naming in alone for n in naming.members])
    else:
        known, ended = last_of(_stages(problem, alone, terms, runs))
        complete &= ended
        sought = problem.site is None and not known.best.explains
        last = compared_with_errors(known, runs) if sought else Comparison(known)
    several, none = last.found.problem, last.found.none.fit
    assert isinstance(several, Several)
    freed = (lambda n: None) if problem.accuracy else (lambda n: several.beside(n.fit))
    naming = profiled(decided(last.found, terms, freed, complete and last.complete, last.named), runs)
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


# --- without effect ---------------------------------------------------------------------------------------------------


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


# --- with effects -----------------------------------------------------------------------------------------------------


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
