"""The independent generator of hidden effects, against the solver, analytic cases and integrators of others."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compare import relative_error
from scipy.integrate import solve_ivp
from scipy.special import jn_zeros
from truth.anatomy import Anatomy, End, Place, Vessel, anatomy
from truth.beat import Beat, at_phase
from truth.bench import bench_wall, radius
from truth.detect import BenchProblem, NetworkProblem, d_prime, detect
from truth.hide import ALL, Effect, hide, parameters, springpot_of
from truth.network import Balance, Linearised, womersley_excess
from truth.records import BEATS, FITTED, Case, make, write
from truth.refit import DRIFT, refit
from truth.sensors import clock, pulsatile
from truth.shapes import MMHG, arterial_pressure, ejection

from fitting.records.read.record import read_record
from solver import Network, Settings, Windkessel, simulate_periodic
from solver.laws.effects import ALL as CATALOGUE
from solver.loop import loop_pressure

T = 0.5
BEAT = Beat(T)


def inflow(network: Network, seed: int = 4) -> np.ndarray:
    return ejection(np.random.default_rng(seed), BEAT, network.inlet.Q_max)


# --- independence ----------------------------------------------------------------------------------------------------


def test_shares_no_numerical_code_with_the_solver() -> None:
    """From the solver come dataclasses and load, from fitting write_record, and nothing else."""
    allowed = {"solver": {"Network", "load"}, "fitting.records.read.record": {"write_record"}}
    allowed["solver.network.description"] = {"Network", "Pressure", "Reflection", "Resistance", "Windkessel"}
    for path in (Path(__file__).parent / "hidden").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                assert not any(a.name.split(".")[0] in ("solver", "fitting", "discrepancy") for a in node.names)
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                if node.module.split(".")[0] in ("solver", "fitting", "discrepancy"):
                    assert {a.name for a in node.names} <= allowed[node.module], path


# --- the network -----------------------------------------------------------------------------------------------------


def test_null_agrees_with_the_solver(sheep: Network) -> None:
    """Two methods, one answer: all ten sites at dt 1 ms within 1e-5 of the pulse (5e-6; 7e-7 at 0.5 ms measured)."""
    c = inflow(sheep)
    flow = Balance(anatomy(sheep), BEAT).solve(c)
    settings = Settings(tolerance=1e-7)
    beat = simulate_periodic(
        sheep, lambda t: at_phase(c, t / T), T, settings=settings, tolerance=1e-6, start="periodic"
    )
    errors = {n: relative_error(n, at_phase(x, beat.time / T), beat[n]) for n, x in flow.channels.items()}
    assert max(errors.values()) <= 1e-5, errors


EFFECTS = [
    (Effect("nonlinear_wall_viscosity", ("AA",), -0.8), 1e-5),
    (Effect("nonlinear_elasticity", ("CA",), 2.0), 1e-5),
    # the solver's own error at this step; it falls to 5e-5 at 0.5 ms and a finer mesh
    (Effect("stress_relaxation", ("PD",), 0.03), 1e-4),
    (Effect("fractional_viscosity", ("CA",), 0.5, 0.3), 3e-4),  # the solver's exponentials are within 0.4 % of (iω)^a
    (Effect("fractional_viscosity", ALL, 0.3, 0.3), 3e-4),
    (Effect("external_pressure", ("FA",), 800.0), 1e-5),
    (Effect("wall_stiffness", ("CA",), 0.4), 1e-5),
    (Effect("taper", ("CA",), -0.3), 1e-5),
    (Effect("fluid_friction", ALL, 1.5), 1e-5),
    (Effect("velocity_profile", ALL, 0.33), 1e-5),
    # the solver's eight exponentials are within 0.6 % of the exact shear
    (Effect("unsteady_friction", ALL, 1.0), 2e-4),
    (Effect("terminal_reflection", ("FA",), 0.3), 1e-5),
    (Effect("terminal_compliance", ("CA",), 0.1, 0.7), 1e-5),
    (Effect("side_branch", ("MD",), 0.2), 1e-5),
    (Effect("stenosis", ("MD",), 30.0), 1e-5),
    (Effect("junction_loss", ("AA",), 1.0), 1e-5),
    # parts of a segment: the solver's walls change over 0.08 L about the ends of the part
    (Effect("stenosis", ("MD",), 30.0, position=0.3), 1e-5),
    (Effect("stenosis", ("MD",), 30.0, position=0.97), 1e-5),
    (Effect("side_branch", ("MD",), 0.2, position=0.3, length=0.2), 1e-5),
    (Effect("side_branch", ("CA",), 0.2, position=0.8, length=0.5), 4e-4),
    (Effect("wall_stiffness", ("MD",), 0.4, position=0.3, length=0.3), 2e-4),
]


@pytest.mark.deep
@pytest.mark.parametrize(("effect", "tolerance"), EFFECTS, ids=lambda x: getattr(x, "name", ""))
def test_every_effect_agrees_with_the_solver(sheep: Network, effect: Effect, tolerance: float) -> None:
    """The solver's own term with the truth's parameters, at ten sites, relative to the pulse (dt 1 ms)."""
    base = replace(sheep, viscous_law="monotone")
    model = hide(anatomy(base), effect)
    network = _with_parameters(base, effect, parameters(model, effect))
    c = inflow(sheep)
    flow = Balance(model, BEAT, 14).solve(c)
    beat = simulate_periodic(
        network, lambda t: at_phase(c, t / T), T, settings=Settings(tolerance=1e-6), tolerance=1e-6, start="periodic"
    )
    errors = {n: relative_error(n, at_phase(x, beat.time / T), beat[n]) for n, x in flow.channels.items()}
    assert max(errors.values()) <= tolerance, max(errors.items(), key=lambda item: item[1])


def _with_parameters(network: Network, effect: Effect, truth: dict[str, float]) -> Network:
    """The solver's network with the effect that a truth file tells."""
    values = {name.rpartition(".")[2]: value for name, value in truth.items()}
    if effect.name == "fractional_viscosity":
        share, more = springpot_of(effect.size, effect.second, T)
        names = [s.name for s in network.segments if effect.where == ALL or s.name in effect.where]
        return network.with_parameters({f"{n}.phi0": more * network.segment(n).phi0 for n in names}).with_terms(
            {f"{n}.{key}": x for n in names for key, x in (("springpot", share), ("springpot_order", effect.second))}
        )
    if effect.name == "terminal_compliance":
        outlets = (Windkessel(o.segment, **values) if o.segment in effect.where else o for o in network.outlets)
        return replace(network, outlets=tuple(outlets))
    return next(e for e in CATALOGUE if e.name == effect.name).add(network, effect.where[0], values)


