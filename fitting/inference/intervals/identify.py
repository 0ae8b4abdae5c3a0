"""Identifiability: the parameters that data determine, from the singular values of a whitened Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Array = np.ndarray

_WEAK = 1.0  # below this singular value, in prior units, a direction depends more on the prior than on the data
_PART = 0.25  # of the largest component: smaller ones are left out of a sentence
_CORRELATED = 0.95
_NOTHING = 1e-8  # precision in prior units of a direction that neither data nor prior determine


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
