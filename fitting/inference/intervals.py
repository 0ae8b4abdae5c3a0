"""Intervals of single unknowns by profile likelihood, for hypotheses whose unknowns share a curved valley; and the
parameters that data determine, from the singular values of a whitened Jacobian.

With C(x) = -2 ln(likelihood × priors), the profile of an unknown is p(x_i) = min C over all the others. Its interval
ends where p has risen by q² above its minimum, on either side; if C is quadratic, at x̂_i ± q sd_i. If an
unknown reaches its bound first, its interval ends there. With several minima, the profile is that of the valley of the
fit. The interval also includes points of other profiles that are as probable as its ends.
D. J. Venzon, S. H. Moolgavkar, Appl. Statist. 37 (1988) 87.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .fit import Array, Fit
from .forward import Forward
from .runs import Runs
from .unknown import Reach, Unknown, bounds

_CLOSE = 0.05  # relative error of the rise that ends a search
_TRIES = 8  # of one end at most
_FARTHER = 3.0  # times as far out as the last try, at most
_MARGIN = 0.1  # of a bracket: distance of a trial from its ends
_WEAK = 1.0  # below this singular value, in prior units, a direction depends more on the prior than on the data
_PART = 0.25  # of the largest component: smaller ones are left out of a sentence
_CORRELATED = 0.95
_NOTHING = 1e-8  # precision in prior units of a direction that neither data nor prior determine


def reaches(
    problem: Forward, fit: Fit, unknowns: Collection[Unknown], quantile: float, runs: Runs | None = None
) -> dict[str, Reach]:
    """Lower and upper reach of the intervals of some unknowns of a fit, by name, in its standard deviations.

    quantile : q, half an interval of a quadratic. Empty if the fit itself cannot be simulated.
    Raises OutOfTime after the deadline of ``runs``.
    """
    low, high = bounds(fit.unknowns)
    sd = np.sqrt(np.diag(fit.covariance))
    chosen = [i for i, u in enumerate(fit.unknowns) if u in unknowns and sd[i] > 0.0]
    ends = [
        _End(fit, i, side, limit, quantile, float(np.clip(fit.x[i] + side * quantile * sd[i], low[i], high[i])))
        for i in chosen
        for side, limit in ((-1.0, float(low[i])), (1.0, float(high[i])))
    ]
    (best, *_), lowest = (None,), math.inf
    active, asked = ends, [fit, *(e.held() for e in ends)]
    while active:
        found = problem.relaxed(asked, runs)
        if lowest == math.inf:
            best, *found = found
            if best is None:
                return {}
            lowest = best.cost
        for end, refit in zip(active, found, strict=True):
            end.answer(refit, lowest)
        active = [e for e in active if not e.done]
        asked = [e.held() for e in active]
    # points of one profile belong to the intervals of the others: a record may determine only a product of two unknowns
    met = [f.x for e in ends for f in e.refits if f.cost <= lowest + quantile**2]
    apart = np.reshape([e.reached(met) / sd[e.i] for e in ends], (-1, 2))
    return {fit.unknowns[i].name: (float(a), float(b)) for i, (a, b) in zip(chosen, apart, strict=True)}


@dataclass
class _End:
    """The search for one end by the root of the rise, which is linear in x_i if C is quadratic.

    i : the unknown. side : -1 or 1. limit : of its range. x : its next fixed value. inside : x_i and root of the rise
    of the farthest trial below q², before : of the previous one; outside : of the nearest trial above q², ∞ if it
    cannot be simulated.
    """

    fit: Fit
    i: int
    side: float
    limit: float
    q: float
    x: float
    before: tuple[float, float] = (0.0, 0.0)
    inside: tuple[float, float] = (0.0, 0.0)
    outside: tuple[float, float] | None = None
    done: bool = False
    refits: list[Fit] = field(default_factory=list)
    tries: int = 0

    def __post_init__(self) -> None:
        self.inside, self.refits = (float(self.fit.x[self.i]), 0.0), [self.fit]

    @property
    def end(self) -> float:
        """The present estimate of the point where the rise is q²."""
        x, g = self.inside
        if self.outside is not None and math.isfinite(self.outside[1]):
            return x + (self.outside[0] - x) * (self.q - g) / (self.outside[1] - g)
        return self._farther() if self.outside is None and g * g > (1.0 - _CLOSE) * self.q**2 else x

    def reached(self, met: Sequence[Array]) -> float:
        """The distance of its end from the fit, at least that of points met in the same direction."""
        here = float(self.fit.x[self.i])
        return max(0.0, *(self.side * (float(x) - here) for x in (self.end, *(x[self.i] for x in met))))

    def held(self) -> Fit:
        """The fit with the unknown fixed at x, the others extrapolated from the refits so far."""
        near, *others = sorted(self.refits, key=lambda f: abs(float(f.x[self.i]) - self.x))
        along = others[0].x - near.x if others else self.fit.covariance[:, self.i]
        x = near.x + along * (self.x - near.x[self.i]) / along[self.i]
        x = np.clip(x, *bounds(self.fit.unknowns))
        x[self.i] = self.x
        unknowns = list(self.fit.unknowns)
        unknowns[self.i] = replace(unknowns[self.i], low=self.x, high=self.x)
        return replace(near, unknowns=tuple(unknowns), x=x)

    def answer(self, refit: Fit | None, lowest: float) -> None:
        """Use the result of the last trial."""
        g = math.inf if refit is None else math.sqrt(max(refit.cost - lowest, 0.0))
        self.tries += 1
        if refit is not None:
            self.refits.append(refit)
        if g < self.q:
            self.before, self.inside = self.inside, (self.x, g)
        else:
            self.outside = (self.x, g)
        at_limit = g < self.q and self.x == self.limit
        self.done = at_limit or abs(g * g - self.q**2) <= _CLOSE * self.q**2 or self.tries == _TRIES
        x, g = self.inside
        if self.outside is None:
            self.x = self._farther()
        else:
            part = (self.q - g) / (self.outside[1] - g) if math.isfinite(self.outside[1]) else 0.5
            self.x = x + (self.outside[0] - x) * min(max(part, _MARGIN), 1.0 - _MARGIN)

    def _farther(self) -> float:
        """The next trial, on the line through the last two, within the range."""
        (x0, g0), (x, g) = self.before, self.inside
        most = (_FARTHER - 1.0) * (x - float(self.fit.x[self.i]))
        step = (x - x0) * (self.q - g) / (g - g0) if g > g0 else most
        x += step if abs(step) < abs(most) else most
        return max(x, self.limit) if most < 0.0 else min(x, self.limit)


# --- identifiability --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Determined:
    """A linearised least-squares problem with priors, p unknowns in units of their prior's standard deviation.

    singular_values : (p,) of the whitened Jacobian, largest first; 0 where the error of the Jacobian can cause as much.
    directions : (p, p), one per row, in those units. covariance : (p, p), in the unknowns' own units, data and prior.
    effective : number of parameters determined by the data, tr (J (JᵀJ + prior)⁻¹ Jᵀ). sizes : (p,) the units.
    """

    singular_values: Array
    directions: Array
    covariance: Array
    effective: float
    sizes: Array


def determined(jacobian: Array, prior: Array, sizes: Array, scale: float, error: float) -> Determined:
    """Analyse a whitened Jacobian (n, p) in prior units.

    prior : (p,) precision of the prior in those units (1, or 0 for none). sizes : (p,) the units. scale : the data's
    covariance is multiplied by it. error : relative error of the Jacobian's columns; directions that change the data
    by less count as without effect.
    """
    n, p = jacobian.shape
    jacobian = np.concatenate([jacobian, np.zeros((max(0, p - n), p))])  # as many directions as unknowns
    _, s, directions = np.linalg.svd(jacobian, full_matrices=False)
    doubt = error * np.sqrt(directions**2 @ (jacobian**2).sum(axis=0))
    s = np.where(s > doubt, s, 0.0)
    fisher = directions.T @ (s[:, None] ** 2 * directions)
    values, vectors = np.linalg.eigh(fisher / scale + np.diag(prior))
    covariance = (vectors / np.maximum(values, _NOTHING)) @ vectors.T
    effective = float(np.sum(s**2 / scale * np.einsum("ij,jk,ik->i", directions, covariance, directions)))
    return Determined(s, directions, covariance * np.outer(sizes, sizes), effective, sizes)


def sentences(
    names: Sequence[str], prior_sd: Sequence[float | None], known: Determined, terms: Sequence[str] | None = None
) -> list[str]:
    """One sentence for every unknown, or combination of them, that the data determine less than the prior does.

    terms : how an unknown is written in a sum ("ln all.E" where it is a logarithm); default its name.
    """
    terms = names if terms is None else terms
    sd = np.sqrt(np.diag(known.covariance))
    weak = known.singular_values < _WEAK
    reported: set[int] = set()
    result = []
    for direction in _sparse(known.directions[weak]):
        parts = np.flatnonzero(np.abs(direction) > _PART * np.abs(direction).max())
        if len(parts) == 1:
            i = int(parts[0])
            reported.add(i)
            prior = prior_sd[i]
            of = "and it has no prior" if prior is None else f"sd {sd[i]:.2g} of prior {prior:.2g}"
            result.append(f"the data do not determine {names[i]} ({of})")
        elif len(parts) == 2:
            a, b = int(parts[0]), int(parts[1])
            reported.update((a, b))
            # this combination does not change along the direction
            factor = -direction[a] * known.sizes[a] / (direction[b] * known.sizes[b])
            along = known.covariance[np.ix_(parts, parts)]
            spread = np.sqrt(max(float(np.array([1.0, factor]) @ along @ np.array([1.0, factor])), 0.0))
            result.append(
                f"of {names[a]} and {names[b]} only the combination {_sum([terms[a], terms[b]], [1.0, factor])} is "
                f"determined (sd {spread:.2g})"
            )
        else:
            reported.update(int(i) for i in parts)
            combination = _sum([terms[int(i)] for i in parts], direction[parts] * known.sizes[parts])
            result.append(f"the data do not determine a change along {combination}")
    correlation = known.covariance / np.outer(sd, sd)
    for a in range(len(names)):
        for b in range(a):
            if abs(correlation[a, b]) > _CORRELATED and not {a, b} <= reported:
                pair = f"{names[b]} and {names[a]}"
                result.append(f"{pair} are hard to distinguish (correlation {correlation[a, b]:.3f})")
    return result


def _sparse(rows: Array) -> Array:
    """Rows of the same span, each with as few unknowns as elimination with full pivoting leaves.

    Singular vectors of one singular value (0) are any mixture of each other; three unknowns without effect would be
    reported as three combinations.
    """
    rows = rows.copy()
    for done in range(len(rows)):
        i, j = divmod(int(np.argmax(np.abs(rows[done:]))), rows.shape[1])
        rows[[done, done + i]] = rows[[done + i, done]]
        rows[done] /= rows[done, j]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, j], rows[done])
    return rows


def _sum(names: Sequence[str], factors: Sequence[float] | Array) -> str:
    """ "A - 1.3 B"; the first factor is made 1."""
    first = factors[0]
    text = names[0]
    for name, factor in zip(names[1:], np.asarray(factors[1:]) / first, strict=True):
        size = "" if abs(abs(factor) - 1.0) < 5e-3 else f"{abs(factor):.2g} "
        text += f" {'-' if factor < 0 else '+'} {size}{name}"
    return text
