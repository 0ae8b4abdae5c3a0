"""Anderson's mixing: slowly filling pressures of beats are extrapolated, and slowly falling corrections of waves mixed.

A beat maps a state y to f(y), and the periodic state is y = f(y). Transients of the pulse decay within a beat or two,
but Windkessels fill with their time constants R2 C. Anderson's extrapolation of the last beats,

    y = Σ w_k f(y_k),     Σ w_k = 1,     so that |Σ w_k r_k| is least,

with r_k the change of the pressures at the outlets in beat k, is exact for m - 1 slow modes if it uses m beats; there
are few slow modes, because all Windkessels share the pressure of the large arteries. The last waves g_n that
corrections f_n lead to are mixed with earlier ones in the same way, with the flows of f_j for r_k. Equations that are
linear and that all waves fulfil stay fulfilled.

D. G. Anderson, Iterative procedures for nonlinear integral equations, J. ACM 12 (1965) 547.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..scheme.model import Model
from ..scheme.step import State
from .waves import Waves

Array = np.ndarray

_LONG = 1e6  # s, a stage long enough that an outlet acts as its resistance
_KEPT = 4  # number of beats in the extrapolation
SLOW = 0.25  # ratio of successive gaps of beats, or sizes of corrections: below it, they need no mixing
EARLIER = 2  # corrections beside the last one; a third one saves no further correction of any bundled network
_INDEPENDENT = 1e-10  # of the corrections' squares, added to the normal equations
_SOON = 0.1  # of the gap remaining after a beat: below it, rest is a good start
_SAME = 1e-3  # changes of r below this fraction of the largest carry no information
_FURTHEST = 100.0  # Σ |w|


@dataclass(frozen=True)
class Beats:
    """The last beats: their ends f(y), the changes r : (B, n_outlets) [Pa], and the gaps between end and start.

    outlets : the nodes of the outlets.
    """

    outlets: slice
    ends: tuple[State, ...] = ()
    changes: tuple[Array, ...] = ()
    gaps: tuple[float, ...] = ()

    def followed(self, start: State, end: State, gap: float) -> Beats:
        """These beats and one more; only the new one if its gap is larger than the previous one."""
        kept = Beats(self.outlets) if self.gaps and not gap <= self.gaps[-1] else self
        change = end.H[:, self.outlets] - start.H[:, self.outlets]
        more = Beats(self.outlets, (*kept.ends, end), (*kept.changes, change), (*kept.gaps, gap))
        return replace(more, ends=more.ends[-_KEPT:], changes=more.changes[-_KEPT:], gaps=more.gaps[-_KEPT:])

    def mixed(self) -> State | None:
        """The start of the next beat; None for the end of the last one."""
        if len(self.gaps) < 2 or self.gaps[-1] < SLOW * self.gaps[-2]:
            return None
        last, w = self.ends[-1], self.weights()
        if not np.abs(w).sum(axis=0).max() <= _FURTHEST:
            return None
        mixed = replace(
            last,
            y=np.einsum("kb,kbn->bn", w, [end.y for end in self.ends]),
            A_t=np.einsum("kb,kb...->b...", w, [end.A_t for end in self.ends]),
            H=np.einsum("kb,kbn->bn", w, [end.H for end in self.ends]),
            unknowns=np.einsum("kb,ksbm->sbm", w, [end.unknowns for end in self.ends]),
            unknowns_before=np.einsum("kb,ksbm->sbm", w, [end.unknowns_before for end in self.ends]),
        )
        return mixed if (mixed.A > 0.0).all() else None

    def weights(self) -> Array:
        """w : (beats, B)."""
        r = np.stack(self.changes, axis=-1)  # (B, n_outlets, beats)
        share = np.linalg.pinv(r[..., -1:] - r[..., :-1], rcond=_SAME) @ r[..., -1:]
        return np.concatenate([share[..., 0], 1.0 - share.sum(axis=1)], axis=1).T


def fills_slowly(model: Model, T: float) -> bool:
    """True if the arteries and Windkessels of any member need more than a few beats of length T [s] to fill.

    Their time constant is τ = C/Σ(1/R) at rest: a fraction e^{-T/τ} of a gap remains after a beat.
    """
    c, stiffness = model.coefficients, model.wall.stiffness(model.A_rest)
    capacity = (-model.mesh.element.w_gauss / model.minus_J_inverse / stiffness).sum(axis=(1, 2))
    conductance = np.zeros(c.B)
    with np.errstate(all="ignore"):
        for ends in c.outlets:
            load = ends.load(model.outlet_wall.at(ends.index), _LONG)
            slope = load.slope(c.P_0 - c.P_venous[:, ends.index]) / load.scale
            conductance = conductance + np.nan_to_num(slope, nan=np.inf).sum(axis=1)
            capacity = capacity + ends.kind.capacity(ends.numbers).sum(axis=1)
        return bool(np.any(np.exp(-T * conductance / capacity) > _SOON))


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
