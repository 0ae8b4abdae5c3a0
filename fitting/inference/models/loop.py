"""A loop of two noisy channels, linearised: the functional errors-in-variables model.

The mean beats are P̄ = G(R; θ) + n_P and R̄ = R + n_R with the true radius R : (N,) unknown beside the parameters θ.
With A = ∂G/∂R, linearised at the present R and θ, the residual

    u = P̄ - G(R; θ) - A (R̄ - R) = n_P - A n_R + C δθ,    V = ⟨u uᵀ⟩ = C_PP - A C_RP - C_PR Aᵀ + A C_RR Aᵀ

gives δθ by generalised least squares, and then the most probable radius R = R̄ - (C_RP - C_RR Aᵀ) V⁻¹ u. The iteration
converges to the maximum of the joint likelihood (Britt and Luecke, Technometrics 15, 1973, 233–247): columns evaluated
at the noisy R̄ would bias θ, columns at the estimated R do not. The noise need not be white: its covariance is
circulant, one 2×2 matrix per harmonic, so that beat-to-beat variation common to P and R does not count as noise of the
law.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from solver.errors import InputError
from solver.loop import circulant

from ...records import limits
from ...records.alignment.beats import Array, Beats
from ...records.channels import spectral
from ...records.channels.noise import following, steady_beats
from ...records.channels.spectral import coefficients
from ...records.channels.variability import beat_variation

_MOST_SAMPLES = 127  # of a fitted beat: 63 harmonics; odd, so that both parts of each are known
_FLOOR = 1e-10  # least noise relative to the pulse: keeps V regular for noise-free data
_ORDER = 3  # powers of iω: elastic, viscous and curvature
_FOLLOWING = "P if it followed R"


class NoFit(InputError):
    """No wall of this model fits the loop."""


@dataclass(frozen=True)
class Loop:
    """Mean beats P, R : (N,) [Pa], [m] of period T [s] and the noise of their Fourier coefficients.

    noise : (N//2 + 1, 2, 2) covariance of (P̂_k, R̂_k). model_error : standard deviation of every P̂_k [Pa] by which the
    law is allowed to miss the loop, beside the noise.
    """

    P: Array
    R: Array
    T: float
    noise: Array
    model_error: float = 0.0

    @property
    def N(self) -> int:
        return len(self.P)

    @property
    def floor(self) -> tuple[float, float]:
        """Variances of a Fourier coefficient that represent rounding."""
        P, R = (float((_FLOOR * np.ptp(x)) ** 2) / self.N for x in (self.P, self.R))
        return P, R

    @property
    def least(self) -> tuple[float, float]:
        """Variances of a Fourier coefficient beside the noise: of rounding and, for P, of the model error."""
        P, R = self.floor
        return P + self.model_error**2, R

    def earlier(self, lag: float) -> Loop:
        """The loop with P moved forward in time by ``lag`` [s]."""
        return replace(self, P=spectral.shift(self.P, -lag / self.T)) if lag else self

    @cached_property
    def covariances(self) -> tuple[Array, Array, Array]:
        """C_PP, C_RR, C_RP : (N, N) of the samples."""
        PP, RR = (circulant(self.N * (self.noise[:, i, i] + self.least[i]), self.N) for i in (0, 1))
        return PP, RR, circulant(self.N * self.noise[:, 1, 0], self.N)

    @cached_property
    def weights(self) -> Array:
        """(N//2 + 1, 2, 2) inverse covariance of the coefficients; twice that of those which stand for two."""
        weights = np.linalg.inv(self.noise + np.diag(self.least))
        weights[1 : (self.N + 1) // 2] *= 2.0
        return weights

    def misfit(self, P: Array, R: Array) -> float:
        """-2 ln of the joint likelihood of true waves P, R : (N,), up to a constant."""
        residual = coefficients(np.array([self.P - P, self.R - R])).T
        return float(np.einsum("ki,kij,kj->", residual.conj(), self.weights, residual).real)


def mean_loop(beats: Beats, site: str) -> Loop:
    """The mean beats of P and R of a site, and the noise of their harmonics. Raises ValueError if the channels are
    missing or do not pulsate."""
    names = (f"{site}.P", f"{site}.R")
    beats = paired(beats, site)
    P, R = (beats.mean(name) for name in names)
    N = min(beats.N, _MOST_SAMPLES)
    noise, seam = _loop_noise(beats, site, N)
    return Loop(spectral.resample(P, N) - seam, spectral.resample(R, N), beats.T, noise[: N // 2 + 1])


def paired(beats: Beats, site: str) -> Beats:
    """Make gaps of P gaps of R and vice versa, unless that leaves a phase without any sample.

    Beat-to-beat variation must be in the mean of both, or in neither.
    """
    P, R = beats.site(site)
    gaps = np.isnan(P) | np.isnan(R)
    if not gaps.any() or gaps.all(axis=0).any():
        return beats
    paired = {name: np.where(gaps, np.nan, x) for name, x in ((f"{site}.P", P), (f"{site}.R", R))}
    return replace(beats, values=paired)


def _loop_noise(beats: Beats, site: str, N: int) -> tuple[Array, Array]:
    """Covariance (K + 1, 2, 2), K = N'//2 of N' samples a beat, of the mean beats of P and R of a site, and the part
    (N,) of P caused by different lengths of beats.

    A wall responds to a change of radius with a change of pressure, δP = A δR, with A of the mean loop; that is no
    noise. The rest, δP - A δR, is noise of both sensors: S_u = S_P + |A|² S_R. The share s of the change of R that P
    does not follow is noise of R, S_R = s var(R). P minus the part that follows, (1 - s) A δR, is uncorrelated with R
    and has the variance S_P + (1 - s)|A|² S_R, which gives S_P.
    """
    P, R = names = (f"{site}.P", f"{site}.R")
    raw = beats.covariance(names)
    a = _law(beats, names, raw)
    K = len(raw) - 1
    A = _series(a, beats.T, K)
    variation = beat_variation(beats, R, lambda T, n: _series(a, T, n)[:, None], K, memory=False)
    moved = following(beats, A[:, None], variation, R)[0]
    # a name without converter: the rounding error of the mean beat is no beat-to-beat variation
    both = replace(beats, values={P: beats.values[P], _FOLLOWING: moved}).covariance((P, _FOLLOWING))
    followed, could = both[:, 0, 1].real, both[:, 1, 1].real
    coherent = followed**2 > limits.COHERENT * both[:, 0, 0].real * could
    gaps = any(np.isnan(beats.values[name]).mean() > limits.HOLES for name in names)
    seam = np.zeros(beats.N) if variation is None else variation.seam[0]
    known = np.abs(limits.SEAM_ERROR * coefficients(seam)) ** 2
    if gaps or (variation is None and not coherent[1 : limits.LOW].any()):
        raw[:, 0, 0] += known
        return raw, spectral.resample(seam, N)
    share, steady = steady_beats(beats, (P,), A[:, None], variation, R)
    noise = steady.covariance(names) * share[:, None, None]
    own, S_R = steady.covariance((P,))[:, 0, 0].real, noise[:, 1, 1].real
    could = np.sqrt(own * share * S_R)
    noise[:, 1, 1] = np.maximum(S_R, raw[1:, 1, 1].real.min())
    noise[:, 0, 0] = np.maximum(own - (1.0 - share) * np.abs(A) ** 2 * S_R, own[1:].min())
    # noise is correlated at most as the steady beats are, whose covariance is positive definite
    real = np.sqrt((noise[:, 0, 0] * noise[:, 1, 1]).real)
    within = np.minimum(1.0, np.divide(real, could, out=np.ones_like(could), where=could > 0.0))
    noise[:, [0, 1], [1, 0]] *= within[:, None]
    noise[:, 0, 0] += known
    return noise, spectral.resample(seam, N)


def _law(beats: Beats, names: tuple[str, str], noise: Array) -> Array:
    """(_ORDER,) real a with P_k = Σ a_i (iω_k)^i R_k of the mean loop, by least squares."""
    P, R = (coefficients(beats.mean(name)) for name in names)
    sd = np.sqrt(np.maximum(np.einsum("kii->ki", noise).real, np.finfo(float).tiny))
    significant = (np.abs(R) > limits.LOOP_SHOWN * sd[:, 1]) & (np.abs(P) > limits.LOOP_SHOWN * sd[:, 0])
    significant[0] = False
    significant[1 : _ORDER + 1] = True
    k = np.flatnonzero(significant)
    weight = 1.0 / np.sqrt(sd[k, 0] ** 2 + np.abs(P[k] / R[k]) ** 2 * sd[k, 1] ** 2)
    columns = (2j * np.pi / beats.T * k[:, None]) ** np.arange(_ORDER) * (R[k] * weight)[:, None]
    right = P[k] * weight
    size = np.abs(columns).max(axis=0)
    M = np.concatenate([columns.real, columns.imag]) / size
    return np.linalg.lstsq(M, np.concatenate([right.real, right.imag]), rcond=None)[0] / size


def _series(a: Array, T: float, n: int) -> Array:
    """Σ a_i (iω)^i at the harmonics 0 … n of T : (n + 1,)."""
    return (2j * np.pi / T * np.arange(n + 1)[:, None]) ** np.arange(len(a)) @ a


# --- the linear problem -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Linear:
    """The problem u = C δθ + noise of covariance V at one point, whitened: z = L⁻¹ F u with L Lᵀ = F V Fᵀ.

    z : (N,). columns : (N, p) L⁻¹ F C. L : (N, N) lower. F : (N, N) orthonormal, or None for unity. B : (N, N) with R =
    R̄ + Bᵀ V⁻¹ u. V : (N, N). R_bar : (N,) the measured radius.
    """

    z: Array
    columns: Array
    L: Array
    F: Array | None
    B: Array
    V: Array
    R_bar: Array

    def radius(self, whitened: Array) -> Array:
        """The most probable radius (N,) for a remaining residual ``whitened`` : (N,) of z."""
        w = solve_triangular(self.L, whitened, lower=True, trans=1, check_finite=False)
        return self.R_bar + self.B.T @ (w if self.F is None else self.F.T @ w)

    def after(self, step: Array) -> Array:
        """The most probable radius (N,) after a step (p,) along the columns."""
        return self.radius(self.z - self.columns @ step)

    def unwhiten(self, whitened: Array) -> Array:
        """The u : (N,) of some z."""
        u = self.L @ whitened
        return u if self.F is None else self.F.T @ u


def linearise(loop: Loop, R: Array, G: Array, A: Array, C: Array, F: Array | None = None) -> Linear:
    """The linear problem at the radius R : (N,), with the pressure G : (N,) of the law, its derivative A : (N, N) by R,
    and C : (N, p) by the parameters. F : orthonormal rows in whose order z is whitened.

    Raises NoFit if the law overflows, or if there is no noise to weight by.
    """
    C_PP, C_RR, C_RP = loop.covariances
    u = loop.P - G - A @ (loop.R - R)
    B = A @ C_RR - C_RP.T
    V = C_PP + B @ A.T - A @ C_RP
    L, white = _whitened(V if F is None else F @ V @ F.T, np.column_stack([u, C]), F)
    return Linear(white[:, 0], white[:, 1:], L, F, B, V, loop.R)


def leading(loop: Loop, R: Array, G: Array, A: Array, C: Array, F: Array) -> tuple[Array, Array, Array]:
    """z : (n,), columns : (n, p) and L : (n, n) of :func:`linearise` for its first n rows F : (n, N), at a fraction of
    the cost: they do not depend on later rows, but the most probable radius does. Raises NoFit as there."""
    C_PP, C_RR, C_RP = loop.covariances
    u = loop.P - G - A @ (loop.R - R)
    FA = F @ A
    V = F @ C_PP @ F.T + (FA @ C_RR - F @ C_RP.T) @ FA.T - FA @ (C_RP @ F.T)
    L, white = _whitened(V, np.column_stack([u, C]), F)
    return white[:, 0], white[:, 1:], L


def _whitened(V: Array, right: Array, F: Array | None) -> tuple[Array, Array]:
    """L with L Lᵀ = V, and L⁻¹ F times the columns of ``right``."""
    if not (np.isfinite(V).all() and np.isfinite(right).all()):
        raise NoFit("the law overflows on this loop; check the units of P, R and h.")
    try:
        L = cholesky(V, lower=True, check_finite=False)
    except LinAlgError:
        raise NoFit(
            "P and R are noise-free functions of one another, with no noise to weigh them by; "
            "check that one was not computed from the other."
        ) from None
    return L, solve_triangular(L, right if F is None else F @ right, lower=True, check_finite=False)


def spectrum(V: Array) -> Array:
    """Variances (N//2 + 1,) of the Fourier coefficients of samples with covariance V : (N, N)."""
    N = len(V)
    F = np.fft.rfft(V, axis=0) / N
    return np.array(np.fft.ifft(F, axis=1)[np.arange(N // 2 + 1), np.arange(N // 2 + 1)].real)


@lru_cache(maxsize=4)
def fourier(N: int) -> Array:
    """(N, N) orthonormal real Fourier basis by rows: mean, cos 1, sin 1, cos 2 …"""
    rows = [np.full(N, N**-0.5)]
    phase = 2.0 * np.pi * np.arange(N) / N
    for k in range(1, N // 2 + 1):
        if 2 * k == N:
            rows.append(np.cos(k * phase) * N**-0.5)
        else:
            rows += [np.cos(k * phase) * (2.0 / N) ** 0.5, np.sin(k * phase) * (2.0 / N) ** 0.5]
    return np.array(rows)
