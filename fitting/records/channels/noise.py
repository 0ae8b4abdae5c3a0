"""What a network record says, ready to compare with a simulation: whitened Fourier coefficients of its mean beat.

X_k = rfft(mean beat)/N of every channel, k = 0 … K. The residual of a simulation driven by the measured inflow is

    X_k - X_k^sim(Q) = n_k - H_k q_k + e_k

with the channels' own noise n, the noise q of the inflow, which every channel feels through the network's response H,
and the solver's error e. Its covariance, channels jointly, is S_n + H S_q H^† + diag(e²), with S_n and S_q from the
scatter between beats. A real change of inflow from beat to beat, which all channels follow, is taken out first: it
costs nothing. What sampling hides beyond half its rate is part of S_n and S_q.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver import linear
from solver.errors import InputError
from solver.network.description import Network
from solver.quantities.units import INFLOW

from .. import limits
from ..alignment.beats import Array, Beats
from .spectral import coefficients, scaled
from .variability import BeatVariation

_ROUND_OFF = 1e-6  # of a channel's pulse: what the solver leaves at best (beats repeat to 1e-6)
_POOLED = 2.0 * limits.NEIGHBOURS + 1.0


@dataclass(frozen=True)
class Target:
    """The measured coefficients and their covariance.

    names : the m channels. X : (K+1, m) complex. covariance : (K+1, m, m) complex Hermitian, E[x x^†] of an error x.
    whitener : (K+1, m, m) that makes it unity.
    """

    names: tuple[str, ...]
    X: Array
    covariance: Array
    whitener: Array

    @classmethod
    def of(cls, names: Sequence[str], X: Array, covariance: Array) -> Target:
        """With the whitener of a covariance, by Cholesky."""
        # pascals and cubic metres per second: scaled before the factorisation
        scale = np.sqrt(np.einsum("kii->ki", covariance).real)
        factor = np.linalg.cholesky(covariance / (scale[:, :, None] * scale[:, None, :]))
        return cls(tuple(names), X, covariance, np.linalg.inv(factor) / scale[:, None, :])

    @property
    def log_volume(self) -> float:
        """ln det of the covariance of :meth:`whiten`'s data before they were whitened, up to a constant."""
        each = -2.0 * np.linalg.slogdet(self.whitener)[1]
        return float(each[0] + 2.0 * each[1:].sum())

    def residual(self, X: Array) -> Array:
        """Whitened residual of simulated coefficients X : (B, K+1, m) -> (B, m (2K+1)), each N(0, 1) if all is well."""
        return self.whiten(np.moveaxis(X - self.X, 0, -1)).T

    def whiten(self, D: Array) -> Array:
        """(m (2K+1), q) real and of unit variance, of differences D : (K+1, m, q) of coefficients."""
        white = self.whitener @ D
        # a complex coefficient of unit variance has 1/2 in its real and 1/2 in its imaginary part
        parts = [white[:1].real, np.sqrt(2.0) * white[1:].real, np.sqrt(2.0) * white[1:].imag]
        return np.concatenate([part.reshape(-1, D.shape[-1]) for part in parts])

    def unwhiten(self, z: Array) -> Array:
        """The D : (K+1, m, q) of :meth:`whiten`."""
        m, K = len(self.names), len(self.X) - 1
        rest = z[m:].reshape(2, K, m, -1) / np.sqrt(2.0)
        white = np.concatenate([z[None, :m] + 0j, rest[0] + 1j * rest[1]])
        return np.linalg.solve(self.whitener, white)

    def channel_rms(self, z: Array) -> dict[str, float]:
        """RMS of each channel's residual over its own standard deviation (1 = noise); z : (n,) whitened."""
        D = self.unwhiten(z[:, None])[..., 0]
        ratio = np.abs(D) ** 2 / np.einsum("kii->ki", self.covariance).real
        weight = np.where(np.arange(len(D)) == 0, 1.0, 2.0)[:, None]
        rms = np.sqrt((weight * ratio).sum(axis=0) / weight.sum())
        return dict(zip(self.names, rms.tolist(), strict=True))


def degrees_of_freedom(n_beats: int, *, real: bool = False, at_ends: bool = False) -> float:
    """From how many numbers the noise of one harmonic is known: the harmonics taken together, in every beat but one.

    real : count the real and the imaginary part, which one channel's variance may; a covariance of channels is one of
    complex numbers. at_ends : where the spectrum begins and ends, there are neighbours on one side only.
    """
    pooled = limits.NEIGHBOURS + 1.0 if at_ends else _POOLED
    return (2.0 if real else 1.0) * pooled * (n_beats - 1.0)