@pytest.mark.parametrize("elastic", [False, True])
def test_refinement(sheep: Network, elastic: bool) -> None:
    """More points and harmonics change sites by <= 1e-9 of the pulse; elastic walls by <= 4e-6."""
    model = anatomy(sheep)
    if elastic:
        model = model.with_vessels(*(replace(v, phi0=0.0) for v in model.vessels))
    fine = Beat(T, 110, 352)
    coarse = Balance(model, BEAT, 16 if elastic else 10).solve(inflow(sheep)).channels
    c = np.zeros(111, complex)
    c[:81] = inflow(sheep)
    reference = Balance(model, fine, 20 if elastic else 14).solve(c).channels
    errors = {
        n: relative_error(n, BEAT.values(coarse[n]), at_phase(reference[n], BEAT.phase))
        for n in coarse
        if not n.startswith("VA")
    }
    assert max(errors.values()) <= (4e-6 if elastic else 1e-9), errors


def _tube(**changes: float) -> Anatomy:
    vessel = Vessel("A", 0.3, 8e-3, 1e-3, 8e5, 1.3e4)
    return Anatomy(
        vessels=(replace(vessel, **changes),),
        joins=(),
        ends=(End("A", "impedance", R1=1.2e8),),
        places=(Place("A", "A", 0.3),),
        inlet="A",
        rho=1060.0,
        nu=3.5e-6,
        alpha=1.0,
        friction=22.0,
        eta=0.5,
        P_ref=0.0,
        P_0=0.0,
        elastic_law="beta",
        viscous_law="quadratic",
    )


