"""Effects of a part of a segment: what is inside, in a mesh and in a search."""

from __future__ import annotations

import numpy as np
import pytest

from fitting.inference.hypothesis import placed, placed_effect
from solver import Network, Settings, linear, simulate
from solver.laws.effects import BY_NAME
from solver.laws.localised import Partial
from solver.mesh.element import element
from solver.network.files import dumps, loads
from solver.scheme.model import build

PARTIAL = [effect for effect in BY_NAME.values() if isinstance(effect, Partial)]
KEYS = {"stenosis": ("K", 30.0), "side_branch": ("leak", 1e-9), "wall_stiffness": ("E_scale", 1.3)}


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_integral_of_the_polynomials(degree: int) -> None:
    """∫ from a to b of every Lobatto polynomial: moments of the part up to the degree are exact, to 1e-13."""
    el, a, b = element(degree), -0.35, 0.8
    powers = np.arange(degree + 2)
    weights = el.w_lobatto * ((b**powers - a**powers) @ el.integral.T)
    for k in range(degree + 1):
        exact = (b ** (k + 1) - a ** (k + 1)) / (k + 1)
        assert weights @ el.x_lobatto**k == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("effect", PARTIAL, ids=lambda e: e.name)
def test_the_usual_part_is_what_it_was(sheep: Network, effect: Partial) -> None:
    """Position and length at their usual values are bit-identical to a network that does not hold them, and off it is
    the network without the effect wherever the part lies."""
    key, value = KEYS[effect.name]
    usual = {k: effect.neutral[k] for k in effect.along}
    settings = Settings(dt=2e-3)
    plain = simulate(effect.add(sheep, "MD", {key: value}), duration=0.1, settings=settings)
    told = simulate(effect.add(sheep, "MD", {key: value, **usual}), duration=0.1, settings=settings)
    off = {key: effect.neutral[key], effect.along[0]: 0.3}
    absent, elsewhere = (simulate(n, duration=0.1, settings=settings) for n in (sheep, effect.add(sheep, "MD", off)))
    for name in plain:
        np.testing.assert_array_equal(plain[name], told[name])
        np.testing.assert_array_equal(absent[name], elsewhere[name])


def test_inside() -> None:
    """1 in all of a segment, ends included; elsewhere its integral is the part's length as far as it lies inside."""
    effect, x = BY_NAME["wall_stiffness"], np.linspace(0.0, 1.0, 20001)
    assert isinstance(effect, Partial)
    position, length = (
        np.array([[p] for p in each]) for each in ((0.5, 0.3, 0.05, 0.99, 0.5), (1.0, 0.3, 0.2, 0.1, 0.02))
    )
    inside = effect.inside(dict(zip(effect.along, (position, length), strict=True)), x)
    assert np.all(inside[0] == 1.0)
    np.testing.assert_allclose(inside.mean(axis=1), [1.0, 0.3, 0.15, 0.06, 0.02], atol=1e-4)
    assert inside.min() >= 0.0 and inside.max() <= 1.0


def test_the_whole_loss_counts_wherever_it_lies(sheep: Network) -> None:
    """Σ of the drag's weights over the elements is K/2 for any position, also where the part is cut off: 1e-12."""
    places = np.array([0.5, 0.3, 0.37, 0.02, 0.98])
    held = BY_NAME["stenosis"].add(sheep, "MD", {"K": 30.0, "K_position": 0.3})
    model = build(held, {"MD.K_position": places})
    mass, quadratic = (np.broadcast_to(a, model.mass.shape) for a in (model.mass, model.force.quadratic))
    np.testing.assert_allclose((mass * quadratic).sum(axis=(1, 2)), 15.0 * sheep.fluid.rho, rtol=1e-12)


def test_batch_and_file(sheep: Network) -> None:
    """A batch of positions is its members on one mesh; files hold position and length; the frequency domain refuses."""
    network = BY_NAME["stenosis"].add(sheep, "MD", {"K": 30.0, "K_position": 0.3, "K_length": 0.2})
    assert loads(dumps(network), "x") == network and "K_position = 0.3" in dumps(network)
    both = simulate(network, duration=0.1, parameters={"MD.K_position": np.array([0.3, 0.7])})
    for name, values in both.items():
        alone = simulate(network, duration=0.1, parameters={"MD.K_position": 0.7})[name]
        assert name == "inlet.Q" or np.abs(values[1] - alone).max() <= 1e-11 * np.abs(alone).max()
    stiff = BY_NAME["wall_stiffness"].add(sheep, "MD", {"E_scale": 1.3, "E_length": 0.2})
    with pytest.raises(ValueError, match="varies along it"):
        linear.propagation(stiff, np.array([10.0]))


@pytest.mark.parametrize("effect", PARTIAL, ids=lambda e: e.name)
def test_in_a_search(sheep: Network, effect: Partial) -> None:
    """The usual part is searched by size alone; along the segment from 0.02 to 0.98, begun where that is allowed,
    and of any length."""
    assert len(effect.coordinates(sheep, "MD")) == 1
    along = effect.coordinates_along(sheep, "MD")
    assert [c.name.rpartition(".")[2] for c in along] == list(effect.along)
    position = along[0]
    ends = [position.nominal + position.size * x for x in (position.low, position.high)]
    np.testing.assert_allclose([*ends, position.size], [0.02, 0.98, 0.15])
    for start in effect.search.starts_along:
        for coordinate, value in zip(along, start, strict=False):
            assert coordinate.low <= (value - coordinate.nominal) / coordinate.size <= coordinate.high


@pytest.mark.parametrize("effect", PARTIAL, ids=lambda e: e.name)
def test_where_a_search_begins_in_a_network_that_has_a_part(sheep: Network, effect: Partial) -> None:
    """At the same places of the segment, whether its part lies in the middle or at x/L = 0.3 already."""
    position, length = effect.along
    there = effect.add(sheep, "MD", dict(effect.neutral) | {position: 0.3, length: 0.25})
    begun = []
    for network in (sheep, there):
        term = placed_effect(network, effect, "MD")
        found = None if term is None else placed(network, term, [1.0])
        assert found is not None
        own = effect.coordinates_along(network, "MD")
        begun.append([[c.nominal + c.size * x for c, x in zip(own, s[1:], strict=False)] for s in found.starts])
        for start in found.starts:
            assert all(u.low <= x <= u.high for u, x in zip(found.unknowns, start, strict=True))
    np.testing.assert_allclose(*begun)