def target(
    beats: Beats, names: Sequence[str], response: Array, solver_error: Array, variation: BeatVariation | None = None
) -> Target:
    """The target for channels ``names``.

    response : (n, m) H_k for k = 0 … n - 1 > K, those beyond K for the covariance's neighbours; solver_error : (K+1, m)
    standard deviation of e_k. variation : response to an inflow whose beats differ; its seam is taken out of the mean
    beat, and its uncertainty enters the covariance.
    """
    K = len(solver_error) - 1
    share, steady = steady_beats(beats, names, response, variation)
    H = response[: K + 1]
    identity = np.broadcast_to(np.eye(len(names)), (K + 1, len(names), len(names)))
    gain = np.concatenate([identity, -(share[: K + 1, None] * H)[..., None]], axis=2)
    covariance = gain @ _scatter(steady, (*names, INFLOW))[: K + 1] @ np.conj(np.swapaxes(gain, 1, 2))
    # what sampling hides of the inflow is common to all channels, as its noise is
    hidden = _hidden(beats, (*names, INFLOW))[: K + 1]
    common = hidden[:, -1:] * H
    covariance = covariance + common[:, :, None] * common[:, None, :].conj()
    at = np.arange(len(names))
    covariance[:, at, at] += hidden[:, :-1] ** 2 + solver_error**2
    if variation is not None:
        _, error, doubt = variation.coefficients(K + 1)
        covariance[:, at, at] += np.abs(error) ** 2
        covariance = covariance + doubt[:, :, None] * doubt[:, None, :].conj()
    covariance[0] = covariance[0].real
    return Target.of(names, mean_beat(beats, names, K, variation), covariance)


def steady_beats(
    beats: Beats, names: Sequence[str], response: Array, variation: BeatVariation | None, drive: str = INFLOW,
    share: Array | None = None,
) -> tuple[Array, Beats]:  # fmt: skip
    """The share (n,) of the drive's change from beat to beat that is noise, and beats of drive and channels without the
    change of channels that is not. share : if it is known from other beats.

    What is left of the channels when the real part of the drive's change is taken out has nothing in common with the
    drive as measured: a covariance that can be pooled and shrunk.
    """
    moved = following(beats, response, variation, drive)
    share = noise_share(beats, names, moved, len(response)) if share is None else share
    values = {name: beats.values[name] - scaled(change, 1.0 - share) for name, change in zip(names, moved, strict=True)}
    return share, replace(beats, values={drive: beats.values[drive], **values})


def inflow_noise(
    beats: Beats, names: Sequence[str], response: Array, weights: Array, variation: BeatVariation | None = None
) -> Array:
    """Variance S (n,) of the mean inflow's coefficients by the noise of its meter alone; response : H (n, m).

    weights : C⁻¹ (n, m, m), the inverse covariance of the channels. C contains S H H†, so that S is at most 1/(H† C⁻¹
    H). Without this bound S may be too large: channels of beats that differ follow their flow to a few per cent only,
    and the remainder looks like noise of the meter.
    """
    share = noise_share(beats, names, following(beats, response, variation), len(response))
    most = np.einsum("ki,kij,kj->k", response.conj(), weights, response).real
    return np.minimum(share * beats.covariance((INFLOW,))[: len(response), 0, 0].real, 1.0 / np.maximum(most, 1e-300))


def following(beats: Beats, response: Array, variation: BeatVariation | None, drive: str = INFLOW) -> Array:
    """(m, n_beats, N) the variation from beat to beat of channels with that response (n, m) if they followed the
    measured drive."""
    if variation is not None:
        return variation.change
    change = np.nan_to_num(beats.values[drive] - beats.mean(drive), nan=0.0)
    return np.stack([scaled(change, H) for H in response.T])


def seam_note(beats: Beats, names: Sequence[str], variation: BeatVariation | None) -> tuple[str, ...]:
    """A sentence on the channel whose mean beat is known worst beside its noise, where beats differ; none where that is
    less than a few times the noise."""
    if variation is None:
        return ()
    _, *unknown = variation.coefficients(beats.N)
    weight = np.where(np.arange(len(unknown[0])) == 0, 1.0, 2.0)
    error = np.sqrt(weight @ sum(np.abs(x) ** 2 for x in unknown))
    noise = np.sqrt(np.einsum("kii->ik", beats.covariance(names)).real @ weight)
    i = int(np.argmax(error / noise))
    if error[i] < limits.SURE * noise[i]:
        return ()
    part, times = error[i] / pulses(beats, names)[i], error[i] / noise[i]
    return (
        f"the beats differ, and the mean beat of {names[i]} is known to {part:.2g} of its pulse only, {times:.2g} "
        f"times its noise: a smaller effect does not show; a stretch with a steadier heart shows more.",
    )