@pytest.mark.parametrize(
    "effect", ["none", "stress_relaxation", "fractional_viscosity", "unsteady_friction", "side_branch"]
)
def test_small_amplitude_against_the_transmission_line(effect: str) -> None:
    """A tube with every linear effect: P at a site against the exact transmission line per harmonic, <= 1e-6."""
    sizes = {"stress_relaxation": 0.02, "fractional_viscosity": 0.6, "unsteady_friction": 0.7, "side_branch": 0.3}
    model = _tube() if effect == "none" else hide(_tube(), Effect(effect, ALL, sizes[effect], 0.4))
    v, w = model.vessels[0], BEAT.omega.copy()
    w[0] = 1e-9  # the steady limit
    A0, K_h = np.pi * v.R0**2, v.h / (0.75 * v.R0)
    viscous = v.phi0 * ((1 - v.springpot) * 1j * w / (1 + 1j * w * v.tau))
    viscous = viscous + v.phi0 * v.springpot * (2 * np.pi / T) * (1j * w * T / (2 * np.pi)) ** v.order
    dP_dA = K_h * (v.E + viscous) / (2 * A0)
    j = jn_zeros(2, 20000)
    zielke = np.array([1j * f * 4 * 3.5e-6 / v.R0**2 * np.sum(1 / (1j * f + j**2 * 3.5e-6 / v.R0**2)) for f in w])
    series = (1j * w + 22 * np.pi * 3.5e-6 / A0 + model.unsteady * zielke) * 1060.0 / A0
    shunt = 1j * w / dP_dA + v.leak
    gamma, Z = np.sqrt(series * shunt), np.sqrt(series / shunt)
    c = 1e-6 * inflow_of_tube()
    load, left = 1.2e8, 0.7 * v.L
    ratio = (load * np.cosh(gamma * left) + Z * np.sinh(gamma * left)) / (
        load / Z * np.sinh(gamma * v.L) + np.cosh(gamma * v.L)
    )
    found = Balance(model, BEAT, 14).solve(c).channels["A.P"]
    # the sum over Bessel zeros is cut after 20000: its tail is 2e-6 of itself
    assert np.abs(found - ratio * c)[1:].max() <= 3e-6 * np.abs(ratio * c)[1:].max()
    assert abs(found[0] - ratio[0] * c[0]) <= 1e-5 * abs(ratio[0] * c[0])


def inflow_of_tube() -> np.ndarray:
    return ejection(np.random.default_rng(5), BEAT, 55e-6)


def test_womersley_excess_limits() -> None:
    """iω/3 for slow and 2 √(iων)/R0 for fast oscillations; against Zielke's sum above."""
    R0, nu = 5e-3, 3.5e-6
    slow, fast = 1e-4 * nu / R0**2, 1e8 * nu / R0**2
    W = womersley_excess(np.array(R0), nu, np.array([slow, fast]))
    assert W[0] == pytest.approx(1j * slow / 3, rel=1e-4)
    assert W[1] == pytest.approx(2 * np.sqrt(1j * fast * nu) / R0, rel=1e-3)


def test_steady_pressure_drops() -> None:
    """Steady flow in a stiff tube: friction 22πν ρ L Q/A², and K ρ Q²/(2A²) more with a stenosis, <= 1e-4."""
    stiff = _tube(E=8e9)
    Q = np.zeros(BEAT.K + 1, complex)
    Q[0] = 4e-5
    A0 = np.pi * 8e-3**2
    friction = 22 * np.pi * 3.5e-6 * 1060 * 0.3 * 4e-5 / A0**2
    loss = 30.0 * 530 * (4e-5 / A0) ** 2

    def drop(model: Anatomy) -> float:
        return Balance(replace(model, places=(Place("A", "A", 0.0),)), BEAT).solve(Q).channels["A.P"][0].real - 4800.0

    assert drop(stiff) == pytest.approx(friction, rel=1e-4)
    assert drop(hide(stiff, Effect("stenosis", ("A",), 30.0))) == pytest.approx(friction + loss, rel=1e-4)


def test_leak_balances_the_mean_flow(sheep: Network) -> None:
    """What flows in and not out has leaked: mean flows of the sites around a segment differ by ∫ g P dx."""
    model = hide(anatomy(sheep), Effect("side_branch", ("MD",), 0.2))
    places = [Place(f"x{i}", "MD", x) for i, x in enumerate(0.5 + 0.5 * np.polynomial.legendre.leggauss(5)[0])]
    model = replace(model, places=(Place("left", "MD", 0.0), Place("right", "MD", 1.0), *places))
    c = Balance(model, BEAT).solve(inflow(sheep)).channels
    P = 0.5 * np.polynomial.legendre.leggauss(5)[1] @ np.array([c[f"{p.name}.P"][0].real for p in places])
    leaked = model.vessel("MD").leak * model.vessel("MD").L * P
    assert (c["left.Q"][0] - c["right.Q"][0]).real == pytest.approx(leaked, rel=1e-9)


