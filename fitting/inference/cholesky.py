"""Symmetric positive definite systems by one Cholesky factorisation."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
_FAR = 1e200  # so that what is appended stays positive definite; it has no influence on the rows before it


def forward(A: Array, right: Array) -> tuple[Array, Array]:
    """L⁻¹ right : (…, p, n) and ln det A : (…,), with A = L Lᵀ : (…, p, p) and right : (…, p, n).

    The right-hand sides are appended to A as rows, so that the factorisation solves for them: NumPy has no triangular
    solve, and its general one takes longer than the factorisation. Raises LinAlgError if A is not positive definite.
    """
    p, n = right.shape[-2:]
    both = np.zeros((*A.shape[:-2], p + n, p + n))
    both[..., :p, :p] = A
    both[..., p:, :p] = right.swapaxes(-1, -2)
    both[..., range(p, p + n), range(p, p + n)] = _FAR
    L = np.linalg.cholesky(both)
    diagonal = np.diagonal(L, axis1=-2, axis2=-1)[..., :p]
    return L[..., p:, :p].swapaxes(-1, -2), 2.0 * np.log(diagonal).sum(axis=-1)
