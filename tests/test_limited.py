"""Sensors whose range cuts waves before the noise: the notes about them, and none where nothing is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fitting.records.alignment.align import align
from fitting.records.alignment.sensor_faults import limited_sensors
from fitting.records.read.record import Record
from solver import load, simulate_periodic
from solver.network.description import Site
from solver.quantities.units import MMHG

Array = np.ndarray

BEATS, NOISE = 30, 0.01  # of the pulse


@pytest.fixture(scope="module")
def waves() -> dict[str, Array]:
    """One beat of P and Q in the middle of each artery of the human."""
    human = load("human")
    everywhere = tuple(Site(s.name, s.name, 0.5) for s in human.segments)
    found = simulate_periodic(replace(human, sites=everywhere))
    return {f"{s.name}.{kind}": np.asarray(found[f"{s.name}.{kind}"]) for s in human.segments for kind in "PQ"}


def notes(rng: np.random.Generator, name: str, wave: Array, noise: float = NOISE) -> list[str]:
    """The notes about a wave : (N,) in beats with noise, a fraction of its pulse."""
    values = wave + noise * np.ptp(wave) * rng.standard_normal((BEATS, len(wave)))
    return list(limited_sensors({name: values.ravel()}, {name: values}, {}, 0.9))


@pytest.mark.parametrize("noise", [0.0, 0.003, NOISE, 0.03])
def test_no_note_about_the_waves_of_arteries(waves: dict[str, Array], noise: float) -> None:
    """None of 32 pressures and flows has a top as flat as one that is cut, whatever the noise."""
    rng = np.random.default_rng(1)
    assert not [text for name, wave in waves.items() for text in notes(rng, name, wave, noise)]


def test_a_top_that_is_cut_before_the_noise(waves: dict[str, Array]) -> None:
    """With 15 % of the pulse cut off, 15 of 16 pressures have a note that tells the level."""
    rng, found = np.random.default_rng(2), 0
    for name, wave in waves.items():
        if name.endswith(".P"):
            level = wave.max() - 0.15 * np.ptp(wave)
            texts = notes(rng, name, np.minimum(wave, level))
            found += bool(texts)
            assert all(
                float(text.split(" mmHg")[0].split()[-1]) == pytest.approx(level / MMHG, rel=0.01) for text in texts
            )
    assert found >= 15


def test_a_converter_makes_no_flat_top(waves: dict[str, Array]) -> None:
    """Steps of 2 % of the pulse, which are wider than the noise, round every top."""
    rng, step = np.random.default_rng(4), 0.02
    for name, wave in waves.items():
        size = step * np.ptp(wave)
        values = np.round((wave + 0.003 * np.ptp(wave) * rng.standard_normal((BEATS, len(wave)))) / size) * size
        assert not list(limited_sensors({name: values.ravel()}, {name: values}, {name: size}, 0.9)), name


@pytest.mark.parametrize("turned", [np.abs, lambda x: np.maximum(x, 0.0)], ids=["reversed", "cut off"])
def test_a_flow_without_negative_values(turned: np.ufunc) -> None:
    """Noise about a rest at zero has both signs; with one alone, a note, from the recording on."""
    rng, dt, T = np.random.default_rng(3), 5e-3, 0.8
    t = np.arange(round(40 * T / dt)) * dt
    flow = 3e-4 * np.maximum(np.sin(np.pi * np.mod(t, T) / 0.3), 0.0) * (np.mod(t, T) < 0.3)
    pressure = (80.0 + 30.0 * np.sin(2.0 * np.pi * t / T)) * MMHG + 30.0 * rng.standard_normal(len(t))
    noisy = flow + 6e-6 * rng.standard_normal(len(t))
    for values, expected in ((noisy, 0), (turned(noisy), 1), (turned(noisy) + 3e-5, 0)):
        said = align(Record("made", "", t, {"inlet.Q": values, "Ao.P": pressure}, {})).warnings
        assert sum("is never negative" in text for text in said) == expected


def test_a_flow_that_rests_at_zero_without_noise() -> None:
    """Strokes that vary by 5 % are no noise about the rest."""
    t, strokes = np.arange(200) / 200, 1.0 + 0.05 * np.random.default_rng(5).standard_normal((60, 1))
    for wave in (1.0 + np.cos(2.0 * np.pi * t), np.sin(np.pi * t) ** 2, np.exp(-8.0 * t)):
        values = wave * strokes
        assert not list(limited_sensors({"inlet.Q": values.ravel()}, {"inlet.Q": values}, {}, 0.8))
