"""What a sensor set can tell apart: separations between effects of typical size, before any data or beside them.

For two effects with whitened columns a and b (the change of all data by an effect of typical size), what the
nuisances can absorb is taken out of both. The norm of what is left of a is its visibility d'; the least norm of a - s b
over all sizes s is the separation of a from b. It is not symmetric: a strong effect may be far from a weak one that is
near to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fitting.inference.fit import Fit, projected
from fitting.inference.terms import Term
from fitting.inference.unknown import Unknown, precision
from solver.coordinate import SCALE

from . import thresholds
from .outcome import Detectable, Isolability

Array = np.ndarray


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
    invisible = tuple(e for e, d in zip(effects, visibility, strict=True) if d < thresholds.INVISIBLE)
    return Isolability(tuple(effects), separation, visibility, invisible, not_judged)


def smallest(
    base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]
) -> dict[str, tuple[Term, Unknown, float | None]]:
    """Per effect, where it shows at the smallest size: the term, its unknown and the x that has d' = DETECTABLE.

    x is of either sign, within the range that is allowed; None where no size in it would show at any place.
    """
    found: dict[str, tuple[Term, Unknown, float | None]] = {}
    for term in terms:
        if term.label not in columns:
            continue
        left = projected(base.J, precision(base.prior, base.x), columns[term.label])
        i = _strongest(left)
        unknown, d = term.unknowns[i], float(np.linalg.norm(left[:, i]))
        x = thresholds.DETECTABLE / d if d > 0.0 else np.inf
        allowed = next((size for size in (x, -x) if unknown.low <= size <= unknown.high and np.isfinite(size)), None)
        known = found.get(term.effect)
        least = known[2] if known else None
        if known is None or (allowed is not None and (least is None or abs(allowed) < abs(least))):
            found[term.effect] = (term, unknown, allowed)
    return found


def detectable(unknown: Unknown, x: float | None) -> Detectable:
    """The least x that shows as a change of the number that it moves; of a factor, as a part of it."""
    relative = unknown.kind == SCALE
    moved = unknown.size * (np.nan if x is None else x)
    change, unit = (float(np.expm1(moved)), "1") if relative else (float(moved), unknown.unit)
    either = x is not None and unknown.low <= -x <= unknown.high
    return Detectable(unknown.name, change, unit, relative, either, unknown.ratio or "")


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
