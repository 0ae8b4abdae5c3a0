"""Sensors whose range cuts waves before the noise: the notes about them, and none where nothing is cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fitting.records.alignment.limited import limited_sensors
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
    return list(limited_sensors({name: values}, 0.9))


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


@pytest.mark.parametrize("turned", [np.abs, lambda x: np.maximum(x, 0.0)], ids=["turned over", "cut off"])
def test_a_flow_without_negative_values(waves: dict[str, Array], turned: np.ufunc) -> None:
    """Noise about a rest near zero has both signs; with one alone, a note. A flow that never falls so low has none."""
    rng = np.random.default_rng(3)
    at_rest, flowing = (
        waves[name] + 2.0 * NOISE * np.ptp(waves[name]) * rng.standard_normal((BEATS, len(waves[name])))
        for name in ("AsA.Q", "RR.Q")
    )
    assert not list(limited_sensors({"inlet.Q": at_rest, "RR.Q": flowing}, 0.9))
    (text,) = limited_sensors({"inlet.Q": turned(at_rest), "RR.Q": turned(flowing)}, 0.9)
    assert text.startswith("inlet.Q rests within its noise of zero and is never negative")
