"""Records whose beats differ: the whole record is one long period of unlike beats, and so one long Fourier series.

Interval and stroke differ from beat to beat, each by itself. An ejection keeps its shape and its duration, and diastole
makes up the interval. The flow, the pressure and the walls answer to the whole of it by the same equations with as many
harmonics more as there are beats; nothing is averaged, and nothing is linearised.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .anatomy import Anatomy
from .beat import Beat, at_phase
from .bench import bench_wall, long_radius
from .hide import Effect
from .network import Balance
from .sensors import Clock, pulsatile, sampling_step, sensed
from .shapes import Arteries

Array = np.ndarray

SPARE = 2  # beats beside those of the record, so that it may begin within one and does not meet its own end
_BEFORE = 0.25  # of a period before its onset: there an ejection has not begun, and the last one has ended
_FURTHEST = 3.0  # standard deviations


@dataclass(frozen=True)
class Run:
    """Unlike beats. beat : their long period; onset (n,) [s] of each in it; stroke (n,) of the mean one."""

    beat: Beat
    onset: Array
    stroke: Array

    @property
    def interval(self) -> Array:
        """From each onset to the next : (n,) [s]."""
        return np.diff(self.onset, append=self.beat.T)

    def flow(self, ejection: Array) -> Array:
        """The ejections one after the other, coefficients; of one with the period of the heart."""
        time, T = self.beat.phase * self.beat.T, self.beat.heart
        flow = np.zeros(self.beat.samples)
        for onset, stroke in zip(self.onset, self.stroke, strict=True):
            phase = np.mod(time - onset + _BEFORE * T, self.beat.T) / T - _BEFORE
            own = phase < 1.0 - _BEFORE
            flow[own] += stroke * at_phase(ejection, phase[own])
        return self.beat.coefficients(flow)


def run(rng: np.random.Generator, beat: Beat, beats: int, rate: float, stroke: float) -> Run:
    """As many beats and a few more, with standard deviations of interval and stroke, of their means."""
    n = beats + SPARE
    z = np.clip(rng.standard_normal((2, n)), -_FURTHEST, _FURTHEST)
    ends = np.cumsum(beat.T * (1.0 + rate * z[0]))
    long = Beat(float(ends[-1]), n * beat.K, n * beat.samples, beat.T)
    return Run(long, np.concatenate([[0.0], ends[:-1]]), 1.0 + stroke * z[1])


def clock(rng: np.random.Generator, whole: Run, beats: int) -> Clock:
    """Sampling times of ``beats`` beats from any phase of the first on; phases are those of the long period."""
    dt = sampling_step(rng)
    begin, end = np.interp(rng.uniform() + np.array([0.0, beats]), np.arange(len(whole.onset)), whole.onset)
    time = dt * np.arange(int((end - begin) / dt) + 3)
    return Clock(time, (begin + time) / whole.beat.T)


def network_channels(model: Anatomy, whole: Run, ejection: Array, n: int) -> dict[str, Array]:
    """Every channel of a network under a varying inflow, coefficients of the long period; n points a piece."""
    return Balance(model, whole.beat, n).solve(whole.flow(ejection)).channels


def bench_channels(model: Anatomy, whole: Run, ejection: Array, arteries: Arteries, site: str) -> dict[str, Array]:
    """P and R of a site under a varying pressure, coefficients of the long period."""
    P = arteries.pressure(whole.flow(ejection), whole.beat.omega)
    R = long_radius(bench_wall(model, site, whole.beat), whole.beat.values(P))
    return {f"{site}.P": P, f"{site}.R": R}


def faulty(channels: dict[str, Array], effects: tuple[Effect, ...], whole: Run, clean: dict[str, Array]) -> None:
    """Put the faults of sensors into channels; an offset is in units of the steady pulse, ``clean``."""
    for effect in effects:
        for name in effect.where if effect.on_channel else ():
            x = channels[name]
            if effect.name == "channel_offset":
                x[0] += effect.size * pulsatile(clean[name])
            else:
                channels[name] = sensed(x, effect, whole.beat)
