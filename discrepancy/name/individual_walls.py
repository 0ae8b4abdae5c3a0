"""The walls of one subject: parameters of every artery and outlet from the record, beside those of the network file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from fitting.first.options import is_first
from fitting.inference.fit import Array, Fit
from fitting.inference.forward import Forward
from fitting.inference.gauss_newton import Trial
from fitting.inference.hierarchy import Linear, with_widths
from fitting.inference.hypothesis import CALIBRATION, PlacedEffect, calibrated, rewired
from fitting.inference.model_discrepancy import settled
from fitting.inference.runs import Runs
from fitting.inference.unknown import Unknown, bounds, interval
from solver.network.description import Network

from .. import thresholds as at
from ..findings.outcome import BEYOND, OwnNumber, Walls
from .scoring import Compared, there
from .verdict import Naming

_TOLD = 3  # outliers with a sentence of their own
_MOST = 3  # at most one in so many parameters of a kind may be an outlier
_FEWEST = 3  # other parameters that suffice to estimate a spread
_TRIED = 3  # effects tried in place of each outlier
_SAME = 0.01  # of the response to a parameter that an equivalent effect may miss: derivatives are accurate to 1e-3


def walls_of(network: Network, fit: Fit, quantile: float) -> Walls:
    """The parameters of every artery and outlet with intervals; only the kind if a fit has common walls.

    The deviation of a parameter is the contribution of its own unknowns, without that of common ones. quantile : half a
    95 % interval in standard deviations.
    """
    named = {u for term in fit.terms for u in term.unknowns}  # parameters of an effect are no deviations
    own = np.array([bool(u.group) and u not in named for u in fit.unknowns], bool)
    if not own.any():
        return Walls()
    fit = with_widths(fit)
    whole = rewired(network, fit.terms)
    file, nominal, known = network.parameters(), whole.parameters(), whole.parameter_quantities()
    arteries, in_calibration = {}, calibrated(fit.unknowns)
    deviate = {variable for u, mine in zip(fit.unknowns, own, strict=True) if mine for variable in u.variables}
    for name in (name for name in nominal if name in deviate and known[name].individual > 0.0):
        now = interval(fit.unknowns, name, nominal[name], known[name], fit.x, fit.covariance, quantile)
        moved = np.array([dict(u.moves).get(name, 0.0) for u in fit.unknowns])[own] @ fit.x[own]
        source, size = "file", known[name].individual
        if name in in_calibration:  # along the directions of which the unknowns have a standard deviation of 1
            source = "file" if is_first(network) else "calibration"
            size = float(np.linalg.norm([dict(u.moves).get(name, 0.0) for u in fit.unknowns if u.group == CALIBRATION]))
        arteries[name] = OwnNumber(file[name], now, float(moved / size), source)
    # of every quantity, the stated spread between arteries, and the one that maximises the evidence
    sizes = {name.rpartition(".")[2]: q.individual for name, q in known.items()}
    spread = {kind: (sizes[kind], width * sizes[kind]) for kind, width in Linear.of(fit).inferred().of.items()}
    return Walls("individual", spread, arteries)


def odd_ones(walls: Walls, network: Network) -> list[str]:
    """A sentence for each of the parameters farthest beyond the stated spread, and one for all the others."""
    odd = sorted((name for name, own in walls.arteries.items() if own.beyond),
                 key=lambda name: -abs(walls.arteries[name].deviation))  # fmt: skip
    listed, unlisted = odd[:_TOLD], odd[_TOLD:]
    sentences = [_odd_text(name, walls.arteries[name], network) for name in listed]
    if unlisted:
        sentences.append(
            f"Beyond their stated spreads, and this subject's own, are also {', '.join(unlisted)}; see its walls."
        )
    return sentences


def _odd_text(name: str, own: OwnNumber, network: Network) -> str:
    quantity, more = network.parameter_quantities()[name], own.now.value - own.file
    scaled = quantity.low >= 0.0 and own.file > 0.0
    by = f"{100.0 * abs(more) / own.file:.0f} %" if scaled else f"{abs(more):.2g}"
    side = "above" if more > 0.0 else "below"
    return (
        f"{name}: the {quantity.description} is {by} {side} the {own.source}'s, {abs(own.deviation):.1f} stated "
        "spreads from what all have in common: this subject's own, not counted as an effect."
    )


# --- outliers ---------------------------------------------------------------------------------------------------------
# With free deviations, one outlier widens the spread that its kind shares, and hides in it: with individual walls, an
# artery of 2.2 times the modulus, nine stated spreads from the others, left only noise as "this animal's own". So if
# nothing else is missing, an outlier is bounded to the range of its kind, and effects at its artery must explain the
# rest.


def standing_out(unknowns: Sequence[Unknown], x: Array) -> dict[str, float]:
    """The outliers among the parameters, by the name of their unknown, with the limit [stated spreads] of their kind.

    The r farthest of a kind are outliers if the r-th is beyond the limit set by the remaining ones, whatever the other
    r - 1 are (B. Rosner, Technometrics 25 (1983) 165): two outliers do not mask each other.
    """
    kinds: dict[str, list[int]] = {}
    for i, u in enumerate(unknowns):
        if u.group and not u.stated:
            kinds.setdefault(u.group, []).append(i)
    found = {}
    for same in kinds.values():
        order = sorted(same, key=lambda i: -abs(x[i]))
        for r in range(max(1, len(order) // _MOST), 0, -1):
            within = x[order[r:]] if len(order) - r >= _FEWEST else np.zeros(1)
            limit = max(at.OUTLIER, at.OUTLIER_OF_OTHERS * float(np.sqrt(np.mean(within**2))))
            if abs(x[order[r - 1]]) > limit:
                found.update({unknowns[i].name: limit for i in order[:r]})
                break
    return found


def implausible(fit: Fit) -> dict[str, float]:
    """The implausible parameters, with their distance from the file [stated spreads]: outliers among individual
    parameters, and common ones (or those of the one wall of a bench) beyond four stated spreads."""
    out = standing_out(fit.unknowns, fit.x)
    far = {u.name: float(x) / u.prior_sd for u, x in zip(fit.unknowns, fit.x, strict=True) if u.prior_sd}
    common = {u.name for u in fit.unknowns if not u.group and abs(far.get(u.name, 0.0)) > at.OUTLIER}
    return {name: x for name, x in far.items() if name in common | out.keys()}


def set_apart(found: Compared, runs: Runs) -> Iterator[Compared]:
    """If the model without effect is best but has outliers, bound these to the range of their kind, and add the effects
    whose response is closest to that of the outliers. An outlier that no effect imitates stays free, because no effect
    is then an alias of this subject."""
    none = found.best.fit
    limits = {} if none.terms else standing_out(none.unknowns, none.x)
    if not limits:
        return
    odd = _odd(none, limits)
    asked = [t for t in found.terms if t.place in {_owner(none.unknowns[i]) for i in odd} and not t.rewires]
    columns, none = found.problem.columns(none, asked, runs), _derived(found.problem, none, odd, runs)
    instead = {i: _instead(none, i, asked, columns) for i in odd}
    own = [none.unknowns[i] for i in odd if instead[i] and instead[i][0][0] < _SAME]
    kinds = {u.group: limits[u.name] for u in own if u.name in limits}
    if not kinds:
        return
    # bounded to the range of their kind, all of it: otherwise another one would become the outlier
    unknowns = tuple(u.within(kinds[u.group]) if u.group in kinds else u for u in none.unknowns)
    start = replace(none, unknowns=unknowns, x=np.clip(none.x, *bounds(unknowns)))
    kept = [
        n.fit for n in found.every
        if all(abs(x) <= kinds.get(u.group, np.inf) for u, x in zip(n.fit.unknowns, n.fit.x, strict=True))
    ]  # fmt: skip
    yield found.of_fits([*kept, settled(start)])
    effects = [[each for _, each in instead[i][:_TRIED]] for i in odd if none.unknowns[i].group in kinds]
    hypotheses = [[effect] for some in effects for effect in some]
    if len(effects) > 1 and all(effects[:2]):
        hypotheses.append([effects[0][0], effects[1][0]])
    base, *fits = found.problem.refine([start, *(f for each in hypotheses for f in _with(start, each))], runs)
    yield found.of_fits([*kept, base or settled(start), *there(fits)])


def _derived(problem: Forward, fit: Fit, of: Sequence[int], runs: Runs) -> Fit:
    """A fit with its derivatives by some unknowns simulated anew at its point, as the derivatives of effects beside it
    are. The derivatives of its search may belong to an earlier point."""
    (point,) = problem.points([Trial(fit.member, np.array(of), None, np.zeros(len(fit.x)))], runs)
    J = fit.J.copy()
    if point is not None:
        J[:, of] = point.J
    return replace(fit, J=J)


def _odd(none: Fit, limits: Mapping[str, float]) -> list[int]:
    """Indices of the outliers, farthest first. Of their kinds also other parameters that are far, or all if they are
    few: the common value may have moved instead."""
    groups = [u.group for u in none.unknowns]
    kinds = {u.group for u in none.unknowns if u.name in limits}
    far = [
        i
        for i, (group, x) in enumerate(zip(groups, none.x, strict=True))
        if group in kinds and (abs(x) > BEYOND or groups.count(group) <= _FEWEST)
    ]
    return sorted(far, key=lambda i: (none.unknowns[i].name not in limits, -abs(none.x[i])))


def animal_without(problem: Forward, fit: Fit, none: Fit) -> Fit | None:
    """The subject of a hypothesis without its effect, if an outlier was bounded, if ``none``, the best fit without
    effect, has one, or if the effect is a parameter of the subject; otherwise None.

    Without the effect, a subject with an outlier elsewhere may fit the record as well, and then the effect is not
    missing. An outlier where the effect acts is an alias of the effect: the best fit without effect has the same waves,
    and no gap can distinguish them. Evidence did.
    """
    own = {u.name: u for u in problem.first.individual().deviations}
    informed = any(u.group and not u.stated and u.name in own and u != own[u.name] for u in fit.unknowns)
    if not informed and not standing_out(none.unknowns, none.x) and not _aliases_a_parameter(problem, fit):
        return None
    mine = np.array([not any(u in t.unknowns for t in fit.terms) for u in fit.unknowns], bool)
    unknowns = tuple(u for u, keep in zip(fit.unknowns, mine, strict=True) if keep)
    return replace(fit, terms=(), unknowns=unknowns, x=fit.x[mine], J=fit.J[:, mine])


def _aliases_a_parameter(problem: Forward, fit: Fit) -> bool:
    """True if a fit has one effect, of one unknown, which changes the record as a parameter of the same artery does."""
    effect = [i for i, u in enumerate(fit.unknowns) if any(u in t.unknowns for t in fit.terms)]
    if len(fit.terms) != 1 or len(effect) != 1:
        return False
    place = fit.terms[0].place
    others = [i for i, u in enumerate(fit.unknowns) if u.group and i not in effect and _owner(u) == place]
    moved, *each = _derived(problem, fit, [*effect, *others], Runs()).J[:, [*effect, *others]].T
    residuals = [moved - other * ((other @ moved) / (other @ other)) for other in each if other.any()]
    return any(np.linalg.norm(rest) < _SAME * np.linalg.norm(moved) for rest in residuals)


def subject_without(naming: Naming) -> Fit:
    """The model without effect that an added effect must improve: the nearest one if much is missing, the subject of
    the best hypothesis if outliers decide or its effect is a parameter (:func:`animal_without`), otherwise the best fit
    without effect."""
    if naming.nearest is not None:
        return naming.nearest
    alone = animal_without(naming.problem, naming.best.fit, naming.base.fit) if naming.adds else None
    return alone or naming.base.fit


Instead = tuple[
    PlacedEffect, int, Array
]  # an effect, the index of the parameter that it replaces, and its starting point


def _instead(
    none: Fit, i: int, terms: Sequence[PlacedEffect], columns: Mapping[str, Array]
) -> list[tuple[float, Instead]]:
    """Effects at the artery of unknown i, each fitted to its response (least squares) and sorted by the relative
    residual. Empty if the unknown has no influence."""
    found = []
    moved = none.J[:, i] * none.x[i]
    if not moved.any():
        return []
    for t in terms:
        column = columns.get(t.label)
        if t.place == _owner(none.unknowns[i]) and column is not None and column.shape[1] == len(t.unknowns):
            x = np.linalg.lstsq(column, moved, rcond=None)[0]
            residual = float(np.linalg.norm(moved - column @ x) / np.linalg.norm(moved))
            found.append((residual, (t, i, np.clip(x, *bounds(t.unknowns)))))
    return sorted(found, key=lambda f: f[0])


def _with(fit: Fit, effects: Sequence[Instead]) -> list[Fit]:
    """Starting points with effects in place of outliers. For a kind of few parameters also with the values of the file:
    the common value may have moved instead of the outlier."""
    x, groups = fit.x.copy(), [u.group for u in fit.unknowns]
    x[[i for _, i, _ in effects]] = 0.0
    few = {groups[i] for _, i, _ in effects if groups.count(groups[i]) <= _FEWEST}
    moved = {variable for u in fit.unknowns if u.group in few for variable in u.variables}
    as_in_file = np.where([bool(moved & set(u.variables)) for u in fit.unknowns], 0.0, x)
    terms = tuple(t for t, _, _ in effects)
    unknowns = (*fit.unknowns, *(u for t in terms for u in t.unknowns))
    return [
        replace(fit, terms=terms, unknowns=unknowns, x=np.concatenate([walls, *(own for _, _, own in effects)]))
        for walls in ([x, as_in_file] if few else [x])
    ]


def _owner(unknown: Unknown) -> str:
    """The artery whose parameter, or whose outlet's, an unknown moves."""
    return unknown.variables[0].partition(".")[0]