def mean_beat(beats: Beats, names: Sequence[str], K: int, variation: BeatVariation | None = None) -> Array:
    """X_k of the mean beat, (K+1, m); without the seam of their ``variation``: as if all beats were alike."""
    X = np.stack([coefficients(beats.mean(name))[: K + 1] for name in names], axis=1)
    return X if variation is None else X - variation.coefficients(K + 1)[0]


def under_drive_of(
    fitted: Beats, X: Array, beats: Beats, names: Sequence[str], response: Array, variation: BeatVariation | None
) -> Array:
    """The coefficients X : (K+1, m) of the mean of some beats, moved to the mean inflow of the fitted beats:

        X_k + (1 - share_k) H_k (Q_k of the fitted - Q_k of these),     k >= 1

    H : (n, m) the linear response, variation : as in :func:`target`, both of the fitted beats; share : the part of the
    inflow's change that is noise of its meter. Means (k = 0) stay as they are, because arteries fill over many beats.
    """
    share, n = noise_share(fitted, names, following(fitted, response, variation), len(response)), len(X)
    more = (coefficients(fitted.mean(INFLOW)) - coefficients(beats.mean(INFLOW)))[:n]
    more[0] = 0.0
    return np.asarray(X + ((1.0 - share[:n]) * more)[:, None] * response[:n])


def pulses(beats: Beats, names: Sequence[str]) -> Array:
    """Standard deviation over the mean beat of each channel, (m,); of the whole value where it does not pulsate."""
    means = np.array([beats.mean(name) for name in names])
    pulse = means.std(axis=1)
    return np.where(pulse > 0.0, pulse, np.sqrt((means**2).mean(axis=1)) + np.finfo(float).tiny)


def harmonics_above_noise(beats: Beats, names: Sequence[str], most: int) -> int:
    """The highest harmonic, at most ``most``, at which a channel is above its noise."""
    X = mean_beat(beats, names, most)
    variance = np.einsum("kii->ki", beats.covariance(names)).real + _hidden(beats, names) ** 2
    above = np.flatnonzero((np.abs(X) ** 2 > limits.SURE**2 * variance[: most + 1]).any(axis=1))
    return max(1, int(above[-1]) if len(above) else 1)


def check_flow_driven(network: Network) -> None:
    """Raise ValueError unless the flow is given at one inlet: records drive a network by their inlet.Q."""
    if network.further_inlets:
        names = ", ".join(inlet.drive for inlet in network.further_inlets)
        raise InputError(
            f"network {network.name}: it has further inlets ({names}), but records are compared with {INFLOW} alone "
            "given; take a network without [inlets]."
        )
    if network.inlet.causality != "flow":
        raise InputError(
            f"network {network.name}: its inlet is driven by a pressure, but records are compared with {INFLOW} given; "
            'write causality = "flow" in [inlet].'
        )


def response(network: Network, names: Sequence[str], T: float, K: int, parameters: Mapping[str, float]) -> Array:
    """H_k : (K+1, m), the linearised network's channels per unit of inflow at harmonic k.

    Raises ValueError as :func:`solver.linear.solve`.
    """
    unit = np.array([np.zeros(K + 1), np.ones(K + 1)])  # the first is rest, which the means are counted from
    waves = linear.amplitudes(network, unit, 2.0 * np.pi / T * np.arange(K + 1), dict(parameters))
    return np.stack([waves[name][1] - waves[name][0] for name in names], axis=1)


def solver_error(X: Array, X_finer: Array, pulse: Array) -> Array:
    """Standard deviation (K+1, m) of the solver's own error, from the change with elements and steps of half the
    length.

    Neighbouring harmonics are taken together.
    X, X_finer : (K+1, m). The scheme is of second order or better, so the change is 3/4 of the error or more.
    """
    change = np.abs(X - X_finer) * (4.0 / 3.0)
    padded = np.pad(change, ((1, 1), (0, 0)), mode="edge")
    return np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:]) + _ROUND_OFF * pulse