def test_inlet_response_is_the_derivative(sheep: Network) -> None:
    """The linearised response to the inflow, against a difference of two flows of a small pulse."""
    model = anatomy(sheep)
    base = np.zeros(BEAT.K + 1, complex)
    base[0] = 1.2e-5
    bump = base.copy()
    bump[3] += 1e-9
    balance = Balance(model, BEAT)
    flow = balance.solve(base)
    difference = balance.solve(bump, flow.unknown).channels
    response = Linearised(balance, flow.unknown).inlet_response()
    for name in ("AA.P", "CA.Q", "FA.R"):
        assert abs(difference[name][3] / 1e-9 - response[name][3]) <= 1e-5 * abs(response[name][3])


def test_springpot_on_the_bench(sheep: Network) -> None:
    """P on the loop of radii by harmonic balance with (iω)^a: 1e-4 of the pulse (7e-5), which it moves by 5 %."""
    c = arterial_pressure(np.random.default_rng(2), BEAT)
    model = hide(anatomy(sheep), Effect("fractional_viscosity", ("CA",), 0.3, 0.3))
    R, P = radius(bench_wall(model, "CA", BEAT), BEAT.values(c)), BEAT.values(c)
    network = _with_parameters(sheep, Effect("fractional_viscosity", ("CA",), 0.3, 0.3), {})
    assert np.abs(loop_pressure(network, "CA", R, T) - P).max() <= 1e-4 * np.ptp(P)
    assert np.abs(loop_pressure(sheep, "CA", R, T) - P).max() >= 0.04 * np.ptp(P)


# --- the bench -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("r", "e"), [(0.0, 0.0), (-1.0, 0.0), (0.4, 2.0)])
def test_bench_against_an_ode_solver(sheep: Network, r: float, e: float) -> None:
    """The monotone wall solved for dR/dt and integrated by Radau over two beats, <= 3e-7 of R's pulse (1.5e-7): after
    one beat of 0.5 s nothing is left of the start, φ0/E being 17 ms."""
    model = replace(anatomy(sheep), viscous_law="monotone")
    v = replace(model.vessel("AA"), r=r, e=e)
    c = arterial_pressure(np.random.default_rng(2), BEAT)
    R = radius(bench_wall(model.with_vessels(v), "AA", BEAT), BEAT.values(c))
    K_h = v.h / (0.75 * v.R0)

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        strain = s[0] - 1.0
        stress = (at_phase(c, np.array([t / T]))[0] - v.E * K_h * strain * (1.0 + e * strain)) * s[0] / K_h / v.phi0
        return np.array([np.log1p(2 * r * stress) / (2 * r) if r else stress])

    times = T + BEAT.phase[::8] * T
    run = solve_ivp(rate, (0.0, 2 * T), [R[0] / v.R0], "Radau", times, first_step=1e-5, rtol=1e-10, atol=1e-13)
    assert np.abs(run.y[0] * v.R0 - R[::8]).max() <= 3e-7 * np.ptp(R)


# --- records ---------------------------------------------------------------------------------------------------------


def test_a_record_is_what_it_says(tmp_path: Path) -> None:
    """Written and read back: channels, length, noise of 40 dB about the stated clean beat, truth beside it."""
    case = Case("network", "all", 40.0, (Effect("wall_stiffness", ("CA",), 0.2),))
    made = make(case, 7)
    write(made, tmp_path / "record.csv")
    record = read_record(tmp_path / "record.csv")
    assert set(record.channels) == {
        "inlet.Q",
        *(f"{s}.{k}" for s in ("AA", "PD", "MD", "DD", "BT", "CA", "FA") for k in "PQR"),
    }
    assert record.time[-1] >= BEATS * made.beat.T - 0.02 and 200.0 <= 1.0 / record.dt <= 250.0
    x = record.channels["CA.P"]
    # second differences at the sampling rate hold little of the wave
    rough = np.std(np.diff(x, 6)) / np.sqrt(924.0)
    assert rough == pytest.approx(0.01 * pulsatile(made.clean["CA.P"]), rel=0.1)
    truth = json.loads((tmp_path / "record.truth.json").read_text())
    assert truth["effects"][0]["parameters"] == {"CA.E_scale": 1.2}
    assert make(case, 7).channels["CA.P"] == pytest.approx(made.channels["CA.P"], abs=0.0)
    assert not np.array_equal(make(case, 8).channels["CA.P"][:50], made.channels["CA.P"][:50])


