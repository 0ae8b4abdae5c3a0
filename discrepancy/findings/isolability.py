"""What a sensor set can tell apart: separations between effects of typical size, before any data or beside them.

For two effects with whitened columns a and b (the change of all data by an effect of typical size), what the
nuisances can absorb is taken out of both. The norm of what is left of a is its visibility d'; the least norm of a - s b
over all sizes s is the separation of a from b. It is not symmetric: a strong effect may be far from a weak one that is
near to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fitting.inference.fit import Fit, projected
from fitting.inference.hypothesis import Term
from fitting.inference.unknown import Unknown, precision
from solver.quantities.coordinate import SCALE

Array = np.ndarray

# d' that is said to show, and to be told apart. With -2 ln evidence of 9.2 (odds of 1 : 100) as the least that rules
# out, and its scatter of 2 d', one of 3 can, one of 6 does in 99 of 100 records; 5 pays the price of a first effect
INVISIBLE = 3.0  # of a typical effect, below which sensors cannot see it
INSEPARABLE = 6.0  # between two typical effects, below which sensors cannot tell them apart
DETECTABLE = 5.0  # of the smallest detectable size: named half the time or more


@dataclass(frozen=True)
class Isolability:
    """What a sensor set can tell apart, before any data.

    labels : names of effects, each at the place where it shows most. separation : (n, n) d' of the effect of a row, of
    typical size, after the best refit of that of a column, wherever it comes nearest (0 on the diagonal). visibility :
    (n,) d' of each after the nuisance refit. invisible : those that do not show. not_judged : effects without a
    derivative here, as another kind of outlet, or those that are this animal where walls differ.
    """

    labels: tuple[str, ...]
    separation: Array
    visibility: Array
    invisible: tuple[str, ...]
    not_judged: tuple[str, ...] = ()

    @property
    def visible(self) -> dict[str, float]:
        """The effects that show, with their visibility."""
        return {e: float(d) for e, d in zip(self.labels, self.visibility, strict=True) if e not in self.invisible}

    def rivals(self, label: str) -> dict[str, float]:
        """The separation d' of an effect from every other visible one."""
        row = dict(zip(self.labels, self.separation[self.labels.index(label)], strict=True))
        return {e: float(row[e]) for e in self.visible if e != label}

    def nearest(self, label: str) -> tuple[str, float] | None:
        """The visible effect that comes nearest to another, and their separation d'; None where there is no other."""
        return min(self.rivals(label).items(), key=lambda pair: pair[1], default=None)

    def confused(self, label: str) -> tuple[str, ...]:
        """The visible effects that one of typical size cannot be told from: in their best size, they look like it."""
        return tuple(e for e, d in self.rivals(label).items() if d < INSEPARABLE)


@dataclass(frozen=True)
class Detectable:
    """The least change of a number of an effect, from what the model has, that this record would have shown.

    parameter : the number, as "CA.phi0"; ratio : the other number of its owner that it is counted relative to, as "E",
    or "". change : in ``unit``; a part of the number if ``relative``; NaN where none that is allowed would show.
    either : whether the opposite change is allowed, too.
    """

    parameter: str
    change: float
    unit: str
    relative: bool = False
    either: bool = False
    ratio: str = ""


def isolability(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> Isolability:
    """Of every effect the most visible place, against every other effect wherever that comes nearest.

    Effects without a column at any place, as another kind of outlet in a study, are not judged.
    """
    effects = list(dict.fromkeys(t.effect for t in terms if t.label in columns))
    not_judged = tuple(dict.fromkeys(t.effect for t in terms if t.effect not in effects))
    left = {
        t.label: projected(base.J, precision(base.prior, base.x), columns[t.label]) for t in terms if t.label in columns
    }
    places = {e: [t for t in terms if t.effect == e and t.label in left] for e in effects}
    size = {label: float(np.linalg.norm(_typical(x))) for label, x in left.items()}
    best = {e: max((t.label for t in there), key=lambda label: size[label]) for e, there in places.items()}
    visibility = np.array([size[best[e]] for e in effects])
    separation = np.zeros((len(effects), len(effects)))
    for i, a in enumerate(effects):
        for j, b in enumerate(effects):
            if i != j:
                separation[i, j] = min(_apart(_typical(left[best[a]]), left[t.label]) for t in places[b])
    invisible = tuple(e for e, d in zip(effects, visibility, strict=True) if d < INVISIBLE)
    return Isolability(tuple(effects), separation, visibility, invisible, not_judged)


def smallest(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> dict[str, Detectable]:
    """Per effect, by its label at the place where it shows at the smallest size: the change that has d' = DETECTABLE,
    of either sign, within the range that is allowed; NaN where no size in it would show at any place."""
    found: dict[str, tuple[float, Term, Unknown]] = {}
    for term in (t for t in terms if t.label in columns):
        left = projected(base.J, precision(base.prior, base.x), columns[term.label])
        i = _strongest(left)
        unknown, d = term.unknowns[i], float(np.linalg.norm(left[:, i]))
        x = DETECTABLE / d if d > 0.0 else np.inf
        allowed = next((size for size in (x, -x) if unknown.low <= size <= unknown.high and np.isfinite(size)), np.nan)
        known = found.get(term.effect)
        if known is None or abs(allowed) < abs(known[0]) or (np.isnan(known[0]) and not np.isnan(allowed)):
            found[term.effect] = (allowed, term, unknown)
    return {term.label: _detectable(unknown, x) for x, term, unknown in found.values()}


def _detectable(unknown: Unknown, x: float) -> Detectable:
    """The least x that shows as a change of the number that it moves; of a factor, as a part of it."""
    relative, moved = unknown.kind == SCALE, unknown.size * x
    change, unit = (float(np.expm1(moved)), "1") if relative else (float(moved), unknown.unit)
    return Detectable(unknown.name, change, unit, relative, unknown.low <= -x <= unknown.high, unknown.ratio or "")


def _strongest(left: Array) -> int:
    """Which unknown of an effect shows most at its typical size."""
    return int(np.argmax((left**2).sum(axis=0)))


def _typical(left: Array) -> Array:
    """The change of an effect of typical size: of its first unknown, or of the strongest one."""
    return left[:, _strongest(left)]


def _apart(a: Array, b: Array) -> float:
    """What is left of a when any size of the effect with columns b is taken away."""
    fit = np.linalg.lstsq(b, a, rcond=1e-10)[0]
    return float(np.linalg.norm(a - b @ fit))