def noise_share(beats: Beats, names: Sequence[str], following: Array, n: int) -> Array:
    """The part (n,) of the drive's variance from beat to beat that no channel follows: noise of its meter.

    By regression of the channels on their expected variation, each weighted by its own variance: 0 if the drive is
    measured exactly, 1 if it is the same in every beat and all change is noise.
    """
    m = len(names)
    moved = dict(zip((f"{name} follows" for name in names), following, strict=True))
    both = replace(beats, values={**{name: beats.values[name] for name in names}, **moved})
    S = both.covariance((*names, *moved))
    variance = np.einsum("kii->ki", S).real
    at = np.arange(m)
    weight = np.divide(1.0, variance[:, :m], out=np.zeros_like(variance[:, :m]), where=variance[:, :m] > 0.0)
    followed = (weight * S[:, at, m + at].real).sum(axis=1)
    could = (weight * variance[:, m:]).sum(axis=1)
    share = 1.0 - np.divide(followed, could, out=np.zeros_like(could), where=could > 0.0)
    return np.pad(np.clip(share, 0.0, 1.0), (0, max(0, n - len(share))), mode="edge")[:n]


def _scatter(beats: Beats, names: Sequence[str]) -> Array:
    """Covariance (N//2+1, m, m) of the coefficients of mean beats, from the scatter between beats.

    Widened so that the inverse of a variance from few beats is right on average: E[1/s²] = ν/(ν - 2)/σ² for ν real
    samples (the mean), ν/(ν - 1)/σ² for ν complex ones.
    """
    S, dof = beats.covariance(names), beats.n_beats - 1.0
    # means that drift are fewer than they look, and two drifts look correlated
    dof_mean = max(1.0, dof / float(np.mean(beats.serial_factors(names))))
    mean, rest = _shrunk(S[:1], dof_mean), _shrunk(S[1:], _POOLED * dof)
    wider = dof_mean / max(dof_mean - 2.0, dof_mean / 3.0)
    return np.concatenate([mean * wider, rest * _POOLED * dof / (_POOLED * dof - 1.0)])


def _hidden(beats: Beats, names: Sequence[str]) -> Array:
    """Size (N//2+1, m) of the errors of sampling in the coefficients of mean beats."""
    variance = np.einsum("kii->ki", beats.covariance(names)).real
    return np.stack([_aliased(beats.mean(name), v) for name, v in zip(names, variance.T, strict=True)], axis=1)


def _shrunk(S: Array, dof: float) -> Array:
    """Covariances (n, m, m) with their cross terms shrunk as far as they look like chance (Schäfer and Strimmer 2005).

    Estimated from ``dof`` samples, independent channels have E|correlation|² = 1/dof. Without this, the inverse of a
    matrix from few beats would see directions without noise that are not there.
    """
    sd = np.sqrt(np.einsum("kii->ki", S).real)
    scale = sd[:, :, None] * sd[:, None, :]
    correlation = np.divide(S, scale, out=np.zeros_like(S), where=scale > 0.0)
    off = ~np.eye(S.shape[-1], dtype=bool)
    found = float((np.abs(correlation[:, off]) ** 2).sum())
    chance = len(S) * off.sum() / max(dof, 1.0)
    keep = 1.0 - min(1.0, chance / found) if found > 0.0 else 0.0
    return np.where(off, keep, 1.0) * S


def _aliased(mean: Array, variance: Array) -> Array:
    """Size (N//2+1,) of the aliases of frequencies beyond half the sampling rate in each coefficient of a mean beat.

    A kink (the start of an ejection) gives a tail C/k². Sampled, coefficient k holds Σ_m C/(k + mN)², which is
    C (π/N)²/sin²(πk/N), of which C/k² is its own; C is read from the last quarter of the spectrum, over its noise.
    """
    N = len(mean)
    k = np.arange(N // 2 + 1)
    whole, own = (np.pi / N) ** 2 / np.sin(np.pi * np.maximum(k, 1) / N) ** 2, 1.0 / np.maximum(k, 1) ** 2.0
    folded = np.where(k == 0, np.pi**2 / 3.0 / N**2, whole - own)
    tail = k >= max(1, int(limits.TAIL * (N / 2.0)))
    power = np.abs(coefficients(mean)) ** 2 - variance
    C2 = float(np.mean(power[tail] / whole[tail] ** 2))
    return np.sqrt(max(C2, 0.0)) * folded