def test_waveforms_are_physiological() -> None:
    """Arterial pressure 80-110 mmHg with a pulse of 30-50; an ejection peaks near Q_max and flows back a little."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        P = BEAT.values(arterial_pressure(rng, BEAT)) / MMHG
        assert 80.0 <= P.mean() <= 110.0 and 30.0 <= np.ptp(P) <= 50.0 + 1e-9
        Q = BEAT.values(ejection(rng, BEAT, 55e-6))
        assert 46e-6 <= Q.max() <= 58.1e-6 and -0.35 * Q.max() <= Q.min() <= 1e-9


# --- d' --------------------------------------------------------------------------------------------------------------


def test_d_prime_of_a_null_and_of_a_gain() -> None:
    """Nothing hidden: nothing seen. A gain on R on the bench: the marginalised norm, computed densely."""
    assert detect(make(Case("bench", "AA", 40.0), 3)).d_prime == ()
    problem = BenchProblem(make(Case("bench", "AA", 40.0), 3))
    assert refit(lambda x: problem.residual(x, []), np.zeros(3), np.full(3, 1e-3), problem.prior) <= 1e-3
    made = make(Case("bench", "AA", 40.0, (Effect("channel_gain", ("AA.R",), 1e-3),)), 3)
    problem = BenchProblem(made)
    delta = problem.residual(np.zeros(3), [])
    S = np.stack([(problem.residual(row, []) - delta) / 1e-4 for row in 1e-4 * np.eye(3)], axis=1)
    marginal = np.eye(len(delta)) + S @ np.diag(problem.prior**2) @ S.T
    expected = np.sqrt(delta @ np.linalg.solve(marginal, delta))
    assert detect(made).d_prime[0] == pytest.approx(expected, rel=2e-3)


@pytest.mark.deep
def test_d_prime_counts_noise_and_samples() -> None:
    """Twenty dB less noise is ten times d'; a flow sensor's gain is g √(N Σ x²)/σ where nothing else can move it."""
    effect = Effect("channel_lag", ("AA.R",), 2e-3)
    quiet, loud = (detect(make(Case("bench", "AA", dB, (effect,)), 5)).d_prime[0] for dB in (40.0, 20.0))
    assert 5.0 <= quiet / loud <= 10.0 + 1e-6
    made = make(Case("network", "all", 40.0, (Effect("channel_gain", ("CA.Q",), 0.01),)), 5)
    samples = FITTED * made.beat.T / made.dt
    x = made.clean["CA.Q"] / 1.01
    mean = abs(x[0]) ** 2 / (1.0 / samples + DRIFT)
    alone = 0.01 * np.sqrt(mean + samples * pulsatile(x) ** 2) / made.noise["CA.Q"]
    assert 0.6 * alone <= d_prime(NetworkProblem(made), []) <= alone


def test_two_effects_are_apart_from_one() -> None:
    """A slow pressure sensor at a viscous wall: no single effect leaves more than either d', which has ζ as it is; two
    that are not clear are not asked for."""
    sensor = Effect("catheter_resonance", ("FA.P",), 0.086, 1.95)
    found = detect(make(Case("bench", "FA", 40.0, (sensor, Effect("wall_viscosity", ("FA",), 0.024)), "elastic"), 5))
    assert min(found.d_prime) > 30.0 and 6.0 < found.separation <= min(found.d_prime)
    faint = detect(make(Case("bench", "FA", 40.0, (sensor, Effect("wall_viscosity", ("FA",), 1e-5)), "elastic"), 5))
    assert min(faint.d_prime) < 30.0 and faint.separation == np.inf


def test_the_mean_period_of_a_record_is_that_of_its_truth() -> None:
    """Twenty beats that jitter by 1 ms last 20 T, to round-off, from any phase on; each by itself does not."""
    for seed in range(5):
        at = clock(np.random.default_rng(seed), 0.5, 20)
        turns = at.phase - at.phase[0]
        assert np.interp(20.0, turns, at.time) == pytest.approx(10.0, abs=1e-12)
        assert np.std(np.diff(np.interp(np.arange(21), turns, at.time))) > 2e-4
