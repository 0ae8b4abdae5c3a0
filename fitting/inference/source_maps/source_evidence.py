"""Evidence of unknown sources at places of a network, beside unknowns with priors: linear, in closed form.

    W_k (y_k + J_k θ + G_k g_k) is white,    k = 0 … K

with the residual y, extrapolated to θ = 0 and g = 0, and whiteners W that make real and imaginary parts N(0, 1). The
harmonics of a source p have a Gaussian prior that declines as for a smooth signal,

    Re g_pk, Im g_pk ~ N(0, a_p² (1 + (k/k0)²)^-n).

The evidence selects the amplitude a_p and the spectrum (k0, n) from a list, at the price of the list's length. Sources
do not couple harmonics, so they are integrated out harmonic by harmonic; the rest is an ordinary linear problem of θ
(:mod:`~fitting.inference.hierarchy`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..hierarchy import Array, forward

AMPLITUDES = tuple(
    10.0 ** (0.25 * i) for i in range(-8, 13)
)  # in units of the sources, 1 % of a pulse: up to ten pulses
SPECTRA = ((6.0, 1.0), (3.0, 2.0), (8.0, 2.0), (4.0, 4.0), (8.0, 4.0), (16.0, 4.0))  # k0 and n
FIRST_LOOK = (SPECTRA[1:3], 4)
_ROUNDING = 1e-8  # of the unknowns' own information (measured: sources of 100 pulses lost 2e-8 of the largest)
# numbers of the unknowns' columns of places that are weighed together; the largest array has as many for each unknown:
# 5 MB with 60
_AT_ONCE = 10_000
PRICE = 2.0 * math.log(len(SPECTRA) * len(AMPLITUDES))  # of a prior; all of the list are equally likely


@dataclass(frozen=True)
class Law:
    """The prior of the harmonics of a source."""

    amplitude: float
    k0: float
    n: float

    def variance(self, K: int, relative: Sequence[float]) -> Array:
        """(K+1, q) prior variances of the columns of a place, with sizes ``relative`` to one another."""
        falling = (1.0 + (np.arange(K + 1) / self.k0) ** 2) ** -self.n
        return self.amplitude**2 * falling[:, None] * np.square(relative)


@dataclass(frozen=True)
class Normal:
    """The normal equations of S sources and p unknowns.

    of_sources : (K+1, S, S). between : (K+1, S, p+1), sources with the unknowns and y. of_unknowns : (p+1, p+1) real.
    log_volume : ln det of the integrated-out part.
    """

    of_sources: Array
    between: Array
    of_unknowns: Array
    log_volume: float = 0.0

    @classmethod
    def of(cls, whitener: Array, y: Array, J: Array, G: Array) -> Normal:
        """whitener : (K+1, m, m). y : (K+1, m). J : (K+1, m, p). G : (K+1, m, S)."""
        two = np.where(np.arange(len(y)) == 0, 1.0, np.sqrt(2.0))[:, None, None]
        W = two * whitener
        own, sources = W @ np.concatenate([J, y[..., None]], axis=-1), W @ G
        own[0], sources[0] = own[0].real, sources[0].real
        adjoint = sources.conj().swapaxes(1, 2)
        return cls(adjoint @ sources, adjoint @ own, _gram(own, own))

    def without(self, columns: Array, variance: Array) -> Normal:
        """The same with some sources integrated out. columns : (q,) indices. variance : (K+1, q) of their harmonics."""
        if not len(columns):
            return self
        K, log_volume = self._kernel(columns, variance)
        left = self.of_sources[:, :, columns] @ K
        right = self.between[:, columns]
        return Normal(
            self.of_sources - left @ self.of_sources[:, columns],
            self.between - left @ right,
            self._less(_gram(right, K @ right)),
            self.log_volume + log_volume,
        )

    def _less(self, taken: Array) -> Array:
        """The equations of the unknowns minus the part absorbed by sources, (…, p+1, p+1). Sources may absorb nearly
        all of it, so a small diagonal keeps round-off from making it negative."""
        rounding = _ROUNDING * np.diagonal(self.of_unknowns).copy()
        rounding[-1] = 0.0
        return self.of_unknowns + np.diag(rounding) - taken

    def _kernel(self, columns: Array, variance: Array) -> tuple[Array, float]:
        """K = r (1 + r GᴴG r)⁻¹ r for the standard deviations r, and the ln det of the inverted matrix."""
        r = np.sqrt(variance)
        GG = r[:, :, None] * self.of_sources[:, columns[:, None], columns] * r[:, None]
        # by eigenvectors, because similar sources make GᴴG nearly singular
        value, vector = np.linalg.eigh(GG)
        value = np.maximum(value, 0.0)
        inverse = (vector / (1.0 + value)[:, None]) @ vector.conj().swapaxes(1, 2)
        log_det = np.log1p(value).sum(axis=1)  # of the real problem: half for the mean, which is real
        return r[:, :, None] * inverse * r[:, None], float(log_det[0] + 2.0 * log_det[1:].sum())

    def only(self, columns: Array) -> Normal:
        """The same with some of the sources, in this order."""
        own = self.of_sources[:, columns[:, None], columns]
        return Normal(own, self.between[:, columns], self.of_unknowns, self.log_volume)

    def best_laws(
        self, columns: Array, relative: Array, sd: Array,
        spectra: Sequence[tuple[float, float]] = SPECTRA, stride: int = 2,
    ) -> list[tuple[float, Law]]:  # fmt: skip
        """For each of P places with q columns, -2 ln evidence with it under its best prior, and this prior.

        columns, relative : (P, q), with the sizes of the columns. sd : (p,) standard deviations of the priors of the
        unknowns. stride : in the list of amplitudes; those next to the best one follow.
        """
        most = max(1, _AT_ONCE // (len(self.between) * columns.shape[1] * max(1, len(sd))))
        found = list[tuple[float, Law]]()
        for i in range(0, len(columns), most):
            found += self._best_laws(columns[i : i + most], relative[i : i + most], sd, spectra, stride)
        return found

    def _best_laws(
        self, columns: Array, relative: Array, sd: Array, spectra: Sequence[tuple[float, float]], stride: int
    ) -> list[tuple[float, Law]]:
        amplitudes, modes = np.array(AMPLITUDES), self._modes(columns, relative)
        coarse = np.arange(0, len(amplitudes), stride)
        falling = np.stack([Law(1.0, *each).variance(len(self.between) - 1, (1.0,))[:, 0] for each in spectra])
        variances = np.square(amplitudes[coarse])[:, None, None] * falling  # (A, V, K+1)
        scores = self._scores(*modes, variances.reshape(1, -1, falling.shape[1]), sd)
        i, j = np.unravel_index(scores.argmin(axis=1), variances.shape[:2])
        beside = np.clip(coarse[i][:, None] + [-1, 0, 1], 0, len(amplitudes) - 1)
        closer = self._scores(*modes, np.square(amplitudes[beside])[..., None] * falling[j][:, None], sd)
        best = closer.argmin(axis=1)
        return [
            (float(score[n]), Law(AMPLITUDES[at[n]], *spectra[k]))
            for score, n, at, k in zip(closer, best, beside, j, strict=True)
        ]

    def _modes(self, columns: Array, relative: Array) -> tuple[Array, Array]:
        """The eigenvalues (P, K+1, q) of GᴴG for columns of sizes ``relative``, which a common variance of a harmonic
        only scales, and the outer products (P, (K+1) q, (p+1)²) of the equations between their eigenvectors and the
        unknowns."""
        own = np.moveaxis(self.of_sources[:, columns[:, :, None], columns[:, None, :]], 0, 1)
        GG = relative[:, None, :, None] * own * relative[:, None, None]
        right = relative[:, None, :, None] * np.moveaxis(self.between[:, columns], 0, 1)  # (P, K+1, q, p+1)
        value, vector = (GG[..., 0].real, None) if columns.shape[1] == 1 else np.linalg.eigh(GG)
        right = right if vector is None else vector.conj().swapaxes(-1, -2) @ right
        parts = [part[..., :, None] * part[..., None, :] for part in (right.real, right.imag)]
        return np.maximum(value, 0.0), np.add(*parts).reshape(len(columns), -1, right.shape[-1] ** 2)

    def _scores(self, value: Array, outer: Array, variances: Array, sd: Array) -> Array:
        """(P, n) -2 ln evidence of places by their modes. variances : (P, n, K+1) of the harmonics, for the relative
        size 1."""
        a2 = variances[..., None]
        grown = np.log1p(a2 * value[:, None]).sum(axis=-1)
        # ln det of the real problem: half for the mean, which is real
        log_volume = grown[..., 0] + 2.0 * grown[..., 1:].sum(axis=-1)
        weight = (a2 / (1.0 + a2 * value[:, None])).reshape(*log_volume.shape, -1)
        taken = (weight @ outer).reshape(*log_volume.shape, *self.of_unknowns.shape)
        return marginal(self._less(taken), sd) + log_volume + self.log_volume

    def amplitudes(self, columns: Array, variance: Array, x: Array, spread: Array | None = None) -> tuple[Array, Array]:
        """(K+1, q) the most probable harmonics of sources for unknowns x, and the standard deviations of their real and
        imaginary parts. spread : (p, p) covariance of the unknowns, which adds to these; None: the unknowns are
        exact."""
        K, _ = self._kernel(columns, variance)
        right = self.between[:, columns]
        g = -(K @ (right @ np.append(x, 1.0))[..., None])[..., 0]
        of = np.einsum("kii->ki", K).real
        if spread is not None:
            moved = K @ right[..., :-1]
            both = np.einsum("kia,ab,kib->ki", moved, spread, moved.conj()).real
            # the real part of a complex harmonic has half the variance, on average
            of = of + np.where(np.arange(len(of)) == 0, 1.0, 0.5)[:, None] * both
        return g, np.sqrt(np.maximum(of, 0.0))


def marginal(normal: Array, sd: Array) -> Array:
    """-2 ln evidence : (…,) of normal equations (…, p+1, p+1) with Gaussian priors about 0, sd : (…, p)."""
    N = sd[..., None] * normal[..., :-1, :-1] * sd[..., None, :]
    right = sd * normal[..., :-1, -1]
    try:
        v, volume = forward(np.eye(sd.shape[-1]) + N, right[..., None])
    except np.linalg.LinAlgError:  # sources absorbed all but round-off of an unknown: negative information is set to 0
        if normal.ndim > 2:  # of some: each by itself
            return np.stack([marginal(each, sd) for each in normal])
        value, vector = np.linalg.eigh(0.5 * (N + N.swapaxes(-1, -2)))
        grown = 1.0 + np.maximum(value, 0.0)
        v = (vector.swapaxes(-1, -2) @ right[..., None]) / np.sqrt(grown)[..., None]
        volume = np.log(grown).sum(axis=-1)
    return np.asarray(normal[..., -1, -1] - (v**2).sum(axis=(-2, -1)) + volume)


def _gram(a: Array, b: Array) -> Array:
    """Re Σ aᴴ b over harmonics and rows."""
    a, b = (x.reshape(-1, x.shape[-1]) for x in (a, b))
    return a.real.T @ b.real + a.imag.T @ b.imag
