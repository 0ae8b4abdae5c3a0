"""Extrapolated beats: exact for few slow modes, and the same periodic beat in fewer beats."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from compare import relative_error

from solver import Network, Settings, load, repeating_beat, simulate_periodic
from solver.periodic.mixing import Beats, fills_slowly
from solver.scheme.model import build
from solver.scheme.step import initial_state

Array = np.ndarray

simulate_module = import_module("solver.simulate")  # whose name in the package is the function
QUICK = Settings(dt=5e-3, tolerance=1e-4)


@pytest.fixture(scope="module")
def slow() -> Network:
    """The human arteries whose Windkessels take five times as long."""
    human = load("human")
    return human.with_parameters({f"{o.segment}.outlet.C": 5.0 * o.C for o in human.outlets})


def test_two_slow_modes() -> None:
    """Pressures that come nearer by 0.9 and 0.6 a beat are there after three beats, in each of two members: 1e-9."""
    human = load("human")
    model = build(human, {"AsA.E": np.array([4e5, 5e5])})
    state, outlets = initial_state(model), model.mesh.topology.outlets
    random = np.random.default_rng(1)
    aim, modes = random.normal(size=state.H.shape), random.normal(size=(2, *state.H.shape))
    size, beats = random.uniform(1.0, 2.0, (2, 2)), Beats(outlets)

    def pressures(left: Array) -> Array:
        return 1e4 + 1e2 * (aim + np.einsum("mb,mbn->bn", left, modes))

    for _ in range(3):
        begun = replace(state, H=pressures(size))
        size = size * np.array([[0.9], [0.6]])
        state = replace(state, H=pressures(size))
        beats = beats.followed(begun, state, float(np.abs(size).max()))
    mixed = beats.mixed()
    assert mixed is not None
    np.testing.assert_allclose(mixed.H, 1e4 + 1e2 * aim, rtol=1e-9)
    np.testing.assert_allclose(beats.weights().sum(axis=0), 1.0, rtol=1e-12)
    np.testing.assert_allclose(mixed.y, state.y, rtol=1e-9)  # of equal states, themselves


def test_areas_stay_positive() -> None:
    """An extrapolation to the area 2 · 0.4 - 1 of the one at rest is no start of a beat; to 2 · 0.6 - 1 it is."""
    state = initial_state(build(load("human")))
    outlets, H = slice(0, state.H.shape[1]), np.ones_like(state.H)
    for share, possible in ((0.4, False), (0.6, True)):
        narrower = replace(state, y=share * state.y, H=1.5 * H)
        beats = Beats(outlets).followed(replace(state, H=0.0 * H), replace(state, H=H), 1.0)
        mixed = beats.followed(replace(state, H=H), narrower, 0.5).mixed()
        assert (mixed is not None) == possible


@pytest.mark.parametrize(("name", "slow"), [("sheep", False), ("sheep_nonlinear", False), ("human", True)])
def test_who_fills_slowly(name: str, slow: bool) -> None:
    """What is left of a gap after a beat, by C/Σ(1/R): 2 % in the sheep, 47 % in the human."""
    network = load(name)
    assert fills_slowly(build(network), network.inlet.T) == slow


def test_what_dies_out_soon_is_let_alone(sheep: Network) -> None:
    """The sheep: bit for bit the beats that it has without."""
    fast, plain = (simulate_periodic(sheep, settings=QUICK, accelerate=on) for on in (True, False))
    assert fast.beats == plain.beats
    for name in plain:
        np.testing.assert_array_equal(fast[name], plain[name])


def test_slow_windkessels(slow: Network) -> None:
    """To 1e-3 in 3 beats, from rest in 5, where without acceleration it takes 16; the beat is the same to 1e-4.

    The reference is converged to 1e-7: without acceleration a change of 1e-3 a beat is still 3e-3 from it.
    """
    exact = simulate_periodic(slow, settings=QUICK, tolerance=1e-7)
    errors = {}
    for start, accelerate, beats in ((None, True, 3), ("rest", True, 5), (None, False, 16)):
        run = simulate_periodic(slow, settings=QUICK, tolerance=1e-3, start=start, accelerate=accelerate)
        assert run.beats == beats
        errors[start, accelerate] = max(relative_error(name, run[name], exact[name]) for name in exact)
    assert errors[None, True] <= 1e-4
    assert errors["rest", True] <= 2e-3
    assert errors[None, False] <= 1e-2


def test_a_repeating_beat_from_afar(slow: Network, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no state near the periodic one is found, from rest: to 1e-4 in 8 beats, where without
    extrapolation the twelfth still differs by 3e-3; the same
    beat to 2e-4 (1.5e-4 measured)."""
    exact = simulate_periodic(slow, settings=QUICK, tolerance=1e-7)
    monkeypatch.setattr(simulate_module._Run, "near", lambda run, period, tolerance: run.begin("rest", period))
    beat = repeating_beat(slow, settings=QUICK, tolerance=1e-4, max_beats=12)
    assert beat.beats <= 8
    assert max(relative_error(name, beat[name], exact[name]) for name in exact) <= 2e-4


def test_what_iterations_leave_over_does_not_keep_beats_apart() -> None:
    """Elastic `cca`: iterations to 3e-5 leave beats 3e-5 apart for ever; once that shows they are to 1e-6: 7 beats."""
    beat = simulate_periodic(load("cca"))
    assert beat.beats <= 8
    assert beat.change <= 1e-5
