"""What lies beyond half the sampling rate is never found in a record."""

from __future__ import annotations

import math

import numpy as np
import pytest
from forked import NETWORK, T, record
from small_network import NAMES

from discrepancy.name.model_selection import name
from fitting.inference.hypothesis import candidates
from fitting.inference.models.network_record import network_problem
from solver import Settings, simulate_periodic
from solver.laws import sensors

SAMPLES = 80  # of a beat of 0.4 s: 200 Hz


def kinked(t: np.ndarray) -> np.ndarray:
    """An ejection of half a sine, with a kink at its start and its end."""
    phase = np.mod(np.asarray(t) / T, 1.0)
    return np.where(phase < 0.4, 30e-6 * np.sin(math.pi * phase / 0.4), 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.003])
def test_a_kink_that_is_sampled_is_no_resonance(noise: float) -> None:
    """Nothing hidden, 200 Hz. The verdict was a catheter resonance at inlet.Q with 118 and 112 Hz, ζ 0.003 and 0.001,
    with 0.99; √3/π of the sampling rate is 110 Hz."""
    beat = simulate_periodic(NETWORK, kinked, T, settings=Settings(dt=T / 800), tolerance=1e-6)
    waves = {n: beat[n][:-1][::10] for n in NAMES} | {"inlet.Q": kinked(np.arange(SAMPLES) * T / SAMPLES)}
    problem = network_problem(record(waves, 15, noise), NETWORK)
    effects = ("channel_gain", "channel_lag", "catheter_resonance", "terminal_reflection")
    found = name(problem, [t for t in candidates(NETWORK, (*NAMES, "inlet.Q")) if t.effect in effects], walls="common")
    assert found.verdict == "none" and found.confidence > 0.9


def test_how_a_sampled_kink_looks() -> None:
    """Coefficients C/k² sampled N times a beat are (πk/N)²/sin²(πk/N) times theirs: 1/(1 - (f/f_n)²) with f_n = √3/π of
    the sampling rate is that to 2.1 % up to half of Nyquist, and to 15 % up to three quarters."""
    k, N = np.arange(1, 30), SAMPLES
    aliased = (np.pi * k / N) ** 2 / np.sin(np.pi * k / N) ** 2
    rings = 1.0 / (1.0 - (k * math.pi / (N * math.sqrt(3.0))) ** 2)
    np.testing.assert_allclose(rings[k <= N / 4], aliased[k <= N / 4], rtol=0.021)
    np.testing.assert_allclose(rings, aliased, rtol=0.15)


@pytest.mark.parametrize(
    ("f_n", "zeta", "frequency"),
    [(15.0, 0.1, 15.0), (40.0, 1.0, 40.0), (50.0, 1.5, 50.0 * (1.5 - math.sqrt(1.25)))],
)
def test_the_frequency_that_a_sensor_is_named_by(f_n: float, zeta: float, frequency: float) -> None:
    """That of the resonance, or of the slower pole f_n (ζ - √(ζ² - 1)) of an overdamped sensor: to 1e-9."""
    sensor = sensors.CatheterResonance()
    values = {key: float(x) for key, x in sensor.as_coordinates({"f_n": np.array(f_n), "zeta": np.array(zeta)}).items()}
    assert sensor.frequency(values) == pytest.approx(frequency, rel=1e-7)


def test_frequencies_that_are_none() -> None:
    """A perfect sensor rings at none that is finite; lags, gains and offsets are named by none."""
    assert sensors.CatheterResonance().frequency({"slow": 0.0, "resonance": 0.0}) == math.inf
    assert sensors.ChannelLag().frequency({"lag": 1e-6}) == 0.0
