"""What a sensor set can tell apart: separations between effects of typical size, before any data or beside them.

For two effects with whitened columns a and b (the change of all data by an effect of typical size), what the
nuisances can absorb is taken out of both. The norm of what is left of a is its visibility d'; the norm of what b in
any size cannot make of it, the separation of a from b. A strong effect may be far from a weak one that is near to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from . import thresholds
from .fits import Fit, precision, projected
from .outcome import Isolability
from .terms import Term

Array = np.ndarray


def isolability(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> Isolability:
    """Of every effect the most visible place, against every other effect wherever that comes nearest."""
    effects = list(dict.fromkeys(t.effect for t in terms))
    left = {
        t.label: projected(base.J, precision(base.prior, base.x), columns[t.label]) for t in terms if t.label in columns
    }
    places = {e: [t for t in terms if t.effect == e and t.label in left] for e in effects}
    size = {label: float(np.linalg.norm(_typical(x))) for label, x in left.items()}
    best = {e: max((t.label for t in there), key=lambda label: size[label]) for e, there in places.items() if there}
    visibility = np.array([size[best[e]] if e in best else 0.0 for e in effects])
    separation = np.zeros((len(effects), len(effects)))
    for i, a in enumerate(effects):
        for j, b in enumerate(effects):
            if i != j and a in best and b in best:
                separation[i, j] = min(_apart(_typical(left[best[a]]), left[t.label]) for t in places[b])
    invisible = tuple(e for e, d in zip(effects, visibility, strict=True) if d < thresholds.INVISIBLE)
    return Isolability(tuple(effects), separation, visibility, invisible, _classes(effects, separation, invisible))


def smallest(base: Fit, columns: Mapping[str, Array], terms: Sequence[Term]) -> dict[str, tuple[Term, float]]:
    """Per effect, where it is most visible, the size x that would have d' = DETECTABLE there."""
    found: dict[str, tuple[Term, float]] = {}
    for term in terms:
        if term.label not in columns:
            continue
        d = float(np.linalg.norm(_typical(projected(base.J, precision(base.prior, base.x), columns[term.label]))))
        x = thresholds.DETECTABLE / d if d > 0.0 else np.inf
        if term.effect not in found or x < found[term.effect][1]:
            found[term.effect] = (term, x)
    return found


def _typical(left: Array) -> Array:
    """The change of an effect of typical size: of its first unknown, or of the strongest one."""
    return left[:, int(np.argmax((left**2).sum(axis=0)))]


def _apart(a: Array, b: Array) -> float:
    """What is left of a when any size of the effect with columns b is taken away."""
    fit = np.linalg.lstsq(b, a, rcond=1e-10)[0]
    return float(np.linalg.norm(a - b @ fit))


def _classes(effects: Sequence[str], separation: Array, invisible: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Groups of visible effects that cannot be told apart, directly or through one another."""
    visible = [i for i, e in enumerate(effects) if e not in invisible]
    group = {i: {i} for i in visible}
    for i in visible:
        for j in visible:
            near = max(separation[i, j], separation[j, i]) < thresholds.INSEPARABLE
            if i < j and near and group[i] is not group[j]:
                group[i] |= group[j]
                for k in group[j]:
                    group[k] = group[i]
    found = {id(g): tuple(effects[i] for i in sorted(g)) for g in group.values()}
    return tuple(g for g in found.values() if len(g) > 1)
