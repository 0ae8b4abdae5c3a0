"""The noise of pressure and radius of one wall where the beats themselves differ.

A wall answers a change of radius by a change of pressure, δP = A δR, with A of the mean loop; that is no noise. What is
left, u_b = δP_b - A δR_b, is that of both sensors:

    S_u = S_P + |A|² S_R.

The share s of the change of R that P does not follow is noise of R, S_R = s var(R). P less the part that it follows,
(1 - s) A δR, has nothing in common with R and the variance S_P + (1 - s)|A|² S_R, which gives S_P.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..records import thresholds as limit
from ..records.beats import Beats
from ..records.felt import felt
from ..records.noise import following, steady_beats
from ..records.spectral import coefficients, resample

Array = np.ndarray

_ORDER = 3  # elastic, viscous and what bends them: powers of iω
_FOLLOWING = "P if it followed R"


def loop_noise(beats: Beats, site: str, N: int) -> tuple[Array, Array]:
    """Covariance (K + 1, 2, 2), K = N'//2 of N' samples a beat, of the mean beats of P and R of a site, and the part
    (N,) of P that is there because beats differ in length."""
    P, R = names = (f"{site}.P", f"{site}.R")
    raw = beats.covariance(names)
    a = _law(beats, names, raw)
    K = len(raw) - 1
    A = _series(a, beats.T, K)
    seen = felt(beats, R, lambda T, n: _series(a, T, n)[:, None], K, memory=False)
    moved = following(beats, A[:, None], seen, R)[0]
    # a name without converter: what rounding leaves in the mean beat is no change from beat to beat
    both = replace(beats, values={P: beats.values[P], _FOLLOWING: moved}).covariance((P, _FOLLOWING))
    followed, could = both[:, 0, 1].real, both[:, 1, 1].real
    coherent = followed**2 > limit.COHERENT * both[:, 0, 0].real * could
    gaps = any(np.isnan(beats.values[name]).mean() > limit.HOLES for name in names)
    seam = np.zeros(beats.N) if seen is None else seen.seam[0]
    known = np.abs(limit.SEAM_ERROR * coefficients(seam)) ** 2
    if gaps or (seen is None and not coherent[1 : limit.LOW].any()):
        raw[:, 0, 0] += known
        return raw, resample(seam, N)
    share, steady = steady_beats(beats, (P,), A[:, None], seen, R)
    noise = steady.covariance(names) * share[:, None, None]
    own, S_R = steady.covariance((P,))[:, 0, 0].real, noise[:, 1, 1].real
    noise[:, 1, 1] = np.maximum(S_R, raw[1:, 1, 1].real.min())
    noise[:, 0, 0] = np.maximum(own - (1.0 - share) * np.abs(A) ** 2 * S_R, own[1:].min())
    noise[:, 0, 0] += known
    return noise, resample(seam, N)


def _law(beats: Beats, names: tuple[str, str], noise: Array) -> Array:
    """(_ORDER,) real a with P_k = Σ a_i (iω_k)^i R_k of the mean loop, by least squares."""
    P, R = (coefficients(beats.mean(name)) for name in names)
    sd = np.sqrt(np.maximum(np.einsum("kii->ki", noise).real, np.finfo(float).tiny))
    told = (np.abs(R) > limit.LOOP_SHOWN * sd[:, 1]) & (np.abs(P) > limit.LOOP_SHOWN * sd[:, 0])
    told[0] = False
    told[1 : _ORDER + 1] = True
    k = np.flatnonzero(told)
    weight = 1.0 / np.sqrt(sd[k, 0] ** 2 + np.abs(P[k] / R[k]) ** 2 * sd[k, 1] ** 2)
    columns = (2j * np.pi / beats.T * k[:, None]) ** np.arange(_ORDER) * (R[k] * weight)[:, None]
    right = P[k] * weight
    size = np.abs(columns).max(axis=0)
    M = np.concatenate([columns.real, columns.imag]) / size
    return np.linalg.lstsq(M, np.concatenate([right.real, right.imag]), rcond=None)[0] / size


def _series(a: Array, T: float, n: int) -> Array:
    """Σ a_i (iω)^i at the harmonics 0 … n of T : (n + 1,)."""
    return (2j * np.pi / T * np.arange(n + 1)[:, None]) ** np.arange(len(a)) @ a
