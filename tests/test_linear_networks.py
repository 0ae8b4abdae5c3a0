"""The linearised network: junctions, loops, mean flow, batches, waveforms and errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tubes import INVISCID, OMEGA, RHO, VISCOUS, area, artery, impedance, inlet_impedance, line, speed, tube

from solver.laws.outlets import Outlet, Pressure, Reflection, Resistance, Windkessel
from solver.linear import Harmonics, solve, waveforms
from solver.network.description import Fluid, Inlet, Junction, Network, Segment, Site
from solver.network.files import bundled, read_network


def resistance(s: Segment, fluid: Fluid = VISCOUS) -> float:
    """ρ C_f L/A0²: the pressure drop of a steady flow with the skin friction -C_f Q/A."""
    return RHO * 22.0 * np.pi * fluid.nu * s.L / area(s) ** 2


@pytest.fixture(scope="module")
def sheep() -> Network:
    return read_network(bundled("sheep"))


# --- networks -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parent", "children", "paper"), [("AA", ("BT", "PD"), -0.20), ("BT", ("CA",), 0.88)], ids=["AA", "BT"]
)
def test_pulse_reflected_by_a_junction(sheep: Network, parent: str, children: tuple[str, ...], paper: float) -> None:
    """Γ = (Y_p - ΣY)/(Y_p + ΣY), Y = A0/(ρc0), is the ratio of the reflected to the arriving pressure pulse.

    Case: a junction of the sheep, elastic and inviscid, matched ends; a pulse of 0.3 ms passes mid-parent, where
    it and its reflection are L/c0 apart. Error: 3e-14 to the formula, the rounding to the notes.
    """
    segments = tuple(replace(sheep.segment(name), phi0=0.0) for name in (parent, *children))
    network = Network(
        "junction",
        segments,
        Inlet(parent),
        (Junction((parent,), children),),
        tuple(Reflection(name, R_t=0.0) for name in children),
        (Site("middle", parent),),
        fluid=INVISCID,
    )
    Y = np.array([1.0 / impedance(s) for s in segments])
    expected = (Y[0] - Y[1:].sum()) / Y.sum()

    dt, width, start = 5e-5, 3e-4, 3e-3
    t = dt * np.arange(40000)  # the pulse dies out within the period: 0.88^170
    P = waveforms(network, 1e-6 * np.exp(-0.5 * ((t - start) / width) ** 2), 40000 * dt)["middle.P"]
    travel = segments[0].L / speed(segments[0])
    first, second = (P[np.abs(t - start - passes * travel) < travel / 2].sum() for passes in (0.5, 1.5))
    assert second / first == pytest.approx(expected, abs=1e-12)
    assert second / first == pytest.approx(paper, abs=0.005)


def test_mean_pressure_of_a_chain() -> None:
    """At ω = 0: P_in = P_venous + Q (R + Σ ρ C_f L/A_rest²), A_rest = A0 (1 + (P_0 - P_ref)/K)² (β-law).

    Case: three unequal viscoelastic vessels with P_ref, P_0 and P_venous all different. Error: round-off, 2e-16.
    """
    vessels = tuple(artery(f"V{i}", L, 1e4, R0) for i, (L, R0) in enumerate([(0.1, 9e-3), (0.2, 5e-3), (0.3, 2e-3)]))
    network = Network(
        "chain",
        vessels,
        Inlet("V0"),
        (Junction(("V0",), ("V1",)), Junction(("V1",), ("V2",))),
        (Resistance("V2", R=1e8, P_venous=700.0),),
        P_ref=9e3,
        P_0=11e3,
    )
    drops = [resistance(s) / (1.0 + 2e3 * 0.75 * s.R0 / (s.E * s.h)) ** 4 for s in vessels]
    h = solve(network, np.array([2e-5]), np.zeros(1))
    expected = 700.0 + 2e-5 * (1e8 + np.cumsum([0.0, *drops[::-1]])[::-1])
    np.testing.assert_allclose(h.P_node[:, 0], expected, rtol=3e-15)
    np.testing.assert_allclose(h.Q_outlet, 2e-5, rtol=3e-15)


def test_mean_pressure_drops_along_every_path_of_the_sheep(sheep: Network) -> None:
    """P_0 - P_x = Σ ρ C_f L/A0² Q along the path, with R_t = 0.3 at each outlet: P = Q (Z0 (1 + R_t)/(1 - R_t)).

    Case: steady inflow of 10 mL/s. Error: round-off; 1e-14 of the drops, which are 2 to 7 % of the pressure.
    """
    h = solve(sheep, np.array([1e-5]), np.zeros(1))
    flow = {site.segment: float(q[0].real) for site, q in zip(sheep.sites, h.Q_site, strict=True)}
    P_in = h.P_node[0, 0].real
    for path in (("AA", "BT", "CA"), ("AA", "PD", "VA1"), ("AA", "PD", "MD", "DD", "FA")):
        end = [outlet.segment for outlet in sheep.outlets].index(path[-1])
        drop = sum(resistance(sheep.segment(name)) * flow[name] for name in path)
        P_end = h.P_node[len(sheep.junctions) + 1 + end, 0].real
        assert P_in - P_end == pytest.approx(drop, rel=1e-13)
        assert P_end == pytest.approx(flow[path[-1]] * impedance(sheep.segment(path[-1])) * 1.3 / 0.7, rel=1e-14)
    assert sum(h.Q_outlet[:, 0]) == pytest.approx(1e-5, rel=1e-14)


def test_mean_without_friction_is_one_pressure(sheep: Network) -> None:
    """ν = 0: the mean pressure is the same everywhere, Q̄ = P̄ Σ Y (1 - R_t)/(1 + R_t). Error: round-off, 2e-16."""
    h = solve(sheep, np.array([1e-5]), np.zeros(1), {"fluid.nu": 0.0})
    Y = sum(1.0 / impedance(sheep.segment(outlet.segment)) for outlet in sheep.outlets)
    np.testing.assert_allclose(h.P_node, 1e-5 / (Y * 0.7 / 1.3), rtol=3e-15)
    np.testing.assert_allclose(h.P_site, h.P_node[:1].repeat(10, axis=0), rtol=3e-15)


def test_reflection_is_the_tangent_at_the_start_pressure() -> None:
    """Q = 4 A_e (c(A_e) - c0) κ, A_e = elastic⁻¹(P - P_venous), against its tangent at P_0.

    Case: Q̄ from the law at P_0 + δ (P_0 2 kPa above the outlet's equilibrium), mean pressure from the linear network,
    inviscid. Error: O(δ²): 4 times smaller for half δ, and below 1e-3 δ at δ = 20 Pa.
    """
    s = artery()
    network = tube(s, Reflection("A", R_t=0.3, P_venous=1e3), P_ref=4e3, P_0=7e3)
    K = s.E * s.h / (0.75 * s.R0)

    def error(delta: float) -> float:
        stretch = 1.0 + (7e3 + delta - 1e3 - 4e3) / K
        Q = 4.0 * area(s) * stretch**2 * speed(s) * (np.sqrt(stretch) - 1.0) * 0.7 / 1.3
        return float(solve(network, np.array([Q]), np.zeros(1)).P_node[0, 0].real) - (7e3 + delta)

    assert abs(error(20.0)) < 1e-3 * 20.0
    assert error(20.0) / error(10.0) == pytest.approx(4.0, rel=1e-3)


def loop(B: Segment, C: Segment, load: Outlet, fluid: Fluid) -> Network:
    """A splits into B and C, which meet again in D."""
    return Network(
        "loop",
        (artery("A", 0.1), B, C, artery("D", 0.1)),
        Inlet("A"),
        (Junction(("A",), ("B", "C")), Junction(("B", "C"), ("D",))),
        (load,),
        (Site("b", "B"), Site("c", "C")),
        fluid=fluid,
    )


def test_loop_of_equal_vessels_is_one_wider_vessel() -> None:
    """Two equal vessels in parallel are one of half the impedance: twice A0 (R0 √2) with the same Eh/R0 (h √2), φ0.

    Case: Kelvin-Voigt walls, inviscid fluid (C_f/A would change with A). Error: round-off, 3e-15.
    """
    B = artery("B", phi0=1.2e4, R0=5e-3)
    wide = replace(B, R0=B.R0 * 2**0.5, h=B.h * 2**0.5)
    load = Windkessel("D", R1=2e7, C=1e-9, R2=1e8)
    one = Network(
        "one",
        (artery("A", 0.1), wide, artery("D", 0.1)),
        Inlet("A"),
        (Junction(("A",), ("B",)), Junction(("B",), ("D",))),
        (load,),
        (Site("b", "B"),),
        fluid=INVISCID,
    )
    Q = np.ones(len(OMEGA))
    two = solve(loop(B, replace(B, name="C"), load, INVISCID), Q, OMEGA)
    single = solve(one, Q, OMEGA)
    np.testing.assert_allclose(two.P_node, single.P_node, rtol=3e-14)
    np.testing.assert_allclose(two.Q_site, 0.5 * single.Q_site.repeat(2, axis=0), rtol=3e-14)
    np.testing.assert_allclose(two.P_site, single.P_site.repeat(2, axis=0), rtol=3e-14)


def test_loop_by_admittances() -> None:
    """Unequal vessels in parallel: the 2×2 admittances (1/Z_c)[coth γL, -1/sinh γL] add; at ω = 0, 1/R = 1/R_B + 1/R_C.

    Case: friction, Kelvin-Voigt walls, Resistance R behind D. The input impedance of the loop with the load Z_D of D is
    Y11 - Y12²/(Y22 + 1/Z_D). Error: round-off, 2e-15.
    """
    A, B, C = artery("A", 0.1), artery("B", 0.25, 1.2e4, 5e-3), artery("C", 0.1, 5e3, 3e-3)
    D, R = artery("D", 0.1), 5e7
    network = loop(B, C, Resistance("D", R=R), VISCOUS)

    def through(s: Segment, Z_L: np.ndarray) -> np.ndarray:
        gamma, Z_c = line(s)
        t = np.tanh(gamma * s.L)
        return Z_c * (Z_L + Z_c * t) / (Z_c + Z_L * t)

    lines = [(s, *line(s)) for s in (B, C)]
    Y11 = sum(1.0 / (Z_c * np.tanh(gamma * s.L)) for s, gamma, Z_c in lines)
    Y12 = sum(-1.0 / (Z_c * np.sinh(gamma * s.L)) for s, gamma, Z_c in lines)
    Z_D = through(D, R + 0j * OMEGA)
    expected = through(A, 1.0 / (Y11 - Y12**2 / (Y11 + 1.0 / Z_D)))
    np.testing.assert_allclose(inlet_impedance(network), expected, rtol=3e-14)

    parallel = 1.0 / (1.0 / resistance(B) + 1.0 / resistance(C))
    h = solve(network, np.array([1e-5]), np.zeros(1))
    np.testing.assert_allclose(h.P_node[0, 0], 1e-5 * (resistance(A) + parallel + resistance(D) + R), rtol=5e-15)
    np.testing.assert_allclose(h.Q_site[:, 0], 1e-5 * parallel / np.array([resistance(B), resistance(C)]), rtol=5e-15)


def test_mass(sheep: Network) -> None:
    """Q_in - ΣQ_out = iω ∫A' dx: what does not leave is stored. Error: round-off, 1e-15 of Q_in.

    Case: the sheep network; A' = 2πR0 R' is integrated over 12 Gauss-Legendre sites a segment.
    """
    x, weight = np.polynomial.legendre.leggauss(12)
    network = replace(
        sheep,
        sites=tuple(Site(f"{s.name}_{i}", s.name, (1.0 + x[i]) / 2.0) for s in sheep.segments for i in range(12)),
    )
    h = solve(network, np.ones(len(OMEGA)), OMEGA)
    volume_per_radius = np.concatenate([weight / 2.0 * s.L * 2.0 * np.pi * s.R0 for s in sheep.segments])
    stored = volume_per_radius @ h.R_site
    np.testing.assert_allclose(1.0 - h.Q_outlet.sum(axis=0), 1j * OMEGA * stored, rtol=0.0, atol=1e-14)


def test_junctions_join_pressure_and_flow(sheep: Network) -> None:
    """ΣQ = 0 and one pressure where segments meet. Case: sites at both ends of each segment. Error: round-off."""
    network = replace(sheep, sites=tuple(Site(f"{s.name}_{e}", s.name, e) for s in sheep.segments for e in (0, 1)))
    h = solve(network, np.ones(len(OMEGA)), OMEGA)
    at = {site.name: i for i, site in enumerate(network.sites)}
    for junction in network.junctions:
        ends = [at[f"{name}_1"] for name in junction.inflow] + [at[f"{name}_0"] for name in junction.outflow]
        sign = np.array([1.0] * len(junction.inflow) + [-1.0] * len(junction.outflow))
        assert np.max(np.abs(sign @ h.Q_site[ends])) < 1e-14
        np.testing.assert_allclose(h.P_site[ends], h.P_site[ends[:1]].repeat(len(ends), axis=0), rtol=3e-14)
    np.testing.assert_allclose(h.Q_site[at["AA_0"]], 1.0, rtol=1e-14)


# --- batches, waveforms, errors -----------------------------------------------------------------------------------


def test_batch_equals_single_runs(sheep: Network) -> None:
    """A batch of parameters, of inflows, or of both gives what single runs give. Error: round-off, if any."""
    values = {"AA.E": np.array([1e6, 2e6, 3e6]), "CA.outlet.R_t": np.array([0.0, 0.3, 0.6]), "PD.phi0": 5e3}
    Q = np.array([[1.0], [0.5], [0.2]]) * sheep.inlet.Q(np.arange(32) / 64.0)
    both = waveforms(sheep, Q, 0.5, values)
    for b in range(3):
        single = {name: float(np.broadcast_to(value, 3)[b]) for name, value in values.items()}
        alone = waveforms(sheep, Q[b], 0.5, single)
        parameters_only = waveforms(sheep, Q[b], 0.5, values)
        inflows_only = waveforms(sheep, Q, 0.5, single)
        assert list(alone) == list(both)
        for name, x in alone.items():
            assert x.shape == (32,) and both[name].shape == (3, 32)
            for other in (both, parameters_only, inflows_only):
                np.testing.assert_allclose(other[name][b], x, rtol=0.0, atol=1e-14 * np.abs(x).max())


def test_members_that_share_walls(sheep: Network) -> None:
    """Equal segments of several members are computed once: members that differ in a wall, a taper, an outlet, the
    fluid or nothing are as alone, also where segments of one member are equal and an inner site has its own place.
    Error: round-off.
    """
    network = sheep.with_terms({"AA.taper": -0.2, "CA.tau": 0.01, "fluid.unsteady_scale": 1.0})
    network = replace(network, sites=(*network.sites, Site("start", "AA", 0.0), Site("again", "AA", 0.0)))
    known = network.parameters()
    changes = {"AA.taper": -0.3, "CA.phi0": 2e4, "AA.E": 1.1e6, "CA.outlet.R_t": 0.1, "fluid.rho": 1000.0, "CA.L": 0.3}
    values = {
        name: np.array([known[name], known[name], *(x if other == name else known[name] for other in changes)])
        for name, x in changes.items()
    }
    Q = sheep.inlet.Q(np.arange(32) / 64.0)
    together = waveforms(network, Q, 0.5, values)
    for b in range(len(changes) + 2):
        alone = waveforms(network, Q, 0.5, {name: x[b] for name, x in values.items()})
        for name, x in alone.items():
            np.testing.assert_allclose(together[name][b], x, rtol=0.0, atol=1e-13 * np.abs(x).max())
    np.testing.assert_array_equal(together["start.P"], together["again.P"])


@pytest.mark.parametrize("n", [1, 2, 9, 16])
def test_waveforms_are_the_sum_of_harmonics(n: int) -> None:
    """P(t) = Re Σ H(ω_k) Q_k e^{iω_k t}, for a mean, a sine, a cosine and the last (Nyquist) harmonic of even n.

    The Nyquist harmonic is Q_N cos ω_N t; its sine is invisible, so its response at the samples is Re H(ω_N) Q_N (±1).
    Error: round-off, 5e-15.
    """
    s = artery(phi0=1.2e4)
    network = tube(s, Windkessel("A", R1=2e7, C=1e-9, R2=1e8), VISCOUS)
    T = 0.4
    t = T / n * np.arange(n)
    for k in range(n // 2 + 1):
        omega = 2.0 * np.pi * k / T
        H = inlet_impedance(network, np.array([omega]))[0]
        for phase in (1.0,) if k in (0, n / 2) else (1.0, 1j):
            Q = (phase * np.exp(1j * omega * t)).real
            expected = (phase * H * np.exp(1j * omega * t)).real
            np.testing.assert_allclose(waveforms(network, Q, T)["inlet.P"], expected, rtol=0.0, atol=3e-14 * abs(H))


def test_waveforms_have_the_names_of_the_fmu(sheep: Network) -> None:
    """One entry for each output variable of the FMU, in their order."""
    names = ["inlet.P", *(f"{s}.{x}" for s in (site.name for site in sheep.sites) for x in "PQR")]
    names += [f"{o.segment}.outlet.{x}" for o in sheep.outlets for x in "PQ"]
    assert list(waveforms(sheep, np.ones(8), 0.5)) == names


def test_no_sites(sheep: Network) -> None:
    """A network without sites still has its inlet and outlets."""
    assert len(waveforms(replace(sheep, sites=()), np.ones(8), 0.5)) == 1 + 2 * 5


def closed() -> Network:
    return tube(artery(), Reflection("A", R_t=1.0))


def solved(network: Network, omega: float) -> Harmonics:
    return solve(network, np.ones(1), np.array([omega]))


def test_errors(sheep: Network) -> None:
    """Each impossible request raises ValueError, never LinAlgError, with a sentence that says what to do."""
    A = artery()
    equal = loop(artery("B"), artery("C"), Resistance("D", R=1e7), INVISCID)
    with pytest.raises(ValueError, match="all outlets are closed.*R_t below 1"):
        solved(closed(), 0.0)
    with pytest.raises(ValueError, match="resonance"):
        solved(closed(), np.pi * speed(A) / A.L)
    with pytest.raises(ValueError, match="resonance"):  # a wave that runs round the loop and never leaves it
        solved(equal, np.pi * speed(A) / A.L)
    with pytest.raises(ValueError, match=r"round its 1 loop.*friction above 0"):
        solved(equal, 0.0)
    with pytest.raises(ValueError, match="AA: its wall is unstable at P_0 = 50000 Pa"):
        solve(replace(sheep, P_0=5e4), np.ones(1), np.ones(1), {"AA.ENL": -1e7})
    with pytest.raises(ValueError, match="outlet A: no stable wall carries P_0 - P_venous = -1e"):
        solved(tube(A, Reflection("A", R_t=0.3, P_venous=1e6)), 1.0)
    for omega in (np.array([-1.0]), np.array([np.nan]), np.ones((1, 1))):
        with pytest.raises(ValueError, match="angular frequencies >= 0"):
            solve(closed(), np.ones(1), omega)
    for Q in (np.ones(2), np.ones((2, 2)), np.ones(()), np.ones((1, 1, 1))):
        with pytest.raises(ValueError, match="Q has shape"):
            solve(closed(), Q, np.ones(1))
    with pytest.raises(ValueError, match="Q has shape"):
        solve(closed(), np.ones((3, 1)), np.ones(1), {"A.E": np.array([1e6, 2e6])})
    for samples in (np.zeros(0), np.array([np.nan]), np.ones((1, 1, 1))):
        with pytest.raises(ValueError, match="finite samples"):
            waveforms(closed(), samples, 1.0)
    with pytest.raises(ValueError, match="T = 0 s"):
        waveforms(closed(), np.ones(4), 0.0)


def test_prescribed_pressures_at_two_ends_need_friction() -> None:
    """Two prescribed pressures are a loop through the ground: with friction its flow is ΔP/R, without it an error.

    Case: A -> B, C with P_B = 100 Pa, P_C = 0, no inflow: Q = 100 Pa/(R_B + R_C) from B to C. Error: round-off.
    """
    segments = (artery("A"), artery("B", 0.3, R0=3e-3), artery("C", 0.2, R0=2e-3))
    network = Network(
        "fork",
        segments,
        Inlet("A"),
        (Junction(("A",), ("B", "C")),),
        (Pressure("B", P_venous=100.0), Pressure("C")),
    )
    Q = 100.0 / (resistance(segments[1]) + resistance(segments[2]))
    h = solve(network, np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(h.Q_outlet[:, 0], [-Q, Q], rtol=5e-15)
    with pytest.raises(ValueError, match=r"round its 1 loop"):
        solve(network, np.zeros(1), np.zeros(1), {"fluid.nu": 0.0})
