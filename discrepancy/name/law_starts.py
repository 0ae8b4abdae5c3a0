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
from fitting.inference.hypothesis import PlacedEffect, effect_of, placed
from fitting.inference.models.network import NetworkProblem
from fitting.inference.places import NUMBER, Place
from fitting.inference.runs import Runs
from fitting.inference.unknown import bounds, penalty, precisions
from solver.laws.effect import WALL

from .. import thresholds as at

_SMALLER = 0.3  # starting size of a law that has no beat at its typical size
_FARTHER = 5.0  # limits the linear estimate of a size to this factor of the simulated size


@dataclass(frozen=True)
class Base:
    """A point to which laws are added. J : (n, p) whitened derivatives by its unknowns at the point."""

    member: Member
    J: Array

    @property
    def columns(self) -> dict[str, Array]:
        """(n,) derivatives by name of the unknown."""
        return dict(zip((u.name for u in self.member.unknowns), self.J.T, strict=True))

    def rewhitened(self, problem: NetworkProblem, before: NetworkProblem) -> Base:
        """The same point with the weights of another problem of the record."""
        return replace(self, J=problem.target.whiten(before.target.unwhiten(self.J)))

    def promised(self, problem: NetworkProblem, begun: Begun) -> Member:
        """The hypothesis with a law at its predicted minimum."""
        moved = replace(self, member=replace(self.member, x=self.member.x + begun.step))
        return moved.with_laws(problem, [(begun.term, begun.x)])

    def with_laws(self, problem: NetworkProblem, laws: Sequence[tuple[PlacedEffect, Array]]) -> Member:
        """A hypothesis at this point with laws at their starting values."""
        terms = (*self.member.terms, *(t for t, _ in laws))
        x = dict(zip((u.name for u in self.member.unknowns), self.member.x, strict=True))
        for t, own in laws:
            x |= dict(zip((u.name for u in t.unknowns), own, strict=True))
        unknowns = problem.hypothesis(terms)
        return Member(terms, unknowns, np.clip([x.get(u.name, 0.0) for u in unknowns], *bounds(unknowns)))


@dataclass(frozen=True)
class Begun:
    """A law with its starting values x, predicted from simulated ones, ``tried``. step : (p,) of the unknowns of the
    base. left : the cost predicted after the step."""

    term: PlacedEffect
    x: Array
    tried: Array
    step: Array
    left: float


# by law: simulated starts, and the change (K+1, m) of the channels that each causes
Responses = dict[tuple[str, int], list[tuple[Array, Array]]]


def along(problem: NetworkProblem, term: PlacedEffect, place: Place | None = None) -> list[PlacedEffect]:
    """A law at its usual position and, if it can act on a part of a segment, with free position: started at the
    position of the place, or at each of its starts. A wall law acts on a part of the segment only if no place is given,
    because mostly a whole wall differs."""
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
    problem: NetworkProblem, base: Base, laws: Sequence[PlacedEffect], runs: Runs, most: float = math.inf,
    known: Responses | None = None,
) -> list[Begun]:  # fmt: skip
    """The laws to refit (:func:`fewest`), at the size of lowest predicted cost, which must be below ``most``.

    A prediction is linear in the size and in the unknowns of the base, so one simulation of a law gives it, but it is
    inaccurate for strong effects. Therefore three times as many laws as are refitted, the best ones, are simulated
    again at the predicted size, and start at the better of both predictions. problem : with the sources that act beside
    them. known : responses to laws about other points, which suffice for the first prediction; the responses to new
    laws are added.
    """
    known = {} if known is None else known
    new = [t for t in laws if key_of(t) not in known]
    here = _simulated(problem, base, [(t, x) for t in new for x in _starts(t)], runs, {})
    lost = [t for t in new if key_of(t) not in here]  # they have no beat at a typical size
    _simulated(problem, base, [(t, x) for t in lost for x in _sizes(t, _SMALLER)], runs, here)
    known |= {key: list(responses) for key, responses in here.items()}
    few = fewest(_predicted(problem, base, laws, runs, known), most, 3 * at.FEW)
    there = _simulated(problem, base, [(b.term, b.x) for b in few], runs, {})
    again = {key: [*here.get(key, []), *responses] for key, responses in there.items()}
    found = _predicted(problem, base, [b.term for b in few], runs, again)
    # a law that has no beat at the predicted size starts from the one that was simulated
    found += [replace(b, x=b.tried) for b in few if key_of(b.term) not in there]
    return fewest(sorted(found, key=lambda b: b.left), most)


def key_of(term: PlacedEffect) -> tuple[str, int]:
    """The identity of a law; one with free position has more unknowns than the usual one."""
    return term.label, len(term.unknowns)


