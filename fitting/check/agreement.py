"""Agreement of a simulated beat with a measured one, channel by channel and loop by loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.quantities.units import SIGNAL_UNITS

from ..records.alignment.beats import Array, Beats
from ..records.channels.spectral import coefficients
from ..wall.indices import loop_area

_NOISELESS = 1e-8  # of the pulse: less noise than this is round-off


@dataclass(frozen=True)
class Agreement:
    """The agreement of one channel: simulated minus measured, in SI.

    relative : L2 norm of the difference over that of the measured beat, without its mean for P and R.
    largest : largest difference over the measured pulse. mean_error, pulse_error : of the mean and of max - min.
    whitened : RMS over harmonics of residual/noise (1 = noise); whitened_sensor : by the sensor's own noise alone;
    mean_z : the same for the mean, with sign. worst_harmonic, worst_z : where it is largest. None without noise.
    """

    name: str
    unit: str
    rmse: float
    relative: float
    largest: float
    mean_error: float
    pulse: float
    pulse_error: float
    whitened: float | None = None
    whitened_sensor: float | None = None
    mean_z: float | None = None
    worst_harmonic: int | None = None
    worst_z: float | None = None


@dataclass(frozen=True)
class LoopArea:
    """∮ P dA of a site [J/m] (:func:`~fitting.wall.indices.loop_area`), of the measured beat and of the FMU's."""

    site: str
    measured: float
    simulated: float


@dataclass(frozen=True)
class Waveform:
    """A mean beat, the FMU's beat, and the standard deviation between beats: (N,) each, in SI."""

    measured: Array
    simulated: Array
    scatter: Array


def is_noisy(S: Array, beats: Beats, name: str) -> bool:
    """Whether the covariance of a channel is more than round-off."""
    least = (_NOISELESS * float(np.ptp(beats.mean(name)))) ** 2 / beats.N
    return bool(S[:, 0, 0].real.min() > least)


def compare_channel(name: str, waveform: Waveform, S: Array, H: Array | None) -> Agreement:
    """Measured against simulated beat; S : (K + 1, 2, 2) covariance of channel and drive, H : (K + 1,) the FMU's answer
    to each harmonic of the drive, None if there is no noise."""
    kind = name[-1]
    measured, simulated = waveform.measured, waveform.simulated
    difference = simulated - measured
    size = np.linalg.norm(measured if kind == "Q" else measured - measured.mean())
    pulse = float(np.ptp(measured))
    return Agreement(
        name=name,
        unit=SIGNAL_UNITS[kind],
        rmse=float(np.sqrt(np.mean(difference**2))),
        relative=float(np.linalg.norm(difference) / size),
        largest=float(np.abs(difference).max() / pulse),
        mean_error=float(difference.mean()),
        pulse=pulse,
        pulse_error=float(np.ptp(simulated) - pulse),
        **_whitened(coefficients(difference)[: len(S)], S, H),
    )


def _whitened(x: Array, S: Array, H: Array | None) -> dict[str, Any]:
    """Residual x : (K + 1,) divided by its noise from channel and drive."""
    if H is None:
        return {}
    own = S[:, 0, 0].real
    # the measured drive is off by q, and with it the simulated channel by H q
    noise = own + np.abs(H) ** 2 * S[:, 1, 1].real - 2.0 * (np.conj(H) * S[:, 0, 1]).real
    if min(own.min(), noise.min()) <= 0.0:
        return {}
    z = np.abs(x) / np.sqrt(noise)
    worst = int(z[1:].argmax()) + 1
    sensor = np.abs(x[1:]) ** 2 / own[1:]
    return {
        "whitened": float(np.sqrt(np.mean(z[1:] ** 2))),
        "whitened_sensor": float(np.sqrt(sensor.mean())),
        "mean_z": float(x[0].real / np.sqrt(noise[0])),
        "worst_harmonic": worst,
        "worst_z": float(z[worst]),
    }


def compare_loops(waveforms: Mapping[str, Waveform]) -> tuple[LoopArea, ...]:
    """The loop of every site that has pressure and radius."""
    sites = [name.removesuffix(".R") for name in waveforms if name.endswith(".R")]
    pairs = {site: (waveforms[f"{site}.P"], waveforms[f"{site}.R"]) for site in sites if f"{site}.P" in waveforms}
    return tuple(
        LoopArea(site, _loss(P.measured, R.measured), _loss(P.simulated, R.simulated)) for site, (P, R) in pairs.items()
    )


def _loss(P: Array, R: Array) -> float:
    """∮ P dA [J/m] of a beat of pressure [Pa] and radius [m]."""
    return float(loop_area(P, np.pi * R * R))
