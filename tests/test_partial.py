"""Effects of a part of a segment: what is inside, in a mesh and in a search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fitting.inference.hypothesis import placed, placed_effect
from solver import Inlet, Network, Resistance, Segment, Settings, Site, beat_harmonics, simulate
from solver.laws.effects import BY_NAME
from solver.laws.localised import Partial
from solver.linear import amplitudes
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
    """A batch of positions is its members on one mesh; files hold position and length."""
    network = BY_NAME["stenosis"].add(sheep, "MD", {"K": 30.0, "K_position": 0.3, "K_length": 0.2})
    assert loads(dumps(network), "x") == network and "K_position = 0.3" in dumps(network)
    both = simulate(network, duration=0.1, parameters={"MD.K_position": np.array([0.3, 0.7])})
    for name, values in both.items():
        alone = simulate(network, duration=0.1, parameters={"MD.K_position": 0.7})[name]
        assert name == "inlet.Q" or np.abs(values[1] - alone).max() <= 1e-11 * np.abs(alone).max()


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


OMEGA = 2.0 * np.pi / 0.5 * np.arange(1, 9)
PLACES = (0.0, 0.15, 0.25, 0.35, 0.45, 0.8)  # the ramps of the part are about 0.15 and 0.45
BESIDE = Segment("A", L=0.3, R0=4e-3, h=4e-4, E=8e5)
BESIDE_R = 3e8


def beside_a_part(phi0: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """P and R : (n_places, n) of small waves by 4000 Runge-Kutta steps along the vessel, from the resistance at its end
    to an inflow of 1 nL/s, with the compliance linear in smooth steps over 0.08 L about 0.15 and 0.45."""
    s, A = BESIDE, np.pi * BESIDE.R0**2
    K_h, n = s.h / (0.75 * s.R0), 4000
    Z = 1060.0 / A * (1j * OMEGA + 22.0 * np.pi * 3.5e-6 / A)

    def compliance(x: float) -> np.ndarray:
        t = np.clip((np.array([x - 0.15, 0.45 - x])) / 0.08 + 0.5, 0.0, 1.0)
        inside = float(np.sum(t * t * (3.0 - 2.0 * t))) - 1.0
        E = s.E / (1.0 - inside + inside / scale)
        return 2.0 * A / (K_h * (E + 1j * OMEGA * phi0))  # A'/P'

    def slope(x: float, y: np.ndarray) -> np.ndarray:
        return -s.L * np.stack([Z * y[1], 1j * OMEGA * compliance(x) * y[0]])

    y, found = np.stack([BESIDE_R + 0j * OMEGA, 1.0 + 0j * OMEGA]), {1.0: BESIDE_R + 0j * OMEGA}
    for i in range(n, 0, -1):
        x, d = i / n, -1.0 / n
        a = slope(x, y)
        b = slope(x + d / 2, y + d / 2 * a)
        c = slope(x + d / 2, y + d / 2 * b)
        y = y + d / 6 * (a + 2 * b + 2 * c + slope(x + d, y + d * c))
        found[(i - 1) / n] = y[0]
    P = np.array([found[x] for x in PLACES]) * 1e-9 / y[1]
    return P, np.array([P_x * compliance(x) for x, P_x in zip(PLACES, P, strict=True)]) / (2.0 * np.pi * s.R0)


@pytest.mark.parametrize("scale", [1.3, 20.0])
def test_linear_theory_of_a_part(scale: float) -> None:
    """P and R of small waves beside and within a stiffer part, to 1e-5 of the largest (measured 7e-6). With as few
    pieces as in a tapered segment it was 3e-3 and 3e-2 off."""
    part = {"E_scale": scale, "E_position": 0.3, "E_length": 0.3}
    sites = tuple(Site(f"S{i}", "A", x) for i, x in enumerate(PLACES))
    vessel = replace(BESIDE, phi0=5e3, terms=part)
    network = Network("beside", (vessel,), Inlet("A"), outlets=(Resistance("A", R=BESIDE_R),), sites=sites)
    found = amplitudes(network, np.full(len(OMEGA), 1e-9 + 0j), OMEGA)
    for signal, expected in zip("PR", beside_a_part(5e3, scale), strict=True):
        off = np.abs([found[f"{site.name}.{signal}"] for site in sites] - expected).max(axis=0)
        assert np.all(off < 1e-5 * np.abs(expected).max(axis=0))


@pytest.mark.parametrize(("phi0", "of_R"), [(0.0, 5e-4), (5e3, 3e-3)])
@pytest.mark.parametrize("backend", ["numpy", "auto"])
def test_a_site_where_a_stiffer_part_begins(phi0: float, of_R: float, backend: str) -> None:
    """A is not smooth there within an element, but P is: P of all sites within 4e-4 of its harmonics (and
    R in elastic walls; in viscous ones R 2.5e-3). From an interpolated A, P and R were 1.8e-2 off."""
    part = {"E_scale": 1.3, "E_position": 0.3, "E_length": 0.3}
    sites = tuple(Site(f"S{i}", "A", x) for i, x in enumerate(PLACES))
    vessel = replace(BESIDE, phi0=phi0, terms=part)
    network = Network("beside", (vessel,), Inlet("A"), outlets=(Resistance("A", R=BESIDE_R),), sites=sites)

    def inflow(t: np.ndarray) -> np.ndarray:
        return 2e-9 * np.cos(np.multiply.outer(OMEGA, t)).sum(axis=0)

    for signal, expected, bound in zip("PR", beside_a_part(phi0, 1.3), (5e-4, of_R), strict=True):
        names = [f"{site.name}.{signal}" for site in sites]
        X = beat_harmonics(network, names, len(OMEGA), inflow, 0.5, tolerance=1e-8, backend=backend)[0, 1:].T
        off = np.linalg.norm(X - expected, axis=1) / np.linalg.norm(expected, axis=1)
        assert off.max() < bound
