"""A small synthetic network record: three vessels, fast to simulate."""

from __future__ import annotations

from functools import cache

import numpy as np

from fitting.records.alignment.beats import Beats
from solver import Inlet, Junction, Network, Reflection, Segment, Settings, Site, beat_harmonics, simulate_periodic

Array = np.ndarray

T = 0.4  # s
N = 50  # samples a beat
SETTINGS = Settings(dt=T / N)
SITES = ("A", "B", "C")
CHANNELS = tuple(f"{site}.{kind}" for site in SITES for kind in "PQR")

NETWORK = Network(
    "fork",
    segments=(
        Segment("A", 0.05, 9e-3, 0.9e-3, 8e5, 12e3),
        Segment("B", 0.05, 6e-3, 0.8e-3, 9e5, 13e3),
        Segment("C", 0.04, 5e-3, 0.7e-3, 12e5, 15e3),
    ),
    inlet=Inlet("A", 30e-6, T),
    junctions=(Junction(("A",), ("B", "C")),),
    outlets=(Reflection("B", R_t=0.4), Reflection("C", R_t=0.2)),
    sites=tuple(Site(name, name) for name in SITES),
)


def inflow(t: Array) -> Array:
    """A smooth inflow of five harmonics [m³/s]."""
    harmonics = ((9.0, 1.0), (5.0, 2.0), (2.0, 2.5), (0.7, 3.0), (0.2, 3.5))
    phase = 2.0 * np.pi * np.asarray(t) / T
    return 1e-6 * (8.0 + sum(a * np.cos(k * phase - b) for k, (a, b) in enumerate(harmonics, start=1)))


@cache
def clean(amplitude: float = 1.0) -> dict[str, Array]:
    """One beat of the inflow and of every channel, N samples."""
    beat = simulate_periodic(NETWORK, lambda t: amplitude * inflow(t), T, settings=SETTINGS, tolerance=1e-7)
    return {name: beat[name][:-1] for name in ("inlet.Q", *CHANNELS)}


@cache
def exact(amplitude: float = 1.0, network: Network = NETWORK) -> dict[str, Array]:
    """The same by harmonic balance, without an error of steps."""
    X = beat_harmonics(network, CHANNELS, N // 2 - 1, lambda t: amplitude * inflow(t), T, tolerance=1e-10, more=N)[0]
    waves = dict(zip(CHANNELS, np.fft.irfft(X, N, axis=0, norm="forward").T, strict=True))
    return {"inlet.Q": amplitude * inflow(np.arange(N) * (T / N)), **waves}


def record(waves: dict[str, Array], beats: int = 5, noise: float = 0.0, seed: int = 0, period: float = T) -> Beats:
    """Equal beats with white noise of ``noise`` times each channel's pulse (standard deviation)."""
    rng = np.random.default_rng(seed)
    tiled = {name: np.tile(wave, (beats, 1)) for name, wave in waves.items()}
    values = {name: wave + noise * wave.std() * rng.normal(size=wave.shape) for name, wave in tiled.items()}
    return Beats("synthetic.csv", "0" * 64, period, values, np.zeros(beats))