def _simulated(
    problem: NetworkProblem, base: Base, trials: Sequence[tuple[PlacedEffect, Array]], runs: Runs, known: Responses
) -> Responses:
    """``known`` with the responses to laws at some sizes; those without a beat have none."""
    members = [base.with_laws(problem, []), *(base.with_laws(problem, [each]) for each in trials)]
    near = [i if any(t.rewires for t in member.terms) else 0 for i, member in enumerate(members)]
    none, *observed = problem.observe(members, runs, near) if trials else [None]
    for (t, x), X in zip(trials, observed, strict=True):
        if none is not None and X is not None:
            known.setdefault(key_of(t), []).append((x, X - none))
    return known


def _predicted(
    problem: NetworkProblem, base: Base, laws: Sequence[PlacedEffect], runs: Runs, known: Responses
) -> list[Begun]:
    """Every law with a response at its best predicted size; lowest predicted cost first."""
    (none,) = problem.observe([base.with_laws(problem, [])], runs) if laws else [None]
    if none is None:
        return []
    z0, found = problem.residual(none), list[Begun]()
    for t in (t for t in laws if key_of(t) in known):
        each = [_promised(base, z0, problem.residual(none + dX), t, x) for x, dX in known[key_of(t)]]
        found.append(min(each, key=lambda b: b.left))
    return sorted(found, key=lambda b: b.left)


def fewest(begun: Sequence[Begun], most: float = math.inf, n: int = at.FEW) -> list[Begun]:
    """The laws to refit: of the laws with a predicted cost below ``most`` the n best, and all that could not be ruled
    out against the best, because few sensors make many laws similar; and every outlet of another kind, whatever its
    predicted cost, because it starts far from the record."""
    near = begun[0].left + at.RULED_OUT if begun else 0.0
    return [b for k, b in enumerate(begun) if b.term.rewires or (b.left < most and (k < n or b.left < near))]


def _promised(base: Base, z0: Array, z: Array, term: PlacedEffect, x: Array) -> Begun:
    """A law with residual z at its start x, and z0 without it: size and base unknowns moved to the predicted
    minimum."""
    unknowns, now = base.member.unknowns, base.member.x
    sizes = np.array([u.of_size for u in term.unknowns])
    lead = int(np.argmax(np.where(sizes, np.abs(x), -1.0)))
    low, high = (np.append(rest, own[lead]) for rest, own in zip(bounds(unknowns), bounds(term.unknowns), strict=True))
    column = (z - z0) / x[lead] if x[lead] else np.zeros_like(z)
    prior = np.append(precisions(unknowns), 0.0)
    step = bounded_step(np.column_stack([base.J, column]), z, prior, np.append(now, x[lead]), low, high)
    size = x[lead] + step[-1]
    size = math.copysign(np.clip(abs(size), *(abs(x[lead]) * np.array([1.0 / _FARTHER, _FARTHER]))), size)
    begin = np.where(sizes, x * (size / x[lead] if x[lead] else 1.0), x)
    residual = z + base.J @ step[:-1] + column * step[-1]
    return Begun(term, begin, x, step[:-1], float(residual @ residual) + penalty(prior[:-1], now + step[:-1]))


def _sizes(term: PlacedEffect, size: float) -> list[Array]:
    """Starting values of a law: its own starts, and a size with both signs where the bounds allow them."""
    low, high = bounds(term.unknowns)
    found = [np.array(start) for start in term.starts if len(start) == len(term.unknowns)]
    if effect_of(term).rewires:
        return [np.clip(x, low, high) for x in (*found, np.zeros(len(low)))]
    for start in list(found) if term.moves_along else [np.zeros(len(term.unknowns))]:
        for signed in (size, -size):
            for which in _which(term):
                x = start.copy()
                x[which] = signed
                found.append(x)
    inside = [x for x in found if np.all((x >= low) & (x <= high))]
    return inside or [np.clip(found[0], low, high)]


def _starts(term: PlacedEffect) -> list[Array]:
    """One of the starting values for each set of other parameters: that of the most typical size, positive if
    possible."""
    size, found = np.array([u.of_size for u in term.unknowns]), dict[tuple[Any, ...], Array]()
    for x in sorted(_sizes(term, 1.0), key=lambda x: (np.abs(np.abs(x[size]) - 1.0).sum(), *(x[size] < 0.0))):
        found.setdefault((*x[~size], *(x[size] != 0.0)), x)
    return list(found.values())


def _which(term: PlacedEffect) -> list[list[int]]:
    """Index sets of the size parameters of a law: each by itself, and all together."""
    sizes = [i for i, u in enumerate(term.unknowns) if u.of_size]
    return [*([i] for i in sizes), *([sizes] if len(sizes) > 1 else [])]
