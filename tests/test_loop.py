"""The wall law on a loop: its derivatives against differences, memory against its closed form, batches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver import Network, load
from solver.loop import circulant, derivative_matrix, pressure, slope, tangent, wall_of

T, N = 0.5, 41
OMEGA = 2.0 * np.pi / T


def loop(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """A radius of two harmonics, and its rate."""
    t = np.arange(N) * T / N
    R = network.segment("CA").R0 * (1.05 + 0.03 * np.cos(OMEGA * t) + 0.01 * np.sin(2.0 * OMEGA * t))
    return R, derivative_matrix(N, T) @ R


@pytest.mark.parametrize(
    "terms",
    [{}, {"CA.tau": 0.02}, {"CA.springpot": 0.4}, {"CA.tau": 0.02, "CA.springpot": 0.3, "CA.E_scale": 1.3}],
    ids=str,
)
@pytest.mark.parametrize("viscous_law", ["quadratic", "monotone"])
def test_slope_of_the_law(terms: dict[str, float], viscous_law: str) -> None:
    """dP/dR : (N, N) against central differences of every sample, R' moving along: 1e-7 of the largest entry."""
    network = replace(load("sheep_nonlinear"), viscous_law=viscous_law).with_terms(terms)
    wall, D = wall_of(network, "CA"), derivative_matrix(N, T)
    R, R_t = loop(network)
    h = 1e-5 * R.mean()
    columns = [pressure(wall, R + h * e, D @ (R + h * e), T) - pressure(wall, R - h * e, D @ (R - h * e), T)
               for e in np.eye(N)]  # fmt: skip
    expected = np.stack(columns, axis=-1)[0] / (2.0 * h)
    np.testing.assert_allclose(slope(wall, R, R_t, T), expected, atol=1e-7 * np.abs(expected).max())


def test_tangent_of_the_moment() -> None:
    """∂P/∂R and ∂P/∂R' of a wall without memory, each with the other held: central differences, 1e-7."""
    network = load("sheep_nonlinear")
    wall, (R, R_t) = wall_of(network, "CA"), loop(network)
    P, by_R, by_R_t = tangent(wall, R, R_t)
    np.testing.assert_array_equal(P, pressure(wall, R, R_t))
    h, k = 1e-5 * R.mean(), 1e-5 * np.abs(R_t).max()
    for found, expected in (
        (by_R, (pressure(wall, R + h, R_t) - pressure(wall, R - h, R_t)) / (2.0 * h)),
        (by_R_t, (pressure(wall, R, R_t + k) - pressure(wall, R, R_t - k)) / (2.0 * k)),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())


def test_a_batch_is_its_members() -> None:
    """Three walls at once, one without memory among them: each as it is alone, to 1e-12."""
    network = load("sheep_nonlinear").with_terms({"CA.tau": 0.0})
    R, R_t = loop(network)
    E, tau = np.array([3e6, 4e6, 5e6]), np.array([0.0, 0.01, 0.05])
    together = pressure(wall_of(network, "CA", {"CA.E": E, "CA.tau": tau}), R, R_t, T)
    for i in range(3):
        alone = pressure(wall_of(network, "CA", {"CA.E": E[i], "CA.tau": tau[i]}), R, R_t, T)
        np.testing.assert_allclose(together[i], alone[0], rtol=1e-12)


@pytest.mark.parametrize("n", [9, 10])
def test_matrices_of_harmonics(n: int) -> None:
    """D of a sine is its cosine, the highest harmonic of an even number aside; a circulant multiplies harmonics."""
    t = np.arange(n) * T / n
    for k in range((n - 1) // 2 + 1):
        expected = k * OMEGA * np.cos(k * OMEGA * t)
        np.testing.assert_allclose(derivative_matrix(n, T) @ np.sin(k * OMEGA * t), expected, atol=1e-9)
    x, h = np.random.default_rng(0).normal(size=n), np.exp(-1j * np.arange(n // 2 + 1))
    np.testing.assert_allclose(circulant(h, n) @ x, np.fft.irfft(np.fft.rfft(x) * h, n), atol=1e-12)
