"""What sensors make of the truth: faults of one channel, then noise, drift, digits, and beats that are not alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .beat import Beat
from .hide import Effect

Array = np.ndarray

_JITTER = 1e-3  # [s], standard deviation of the periods
_BITS = 12


def pulsatile(c: Array) -> float:
    """Standard deviation of a channel about its mean, of its coefficients (K + 1,)."""
    return float(np.sqrt(2.0 * np.sum(np.abs(c[1:]) ** 2)))


def sensed(c: Array, effect: Effect, beat: Beat) -> Array:
    """A channel's coefficients after a faulty sensor: lag, gain, offset, second order, bent or rectified flow."""
    iw = 1j * beat.omega
    match effect.name:
        case "channel_lag":
            return c * np.exp(-iw * effect.size)
        case "channel_gain":
            return c * (1.0 + effect.size)
        case "channel_offset":
            result = c.copy()
            result[0] += effect.size * pulsatile(c)
            return result
        case "catheter_resonance":
            return c / second_order(beat, effect)
        case "inflow_bent":
            x = beat.values(c)
            return beat.coefficients(x * (1.0 + effect.size * x / x.max()))
        case "inflow_rectified":
            x = beat.values(c)
            return beat.coefficients(x - effect.size * np.minimum(x, 0.0))
    raise KeyError(effect.name)


def second_order(beat: Beat, effect: Effect) -> Array:
    """1 + 2iζ ω/ω_n - (ω/ω_n)² per harmonic: what divides a channel seen through a catheter."""
    ratio = beat.omega * effect.size / (2.0 * np.pi)
    return 1.0 + 2j * effect.second * ratio - ratio**2


@dataclass(frozen=True)
class Clock:
    """Sampling times [s] and the phase t/T + beats at each; the beats' periods differ by about 1 ms."""

    time: Array
    phase: Array


def clock(rng: np.random.Generator, T: float, beats: int) -> Clock:
    """``beats`` beats from any phase on, sampled at 200-250 Hz; all channels share the jitter.

    On average their period is T: a wave that was solved at T and is shown over longer beats is of slower walls.
    """
    dt = sampling_step(rng)
    starts = np.concatenate([[0.0], np.cumsum(T + _JITTER * rng.standard_normal(beats + 2))])
    first = rng.uniform(0.0, 1.0)
    begin, end = np.interp([first, first + beats], np.arange(len(starts)), starts)
    starts, begin, end = (beats * T / (end - begin) * at for at in (starts, begin, end))
    time = dt * np.arange(int((end - begin) / dt) + 3)
    return Clock(time, np.interp(begin + time, starts, np.arange(len(starts))))


def sampling_step(rng: np.random.Generator) -> float:
    """[s], of 200-250 Hz."""
    return round(1.0 / rng.uniform(200.0, 250.0), 6)


def measured(rng: np.random.Generator, clean: Array, at: Clock, noise: float, T: float) -> Array:
    """A channel at its samples as measured: white noise of the given standard deviation, a drift below it, and 12 bits
    over the range."""
    low, high = clean.min(), clean.max()
    x = clean + noise * rng.standard_normal(len(clean)) + noise * _drift(rng, at.time, T)
    step = 1.5 * (high - low) / 2**_BITS
    return np.round(x / step) * step


def _drift(rng: np.random.Generator, time: Array, T: float) -> Array:
    """A slow wander of root mean square at most one: a sinusoid of several beats, or a random walk."""
    if rng.random() < 0.5:
        x = np.sqrt(2.0) * np.sin(2.0 * np.pi * (time / (T * rng.uniform(5.5, 14.5)) + rng.random()))
    else:
        x = np.cumsum(rng.standard_normal(len(time)))
        x = x - x.mean()
        x = x / x.std()
    return rng.uniform(0.0, 1.0) * x
