"""Mixing of successive corrections of waves, so that those that would fall slowly fall faster.

The last waves g_n that corrections f_n lead to are mixed with earlier ones,

    g = Σ w_j g_j,    Σ w_j = 1,    so that |Σ w_j f_j| of the flows is least.

Equations that are linear and that all waves fulfil stay fulfilled.

D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965) 547.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .waves import Waves

Array = np.ndarray

EARLIER = 2  # corrections beside the last one; a third one saves no further correction of any bundled network
SLOW = 0.25  # of the correction before: a smaller one needs no mixing
_INDEPENDENT = 1e-10  # of the corrections' squares, added to the normal equations


def mixed(history: Sequence[tuple[Array, Waves]], slow: Array) -> Waves:
    """The last corrected waves, for members whose corrections fall slowly : (B,) mixed with those before them.

    history : corrections (K+1, B, …) of the flows and the waves to which they lead; the last one last.
    """
    last, g = history[-1]
    if len(history) == 1 or not slow.any():
        return g
    apart = np.stack([last - flows for flows, _ in history[:-1]])
    gram = np.einsum("ikbeq,jkbeq->bij", apart.conj(), apart).real
    gram += (_INDEPENDENT * np.trace(gram, axis1=1, axis2=2) + np.finfo(float).tiny)[:, None, None] * np.eye(len(apart))
    right = np.einsum("ikbeq,kbeq->bi", apart.conj(), last).real
    weight = np.where(slow[:, None], np.linalg.solve(gram, right[..., None])[..., 0], 0.0)
    y, H = g.y.copy(), g.H.copy()
    for w, (_, before) in zip(weight.T[..., None], history[:-1], strict=True):
        y -= w * (g.y - before.y)
        H -= w * (g.H - before.H)
    return Waves(g.omega, y, H)
