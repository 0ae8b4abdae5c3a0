"""The model discrepancy of a bench: the unexplained residual as a random error, with its size estimated by evidence.
In a network the discrepancy consists of free terms at places (:mod:`fitting.inference.source_maps.source_map`), or is
an error of the channels (:mod:`fitting.inference.joint.model_error`).

Harmonics of the error are independent with the standard deviation a s_k, where s_k is the size of the pressure's own
harmonics and a is a fraction estimated from the record: one for the harmonics, and one for the mean. In the whitened
residual its covariance is

    C = 1 + Σ_c a_c² B_c B_cᵀ

This is a Gaussian process of the harmonics. The fractions maximise the restricted likelihood, after projecting out the
part of the residual that the unknowns can absorb. H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545; M. C.
Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .fit import Array, Fit
from .gauss_newton import linear_step
from .places import Place
from .unknown import precision

PART = 2.0  # -2 ln of the odds beforehand of each part that is not zero: judgement
LARGEST = 1.0  # of a part: an error as large as the pulse
_SMALLEST = 1e-6
_STEPS = 40
_TAKEN = 0.02  # smallest fraction of an error that the unknowns leave, for the residual to determine it
_SETTLED = 1e-2  # relative change of a part that ends the search


@dataclass(frozen=True)
class Beside:
    """A hypothesis with a model discrepancy, integrated out.

    fit : whitened with it. errors : the argument of ``widened`` of its problem. cost : -2 ln of the prior odds of the
    chosen errors. places : of the network, where they act.
    """

    fit: Fit
    errors: Array
    cost: float
    places: tuple[Place, ...] = ()


@dataclass(frozen=True)
class Block:
    """Entries of z that share errors. rows : (r,) of z. B : (r, q) an error of each kind, whitened. part : (q,) the
    index of the part that it belongs to."""

    rows: Array
    B: Array
    part: Array


def sizes(X: Array) -> Array:
    """(K+1, m) the size of the harmonics of channels with coefficients X : (K+1, m), neighbours taken together.

    The mean has that of the pulse.
    """
    size = np.abs(X)
    size[0] = np.sqrt(2.0 * (size[1:] ** 2).sum(axis=0))
    padded = np.pad(size[1:], ((1, 1), (0, 0)), mode="edge")
    size[1:] = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    return size


def beside(fit: Fit, blocks: Sequence[Block], n_parts: int) -> Beside:
    """A fit with its most probable model discrepancy."""
    parts = estimated(fit, blocks, n_parts)
    return Beside(widened(fit, blocks, parts), parts, PART * float(np.count_nonzero(parts)))


def widened(fit: Fit, blocks: Sequence[Block], parts: Array) -> Fit:
    """A fit as it looks with errors of these parts: z and J whitened anew, about where it is."""
    z, J, log_volume = fit.z.copy(), fit.J.copy(), fit.log_volume
    for block in blocks:
        L = np.linalg.cholesky(_covariance(block, parts))
        z[block.rows] = np.linalg.solve(L, fit.z[block.rows])
        J[block.rows] = np.linalg.solve(L, fit.J[block.rows])
        log_volume += 2.0 * float(np.log(np.diag(L)).sum())
    return settled(replace(fit, z=z, J=J, log_volume=log_volume))


def settled(fit: Fit) -> Fit:
    """A fit moved to the minimum of its linear problem, within its bounds."""
    step = linear_step(fit, fit.J, fit.z)
    return replace(fit, x=fit.x + step, z=fit.z + fit.J @ step)


def estimated(fit: Fit, blocks: Sequence[Block], n_parts: int, largest: Array | float = LARGEST) -> Array:
    """(n_parts,) the parts a_c that make the residual of a fit most probable, its unknowns refitted. largest : of each.

    The fixed point of D. A. Harville (J. Am. Stat. Assoc. 72, 1977, 320): a² <- a² (zᵀP B Bᵀ P z)/tr(Bᵀ P B), with P
    the inverse covariance, projected on the residuals of the unknowns.
    """
    parts = np.full(n_parts, 0.03)
    for _ in range(_STEPS):
        power, trace = _sums(fit, blocks, parts)
        ratio = np.sqrt(power / np.maximum(trace, 1e-300))
        new = np.clip(parts * np.clip(ratio, 0.1, 10.0), _SMALLEST, largest)
        done = np.all((np.abs(new - parts) < _SETTLED * parts) | (new == _SMALLEST))
        parts = new
        if done:
            break
    return np.where(parts > 10.0 * _SMALLEST, parts, 0.0)


def worst_octave(residual: Array, order: Array) -> float:
    """The largest mean over an octave (harmonics 0 to 3, then 4 to 7, 8 to 15 …) of squares ``residual`` : (n,) of a
    whitened residual, which an error that is equal at all harmonics underestimates. order : (n,) harmonics."""
    octave = np.maximum(np.log2(np.maximum(order, 1)).astype(int), 1)
    return float((np.bincount(octave, residual) / np.maximum(np.bincount(octave), 1)).max())


def _sums(fit: Fit, blocks: Sequence[Block], parts: Array) -> tuple[Array, Array]:
    """Σ (Bᵀ P z)² and tr(Bᵀ P B) of every part."""
    inverse = [np.linalg.inv(_covariance(b, parts)) for b in blocks]
    JC = [fit.J[b.rows].T @ C for b, C in zip(blocks, inverse, strict=True)]
    normal = sum(j @ fit.J[b.rows] for b, j in zip(blocks, JC, strict=True)) + np.diag(precision(fit.prior, fit.x))
    known = np.linalg.pinv(normal, hermitian=True)
    y = fit.z - fit.J @ fit.x
    x = -known @ sum(j @ y[b.rows] for b, j in zip(blocks, JC, strict=True))
    power, trace, whole = np.zeros(len(parts)), np.zeros(len(parts)), np.zeros(len(parts))
    for b, C, j in zip(blocks, inverse, JC, strict=True):
        projected = b.B.T @ (C @ (y[b.rows] + fit.J[b.rows] @ x))
        taken = b.B.T @ j.T
        own = (b.B * (C @ b.B)).sum(axis=0)
        power += np.bincount(b.part, projected**2, len(parts))
        trace += np.bincount(b.part, own - (taken * (taken @ known)).sum(axis=1), len(parts))
        whole += np.bincount(b.part, own, len(parts))
    return power, np.maximum(trace, _TAKEN * whole)


def _covariance(block: Block, parts: Array) -> Array:
    scaled = block.B * parts[block.part]
    return np.eye(len(block.rows)) + scaled @ scaled.T
