"""The pieces of the default scheme: polynomials, mesh, Jacobian, time grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver import Network, Settings
from solver.mesh.element import element
from solver.mesh.mesh import build_mesh, topology
from solver.network.coefficients import coefficients
from solver.scheme import terms
from solver.scheme.model import build
from solver.scheme.sdirk import INFLOW_AT_STAGES, INFLOW_TIMES, SDIRK3
from solver.scheme.stage import Stage, operators
from solver.scheme.step import initial_state, step


@pytest.mark.parametrize("N", range(1, 9))
def test_element_is_exact_for_polynomials(N: int) -> None:
    """Interpolation and derivative of degree N, quadratures of degree 2N - 1: exact to 1e-12."""
    el = element(N)
    for degree in range(N + 1):
        Q = el.x_lobatto**degree
        np.testing.assert_allclose(el.to_gauss @ Q, el.x_gauss**degree, atol=1e-12)
        np.testing.assert_allclose(el.derivative @ Q, degree * el.x_gauss ** max(degree - 1, 0), atol=1e-11)
    for degree in range(N):
        np.testing.assert_allclose(el.to_lobatto @ el.x_gauss**degree, el.x_lobatto**degree, atol=1e-11)
    for x, w in ((el.x_lobatto, el.w_lobatto), (el.x_gauss, el.w_gauss)):
        for degree in range(2 * N):
            exact = 2.0 / (degree + 1) if degree % 2 == 0 else 0.0
            assert w @ x**degree == pytest.approx(exact, abs=1e-13)


def test_time_scheme_has_order_three_and_is_stiffly_accurate() -> None:
    """Alexander (1977): order conditions to 1e-15, R(∞) = 0; a cubic inflow is met at the end of the step."""
    b, c = SDIRK3[-1], SDIRK3.sum(axis=1)
    conditions = [b.sum() - 1, b @ c - 1 / 2, b @ c**2 - 1 / 3, b @ SDIRK3 @ c - 1 / 6, c[-1] - 1]
    np.testing.assert_allclose(conditions, 0.0, atol=1e-15)
    assert 1.0 - b @ np.linalg.solve(SDIRK3, np.ones(3)) == pytest.approx(0.0, abs=1e-13)
    cubic = 1.0 - 2.0 * INFLOW_TIMES + 3.0 * INFLOW_TIMES**2 + 5.0 * INFLOW_TIMES**3
    assert (INFLOW_AT_STAGES @ cubic)[-1] == pytest.approx(7.0, rel=1e-14)
    np.testing.assert_allclose(INFLOW_AT_STAGES @ (2.0 + INFLOW_TIMES), 2.0 + c, rtol=1e-14)


def test_mesh_of_the_sheep(sheep: Network) -> None:
    """Elements of at most 5 cm; one node per joined end; every flow leaves one node and enters another."""
    mesh = build_mesh(sheep, coefficients(sheep).L[0], 0.05, 3)
    counts = dict(zip([s.name for s in sheep.segments], mesh.count.tolist(), strict=True))
    assert counts == {"AA": 1, "PD": 2, "MD": 2, "DD": 3, "BT": 1, "CA": 3, "FA": 2, "VA1": 4, "VA2": 4, "VA3": 4}
    assert mesh.n_nodes == topology(sheep).n_nodes + (mesh.n_elements - len(sheep.segments))
    assert [np.bincount(mesh.ends.ravel()).min(), np.bincount(mesh.ends.ravel()).max()] == [1, 3]
    assert np.all(np.sort(mesh.ends, axis=1)[:, 0] != np.sort(mesh.ends, axis=1)[:, 1])


@pytest.mark.parametrize("position", [0.0, 0.13, 0.5, 0.77, 1.0])
def test_sampling_is_exact_for_polynomials(sheep: Network, position: float) -> None:
    """Q of degree N and A of degree N along a segment are sampled exactly, also at its ends and between elements."""
    N = 3
    mesh = build_mesh(sheep, coefficients(sheep).L[0], 0.05, N)
    segment = 5
    place = (np.arange(mesh.n_elements) - mesh.first[mesh.segment])[:, None]
    gauss = (place + (mesh.element.x_gauss + 1) / 2) / mesh.count[mesh.segment][:, None]
    lobatto = (place + (mesh.element.x_lobatto + 1) / 2) / mesh.count[mesh.segment][:, None]
    at = np.array([segment]), np.array([position])
    assert mesh.sample_gauss(*at)((gauss**N).reshape(1, -1))[0, 0] == pytest.approx(position**N, abs=1e-12)
    assert mesh.sample_lobatto(*at)((lobatto**N).reshape(1, -1))[0, 0] == pytest.approx(position**N, abs=1e-12)


EFFECTS = {
    "CA.tau": 0.02,
    "CA.leak": 1e-8,
    "CA.K": 20.0,
    "CA.taper": -0.2,
    "AA.junction.k": 0.7,
    "fluid.unsteady_scale": 1.0,
}

ELASTIC = {"CA.phi0": 0.0, "AA.phi0": 100.0}


@pytest.mark.parametrize("law", ["beta", "regression"])
@pytest.mark.parametrize("added", [{}, EFFECTS, ELASTIC], ids=["plain", "effects", "elastic"])
def test_jacobian_by_finite_differences(sheep: Network, law: str, added: dict[str, float]) -> None:
    """∂R/∂Q of the momentum in a developed flow against central differences: 1e-8 of its largest entry.

    As a whole, and term by term; without and with memory, a leak, a stenosis, a taper and a junction loss.
    """
    sheep = sheep.with_terms({"CA.phiNL": -0.5 * sheep.segment("CA").phi0 * ("CA.phi0" not in added), **added})
    network = replace(
        sheep.with_parameters({"CA.ENL": 4e4, "fluid.alpha": 1.2}), elastic_law=law, viscous_law="monotone"
    )
    model = build(network)
    state = initial_state(model)
    for i in range(100):
        state = step(model, state, 1e-3, sheep.inlet.Q((i + INFLOW_TIMES) * 1e-3))
    s = Stage.of(model, operators(model, 1e-3), state.y, np.array(0.0), model.coefficients.P_venous, state.t).start
    random = np.random.default_rng(1)
    Q = state.Q + 1e-6 * random.normal(size=state.Q.shape)
    dQ = 1e-10 * random.normal(size=Q.shape)
    f, low, high = (terms.flow(s, q) for q in (Q, Q - dQ, Q + dQ))
    d = terms.change(s, f)

    def force(f: terms.Flow) -> np.ndarray:
        R = np.zeros_like(Q)
        s.force.add_to(R, f.Q, f.A_end)
        return R

    pairs = (
        (terms.jacobian(s, f), lambda f: terms.residual(s, f.Q, state.H)),
        (terms.d_pressure(s, f, d), lambda f: terms.pressure(s, f)),
        (terms.d_convection(s, f, d), lambda f: terms.convection(s, f)),
        (terms.d_inertia(s, f, d), lambda f: terms.inertia(s, f)),
        (terms.d_friction(s, f, d), lambda f: terms.friction(s, f)),
        (terms.d_force(s, f, d), force),
        (terms.d_ends(s, f, d), lambda f: terms.ends(s, f, state.H)),
    )
    for K, term in pairs:
        expected = (term(high) - term(low)) / 2
        assert np.abs(np.einsum("beij,bej->bei", K, dQ) - expected).max() <= 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"dt": 0.0}, "settings: dt = 0 s is not allowed: internal time step must lie in"),
        ({"dt": float("nan")}, "settings: dt = nan"),
        ({"element_length": -1.0}, "settings: element_length = -1 m is not allowed"),
        ({"degree": 0}, "settings: degree = 0 must be an integer from 1 to 12"),
        ({"tolerance": 1.0}, "settings: tolerance = 1 "),
    ],
)
def test_bad_settings(values: dict[str, float], words: str) -> None:
    """Numerical settings out of range are refused in a sentence."""
    with pytest.raises(ValueError, match=words):
        Settings(**values)  # type: ignore[arg-type]
