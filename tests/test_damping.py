"""The damping of what elements do not resolve: what it takes, where it acts, and what runs because of it."""

from __future__ import annotations

import numpy as np
import pytest
from compare import elastic

from solver import Network, Settings, load, simulate
from solver.mesh.element import element
from solver.scheme.damping import HighDegrees, NoDamping
from solver.scheme.model import build

Array = np.ndarray


@pytest.mark.parametrize("N", range(2, 9))
def test_high_degrees_alone_are_damped(N: int) -> None:
    """P_k of a flow counts 1 where k > (N + 1)/2, else nothing, to 1e-12; no flow gains energy by it."""
    el = element(N)
    parts = np.polynomial.legendre.legvander(el.x_lobatto, N).T
    power = parts @ el.high_degrees @ parts.T
    np.testing.assert_allclose(power, np.diag(1.0 * (np.arange(N + 1) > (N + 1) / 2)), atol=1e-12)
    assert np.linalg.eigvalsh(el.high_degrees).min() >= -1e-14


def test_slope_by_differences() -> None:
    """The derivative by central differences, to 1e-9; it takes power from any flow."""
    random = np.random.default_rng(4)
    Z, small, Q, dQ = (random.uniform(0.5, 2.0, (2, 5, 4)) for _ in range(4))
    damping = HighDegrees(Z[..., :1].repeat(4, -1), small[..., :1].repeat(4, -1), element(3).high_degrees)
    low, high, here = np.zeros((3, 2, 5, 4))
    damping.add_to(low, Q - 1e-5 * dQ)
    damping.add_to(high, Q + 1e-5 * dQ)
    damping.add_to(here, Q)
    np.testing.assert_allclose(np.einsum("beij,bej->bei", damping.slope(Q), dQ), (high - low) / 2e-5, atol=1e-9)
    assert (np.sum(here * Q, axis=-1) > 0.0).all()


def _of(network: Network, phi0: float | Array, length: float = 0.05, **more: float) -> Array:
    """Z of all elements, (B, n_e)."""
    values = {f"{s.name}.phi0": phi0 for s in network.segments} | {
        name.replace("_", "."): x for name, x in more.items()
    }
    damping = build(network, values, Settings(element_length=length)).damping
    return damping.Z[..., 0] if isinstance(damping, HighDegrees) else np.zeros((1, 1))


def test_walls_that_damp_by_themselves(sheep: Network) -> None:
    """ρc/A in elastic walls; with ν of a wall's viscosity less 2 N (N + 1) ν/h; none in the paper's walls."""
    assert isinstance(build(sheep).damping, NoDamping)
    model = build(sheep, elastic(sheep.segments))
    wave = (model.wall.rho * model.wall.c0 / model.wall.A0)[..., 0]
    np.testing.assert_allclose(_of(sheep, 0.0), wave, rtol=1e-12)
    nu = (
        build(sheep, {f"{s.name}.phi0": 10.0 for s in sheep.segments}).wall.viscosity_area[..., 0]
        / model.wall.A0[..., 0]
    )
    h = model.coefficients.L[:, model.mesh.segment] / model.mesh.parts
    np.testing.assert_allclose(_of(sheep, 10.0), wave - 24.0 * nu / h, rtol=1e-12)
    batch = _of(sheep, np.array([0.0, 10.0, 1e5]))
    np.testing.assert_array_equal(batch[:2], np.concatenate([_of(sheep, 0.0), _of(sheep, 10.0)]))
    assert not batch[2].any()


def test_a_stress_that_relaxes_damps_less(sheep: Network) -> None:
    """A viscosity that has relaxed at the frequency of the highest degree does not count: τ of 20 ms, 1 mm."""
    lag = sheep.with_terms({"CA.tau": 0.02})
    own = np.array(
        [lag.segments[s].name == "CA" for s in build(lag, settings=Settings(element_length=1e-3)).mesh.segment]
    )
    relaxed = build(lag, settings=Settings(element_length=1e-3)).damping
    assert isinstance(relaxed, HighDegrees)
    assert (relaxed.Z[0, own, 0] > 0.99 * _of(lag, 0.0, 1e-3)[0, own]).all() and not relaxed.Z[0, ~own].any()


@pytest.mark.parametrize(("name", "degree"), [("cca", 3), ("uta", 3), ("ibif", 1)])
def test_nothing_is_damped(name: str, degree: int) -> None:
    """No damping in a single vessel, nor with degree 1, where it would be a first-order error."""
    assert isinstance(build(load(name), settings=Settings(degree=degree)).damping, NoDamping)


# network, dt [s], element [m], degree, and until when [s]; without damping each breaks down 30 ms before, or earlier
REFINED = [
    ("adan56", 5e-4, 0.05, 3, 0.33),
    ("adan56", 2.5e-4, 0.05, 3, 0.25),
    ("adan56", 2.5e-4, 0.025, 3, 0.25),
    ("adan56", 2.5e-4, 0.05, 5, 0.25),
    ("wang55", 2.5e-4, 0.05, 3, 0.34),
    ("circle_of_willis", 2.5e-4, 0.05, 3, 0.25),
]


@pytest.mark.parametrize(("name", "dt", "length", "degree", "end"), REFINED)
def test_refined_elastic_networks(name: str, dt: float, length: float, degree: int, end: float) -> None:
    """They run without growing waves: the highest degree is 2e-3 of the largest flow at most (1.3e-3 measured)."""
    network = load(name)
    walls = elastic(network.segments)
    result = simulate(network, duration=end, parameters=walls, settings=Settings(dt, length, degree), backend="auto")
    assert result.end is not None
    Q = result.end.state.Q[0]
    parts = np.linalg.solve(np.polynomial.legendre.legvander(element(degree).x_lobatto, degree), Q.T)
    assert np.abs(parts[-1]).max() <= 2e-3 * np.abs(Q).max()
