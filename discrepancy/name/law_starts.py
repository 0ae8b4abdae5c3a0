"""Starting points for laws: the size and position that promise the lowest cost.

For a law s of size a at a point θ of a search, with the residuals z_a simulated with it and z_0 without it,

    z(a', θ + dθ) = z_0 + a' (z_a - z_0) / a + J dθ,

the promised cost is the minimum of |z|² plus the priors of θ + dθ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fitting.inference.fit import Array, Member
from fitting.inference.gauss_newton import bounded_step
from fitting.inference.hypothesis import Term, effect_of, placed
from fitting.inference.models.network import NetworkProblem
from fitting.inference.places import NUMBER, Place
from fitting.inference.runs import Runs
from fitting.inference.unknown import bounds, penalty, precisions
from solver.laws.effect import WALL

from .. import thresholds as at

TYPICAL = (1.0,)  # starting sizes of a law, beside its own starts, where there are many laws
SIZES = (0.3, *TYPICAL, 3.0)  # and where there are few
_FARTHER = 5.0  # limits the linear estimate of a size to this factor of the simulated size


@dataclass(frozen=True)
class Base:
    """A point to which laws are added. J : (n, p) whitened derivatives by its unknowns at the point."""

    member: Member
    J: Array

    def promised(self, problem: NetworkProblem, begun: Begun) -> Member:
        """The hypothesis with a law at its predicted minimum."""
        moved = replace(self, member=replace(self.member, x=self.member.x + begun.step))
        return moved.with_laws(problem, [(begun.term, begun.x)])

    def with_laws(self, problem: NetworkProblem, laws: Sequence[tuple[Term, Array]]) -> Member:
        """A hypothesis at this point with laws at their starting values."""
        terms = (*self.member.terms, *(t for t, _ in laws))
        x = dict(zip((u.name for u in self.member.unknowns), self.member.x, strict=True))
        for t, own in laws:
            x |= dict(zip((u.name for u in t.unknowns), own, strict=True))
        unknowns = problem.hypothesis(terms)
        return Member(terms, unknowns, np.clip([x.get(u.name, 0.0) for u in unknowns], *bounds(unknowns)))


@dataclass(frozen=True)
class Begun:
    """A law with its starting values x. step : (p,) of the unknowns of the base. left : the cost predicted after the
    step."""

    term: Term
    x: Array
    step: Array
    left: float


def along(problem: NetworkProblem, term: Term, place: Place | None = None) -> list[Term]:
    """A law at its usual position and, if it can act on a part of a segment, with free position: started at that of the
    place, or at each of its starts. A part of a wall only if no place is given: mostly a whole wall differs."""
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


def nearest(
    problem: NetworkProblem, base: Base, laws: Sequence[Term], runs: Runs, sizes: Sequence[float] = SIZES,
    screening: bool = False,
) -> list[Begun]:  # fmt: skip
    """Laws at the size of lowest predicted cost, linear in the size and in the unknowns of the base; lowest first.

    problem : with the sources that act beside them. sizes : to simulate. screening : simulate one size only, since the
    prediction is linear in it.
    """
    trials = [(t, x) for t in laws for x in (_one_size(t, sizes) if screening else _sizes(t, sizes))]
    members = [base.with_laws(problem, []), *(base.with_laws(problem, [each]) for each in trials)]
    near = [i if any(t.rewires for t in member.terms) else 0 for i, member in enumerate(members)]
    none, *shown = problem.observe(members, runs, near)
    if none is None:
        return []
    z0, best = problem.residual(none), dict[int, Begun]()
    for (t, x), X in zip(trials, shown, strict=True):
        if X is not None:
            begun = _promised(base, z0, problem.residual(X), t, x)
            if id(t) not in best or begun.left < best[id(t)].left:
                best[id(t)] = begun
    return sorted(best.values(), key=lambda b: b.left)


def fewest(begun: Sequence[Begun], most: float = math.inf, n: int = at.FEW) -> list[Begun]:
    """The laws to refit. Of those that promise to leave less than ``most``: the n best, and all that could not be ruled
    out against the best, because few sensors leave many laws similar. Every outlet of another kind, whatever it
    promises, because it starts far from the record."""
    near = begun[0].left + at.RULED_OUT if begun else 0.0
    return [b for k, b in enumerate(begun) if b.term.rewires or (b.left < most and (k < n or b.left < near))]


def _promised(base: Base, z0: Array, z: Array, term: Term, x: Array) -> Begun:
    """A law with residual z at its start x, and z0 without it: size and base unknowns moved to the predicted
    minimum."""
    unknowns, now = base.member.unknowns, base.member.x
    sizes = np.array([u.of_size for u in term.unknowns])
    lead = int(np.argmax(np.where(sizes, np.abs(x), -1.0)))
    low, high = (np.append(rest, own[lead]) for rest, own in zip(bounds(unknowns), bounds(term.unknowns), strict=True))
    column = (z - z0) / x[lead] if x[lead] else np.zeros_like(z)
    prior = np.append(precisions(unknowns), 0.0)
    step = bounded_step(np.column_stack([base.J, column]), z, prior, np.append(now, x[lead]), low, high)
    size = float(np.clip(x[lead] + step[-1], *sorted((x[lead] / _FARTHER, x[lead] * _FARTHER))))
    begin = np.where(sizes, x * (size / x[lead] if x[lead] else 1.0), x)
    left = z + base.J @ step[:-1] + column * step[-1]
    return Begun(term, begin, step[:-1], float(left @ left) + penalty(prior[:-1], now + step[:-1]))


def _sizes(term: Term, sizes: Sequence[float]) -> list[Array]:
    """Starting values of a law: its own starts, and the given sizes with both signs where the bounds allow them."""
    low, high = bounds(term.unknowns)
    found = [np.array(start) for start in term.starts if len(start) == len(term.unknowns)]
    if effect_of(term).rewires:
        return [np.clip(x, low, high) for x in (*found, np.zeros(len(low)))]
    starts = list(found) if term.moves_along else [np.zeros(len(term.unknowns))]
    for start in starts:
        for size in (sign * size for size in (sizes if len(starts) == 1 else TYPICAL) for sign in (1.0, -1.0)):
            for which in _which(term):
                x = start.copy()
                x[which] = size
                found.append(x)
    inside = [x for x in found if np.all((x >= low) & (x <= high))]
    return inside or [np.clip(found[0], low, high)]


def _one_size(term: Term, sizes: Sequence[float]) -> list[Array]:
    """One of the starting values for each set of other parameters: that of the most typical size, positive if
    possible."""
    size, found = np.array([u.of_size for u in term.unknowns]), dict[tuple[Any, ...], Array]()
    for x in sorted(_sizes(term, sizes), key=lambda x: (np.abs(np.abs(x[size]) - 1.0).sum(), *(x[size] < 0.0))):
        found.setdefault((*x[~size], *(x[size] != 0.0)), x)
    return list(found.values())


def _which(term: Term) -> list[list[int]]:
    """Index sets of the size parameters of a law: each by itself, and all together."""
    sizes = [i for i, u in enumerate(term.unknowns) if u.of_size]
    return [*([i] for i in sizes), *([sizes] if len(sizes) > 1 else [])]
