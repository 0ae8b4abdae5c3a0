"""Isolability of effects by a sensor set: separations between effects of typical size, with or without data.

For two effects with whitened columns a and b (the change of all data by an effect of typical size), the part that the
nuisance parameters can absorb is projected out of both. The norm of the remainder of a is its visibility d'; the least
norm of a - s b over all sizes s is the separation of a from b. It is not symmetric: a strong effect may be far from a
weak effect that is itself near to the strong one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fitting.inference.fit import Array, Fit, projected
from fitting.inference.hypothesis import PlacedEffect
from fitting.inference.unknown import Unknown, precision
from solver.quantities.coordinate import SCALE

# limits of d'. Odds of 1 : 100 (-2 ln evidence of 9.2) are the least that rules out, with a scatter of 2 d': an effect
# of d' 3 can be ruled out, one of 6 is in 99 of 100 records; 5 pays the price of a first effect
INVISIBLE = 3.0  # of a typical effect, below which sensors cannot see it
INSEPARABLE = 6.0  # between two typical effects, below which sensors cannot distinguish them
DETECTABLE = 5.0  # of the smallest detectable size: named in at least half of the records


@dataclass(frozen=True)
class Isolability:
    """Isolability of effects by a sensor set, before any data.

    labels : names of effects, each at its most visible place. separation : (n, n) least d' of a row's effect, of
    typical size, after the refit of a column's effect at any of its places (0 on the diagonal). visibility : (n,) d' of
    each after the nuisance refit. invisible : effects below INVISIBLE. not_judged : effects without a derivative here,
    such as a change of outlet kind, and effects that individual walls already contain.
    """

    labels: tuple[str, ...]
    separation: Array
    visibility: Array
    invisible: tuple[str, ...]
    not_judged: tuple[str, ...] = ()

    @property
    def visible(self) -> dict[str, float]:
        """The visible effects with their visibility."""
        return {e: float(d) for e, d in zip(self.labels, self.visibility, strict=True) if e not in self.invisible}

    def rivals(self, label: str) -> dict[str, float]:
        """The separation d' of an effect from every other visible one."""
        row = dict(zip(self.labels, self.separation[self.labels.index(label)], strict=True))
        return {e: float(row[e]) for e in self.visible if e != label}

    def nearest(self, label: str) -> tuple[str, float] | None:
        """The visible effect nearest to another, and their separation d'; None if there is no other."""
        return min(self.rivals(label).items(), key=lambda pair: pair[1], default=None)

    def confused(self, label: str) -> tuple[str, ...]:
        """The visible effects that look, at their best size, like an effect of typical size."""
        return tuple(e for e, d in self.rivals(label).items() if d < INSEPARABLE)


@dataclass(frozen=True)
class Detectable:
    """The smallest change of a parameter of an effect, relative to the model, that this record would have shown.

    parameter : as "CA.phi0"; ratio : the other parameter of its owner in a ratio of two, as "E", or "". change : in
    ``unit``, or as a fraction if ``relative``; NaN if no allowed change would show. either : the opposite change is
    allowed, too.
    """

    parameter: str
    change: float
    unit: str
    relative: bool = False
    either: bool = False
    ratio: str = ""


def isolability(base: Fit, columns: Mapping[str, Array], terms: Sequence[PlacedEffect]) -> Isolability:
    """Isolability of every effect at its most visible place, against every other effect at its nearest place.

    Effects without a column at any place, as a change of outlet kind in a study, are not judged.
    """
    effects = list(dict.fromkeys(t.effect for t in terms if t.label in columns))
    not_judged = tuple(dict.fromkeys(t.effect for t in terms if t.effect not in effects))
    projections = {
        t.label: projected(base.J, precision(base.prior, base.x), columns[t.label]) for t in terms if t.label in columns
    }
    places = {e: [t for t in terms if t.effect == e and t.label in projections] for e in effects}
    size = {label: float(np.linalg.norm(_typical(x))) for label, x in projections.items()}
    best = {e: max((t.label for t in there), key=lambda label: size[label]) for e, there in places.items()}
    visibility = np.array([size[best[e]] for e in effects])
    separation = np.zeros((len(effects), len(effects)))
    for i, a in enumerate(effects):
        for j, b in enumerate(effects):
            if i != j:
                separation[i, j] = min(_apart(_typical(projections[best[a]]), projections[t.label]) for t in places[b])
    invisible = tuple(e for e, d in zip(effects, visibility, strict=True) if d < INVISIBLE)
    return Isolability(tuple(effects), separation, visibility, invisible, not_judged)


def smallest(base: Fit, columns: Mapping[str, Array], terms: Sequence[PlacedEffect]) -> dict[str, Detectable]:
    """The smallest detectable change of each effect, by its label at the place where that is smallest: d' = DETECTABLE,
    of either sign, within the allowed range; NaN if no allowed size would show at any place."""
    found: dict[str, tuple[float, PlacedEffect, Unknown]] = {}
    for term in (t for t in terms if t.label in columns):
        projection = projected(base.J, precision(base.prior, base.x), columns[term.label])
        i = _strongest(projection)
        unknown, d = term.unknowns[i], float(np.linalg.norm(projection[:, i]))
        x = DETECTABLE / d if d > 0.0 else np.inf
        allowed = next((size for size in (x, -x) if unknown.low <= size <= unknown.high and np.isfinite(size)), np.nan)
        known = found.get(term.effect)
        if known is None or abs(allowed) < abs(known[0]) or (np.isnan(known[0]) and not np.isnan(allowed)):
            found[term.effect] = (allowed, term, unknown)
    return {term.label: _detectable(unknown, x) for x, term, unknown in found.values()}


def _detectable(unknown: Unknown, x: float) -> Detectable:
    """The smallest detectable x as a change of its parameter; as a fraction for a factor."""
    relative, moved = unknown.kind == SCALE, unknown.size * x
    change, unit = (float(np.expm1(moved)), "1") if relative else (float(moved), unknown.unit)
    return Detectable(unknown.name, change, unit, relative, unknown.low <= -x <= unknown.high, unknown.ratio or "")


def _strongest(projection: Array) -> int:
    """The index of the unknown of an effect that shows most at its typical size."""
    return int(np.argmax((projection**2).sum(axis=0)))


def _typical(projection: Array) -> Array:
    """The change by the strongest unknown of an effect at typical size."""
    return projection[:, _strongest(projection)]


def _apart(a: Array, b: Array) -> float:
    """The norm of the remainder of a after a least-squares fit of the columns b."""
    fit = np.linalg.lstsq(b, a, rcond=1e-10)[0]
    return float(np.linalg.norm(a - b @ fit))
