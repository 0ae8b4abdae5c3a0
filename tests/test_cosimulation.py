"""The component without FMI: internal steps under any communication step, the kinds of inflow, changes.

Errors are the largest difference of an output over the run, relative to that output's pulse (its range).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from compare import elastic

from fmu_src.cosimulation.arteries import CoSimulation
from fmu_src.variables.arteries_variables import variable_table
from solver import Network, NonPhysicalState, Settings, load, sampled_inflow, simulate
from solver.scheme.model import build
from solver.scheme.outputs import reporter
from solver.scheme.step import initial_state, step

Array = np.ndarray
Flow = Callable[[float], float]

MS = 1e-3
FINE = 0.05 * MS
# kinks at multiples of 21 ms, which steps of 0.1, 0.3, 0.7 and 1 ms all meet
KINKS = np.array([0.0, 0.042, 0.105, 0.168, 0.21])
FLOWS = np.array([0.0, 20e-6, 55e-6, 5e-6, 0.0])


def ramps(t: float) -> float:
    """A piecewise linear inflow [m³/s]."""
    return float(np.interp(t, KINKS, FLOWS))


def smooth(t: float) -> float:
    """A smooth inflow [m³/s]."""
    return float(55e-6 * np.sin(np.pi * t / 0.42) ** 2)


def start(
    network: Network, settings: Settings | None = None, t0: float = 0.0, **starts: Any
) -> tuple[CoSimulation, dict[str, Any]]:
    """A component at rest, and the values of its variables by name."""
    settings = settings or Settings()
    values = {v.name: v.start for v in variable_table(network, settings)}
    values |= {name.replace("__", "."): value for name, value in starts.items()}
    component = CoSimulation(network, settings)
    component.initialize(t0, values)
    return component, values


def run(
    network: Network,
    times: Array,
    inflow: Flow,
    *,
    interpolation: str = "linear",
    settings: Settings | None = None,
    parameters: Mapping[str, float] | None = None,
) -> Array:
    """The network's outputs at the communication points ``times``; the inflow is set to Q(t + h) before each step."""
    starts = {"inlet.Q": inflow(times[0]), "inlet.interpolation": interpolation, **(parameters or {})}
    component, values = start(network, settings, times[0], **starts)
    n = len(network.output_units())
    rows = [component.outputs()[:n]]
    for t, end in zip(times[:-1].tolist(), times[1:].tolist(), strict=True):
        component.step(t, end - t, {**values, "inlet.Q": inflow(end)})
        rows.append(component.outputs()[:n])
    return np.array(rows)


def grid(step: float, end: float = KINKS[-1]) -> Array:
    return np.arange(round(end / step) + 1) * step


def largest_error(value: Array, expected: Array) -> float:
    return float((np.abs(value - expected).max(axis=0) / np.ptp(expected, axis=0)).max())


@pytest.fixture(scope="module", params=["viscoelastic", pytest.param("elastic", marks=pytest.mark.slow)])
def parameters(request: pytest.FixtureRequest, sheep: Network) -> dict[str, float]:
    return elastic(sheep.segments) if request.param == "elastic" else {}


@pytest.fixture(scope="module")
def on_grid(sheep: Network, parameters: dict[str, float]) -> Array:
    """The answer to the ramps with communication steps of 1 ms, the internal step."""
    return run(sheep, grid(MS), ramps, parameters=parameters)


# --- the internal grid --------------------------------------------------------------------------------------------


def test_linear_equals_the_direct_solver(sheep: Network, parameters: dict[str, float], on_grid: Array) -> None:
    """Same inflow, same grid: the solver's own answer to 1e-10 (measured 7e-13)."""
    inflow = sampled_inflow(KINKS, FLOWS)
    direct = simulate(sheep, inflow, KINKS[-1], parameters=parameters)
    expected = np.column_stack([direct[name] for name in sheep.output_units()])
    assert largest_error(on_grid, expected) <= 1e-10


@pytest.mark.parametrize("step", [3 * MS, 7 * MS, 21 * MS])
def test_long_steps_on_the_grid(sheep: Network, parameters: dict[str, float], on_grid: Array, step: float) -> None:
    """The ramps do not care how they are sliced at grid points: the answer of 1 ms to 1e-10 (measured 9e-13)."""
    value = run(sheep, grid(step), ramps, parameters=parameters)
    assert largest_error(value, on_grid[:: round(step / MS)]) <= 1e-10


@pytest.mark.parametrize("step", [2 * MS, 5 * MS])
def test_long_held_steps_on_the_grid(sheep: Network, parameters: dict[str, float], step: float) -> None:
    """Held inflow that changes every 10 ms: steps of 1, 2 and 5 ms are the same to 1e-10 (measured 0)."""

    def staircase(t: float) -> float:
        return 10e-6 * (1.0 + np.ceil(round(t / 0.01, 6)) % 3)

    def held(step: float) -> Array:
        return run(sheep, grid(step, 0.1), staircase, interpolation="hold", parameters=parameters)

    assert largest_error(held(step), held(MS)[:: round(step / MS)]) <= 1e-10


@pytest.fixture(scope="module")
def fine(sheep: Network, parameters: dict[str, float]) -> Array:
    """The answer to the smooth inflow with an internal step of 0.05 ms, at its multiples: by the direct solver, which
    the component equals (test_fmu.py)."""
    times = grid(FINE)
    inflow = sampled_inflow(times, np.array([smooth(t) for t in times]))
    found = simulate(sheep, inflow, times[-1], parameters=parameters, settings=Settings(dt=FINE))
    return np.stack([found[name] for name in sheep.output_units()], axis=1)


@pytest.mark.parametrize(
    "step", [0.3, 1.0, 1.3, 1.4, *(pytest.param(step, marks=pytest.mark.slow) for step in (0.7, 1.35))]
)
def test_steps_off_the_grid(sheep: Network, parameters: dict[str, float], fine: Array, step: float) -> None:
    """The smooth inflow against an internal step of 0.05 ms, at all communication points of any length [ms].

    No worse than 1.1e-4 of the pulse with viscous walls (measured 1.01e-4 at 1.4 ms; 5.0e-5 at 1 ms, on the grid) and
    3.5e-4 with elastic ones (3.4e-4 at 1.3 ms; 2.0e-4).
    """
    times = grid(step * MS, 0.2)
    value = run(sheep, times, smooth, parameters=parameters)
    assert largest_error(value, fine[np.round(times / FINE).astype(int)]) <= (3.5e-4 if parameters else 1.1e-4)


def test_irrational_steps(sheep: Network, parameters: dict[str, float], fine: Array) -> None:
    """Communication steps of √2 ms that also stop every 21 ms: the same bounds (measured 9.9e-5 and 2.5e-4)."""
    meet = grid(21 * MS)
    times = np.union1d(np.arange(0.0, KINKS[-1], np.sqrt(2.0) * MS), meet)
    value = run(sheep, times, smooth, parameters=parameters)[np.isin(times, meet)]
    assert largest_error(value, fine[:: round(21 * MS / FINE)]) <= (3.5e-4 if parameters else 1.1e-4)


@pytest.mark.parametrize(
    ("step", "steps"), [(1.0, 1), (5.0, 5), (0.7, 1), (0.05, 1), (1.3, 1), (1.34, 2), (1.5, 2), (2.7, 3), (10.3, 10)]
)
def test_internal_steps(sheep: Network, step: float, steps: int) -> None:
    """A multiple of dt is cut into steps of dt, any other communication step into equal ones of at most 4/3 dt.

    So one that is no shorter than 2/3 dt costs at most 1.5 times the internal steps of a multiple of dt.
    """
    component, values = start(sheep)
    component.step(0.0, step * MS, values)
    assert component.last.steps == steps
    assert component.last.dt == (MS if step % 1.0 == 0.0 else pytest.approx(step * MS / steps, rel=1e-8))
    assert step < 2 / 3 or steps <= 1.5 * step + 1e-12


def test_late_start(sheep: Network) -> None:
    """The grid begins at the start time: from t0 = 100 s the same answer to 1e-9 (measured 1e-12)."""
    t0 = 100.0
    late = run(sheep, t0 + grid(MS), lambda t: ramps(t - t0))
    assert largest_error(late, run(sheep, grid(MS), ramps)) <= 1e-9


def test_accumulated_times(sheep: Network) -> None:
    """A master that adds up its steps drifts by round-off from n·dt: the same answer to 1e-9 (measured 4e-13)."""
    times = np.cumsum([0.0, *[MS] * 210])
    assert (times != grid(MS)).any()
    assert largest_error(run(sheep, times, ramps), run(sheep, grid(MS), ramps)) <= 1e-9


# --- held inflow --------------------------------------------------------------------------------------------------


def test_hold_equals_the_direct_solver(sheep: Network, parameters: dict[str, float]) -> None:
    """Held samples of the half-sine against the scheme stepped with constant inflow: to 1e-12."""
    times = grid(MS, 0.1)
    value = run(sheep, times, lambda t: float(sheep.inlet.Q(t)), interpolation="hold", parameters=parameters)
    model = build(sheep, parameters)
    report, state = reporter(model), initial_state(model)
    for i, Q in enumerate(sheep.inlet.Q(times[1:]), start=1):
        state = step(model, state, MS, np.full(4, Q))
        assert value[i] == pytest.approx(report(state)[0], rel=1e-12, abs=0.0)


@pytest.mark.parametrize("pattern", [pytest.param([1.0], marks=pytest.mark.endurance), [1.0, 1e-3]])
def test_inlet_pressure_under_held_inflow(sheep: Network, parameters: dict[str, float], pattern: list[float]) -> None:
    """Every held value is a jump of the inflow. inlet.P of 100 ms against a fine solution of that staircase.

    3 % of the pulse with viscous walls, 1.4 % with elastic ones (measured 2.97 and 1.31 %, after steps of 1 µs).
    """
    times = np.concatenate([[0.0], np.cumsum(np.tile(pattern, 100)) * MS])
    times = times[times <= 0.1]

    def half_sine(t: float) -> float:
        return float(sheep.inlet.Q(t))

    value = run(sheep, times, half_sine, interpolation="hold", parameters=parameters)
    fine = Settings(dt=0.1 * MS, element_length=0.02)
    expected = run(sheep, times, half_sine, interpolation="hold", parameters=parameters, settings=fine)
    assert largest_error(value[:, :1], expected[:, :1]) <= (0.014 if parameters else 0.03)


@pytest.mark.parametrize(("h", "zigzag"), [(0.5, 0.006), (0.25, 0.001)])
def test_held_inflow_in_short_steps(sheep: Network, parameters: dict[str, float], h: float, zigzag: float) -> None:
    """Held for less than dt: the error of inlet.P does not alternate from point to point, by second differences.

    Measured 0.5 and 0.05 % of the pulse with viscous walls, 0.3 and 0.08 % with elastic ones.
    """
    times = grid(h * MS, 0.05)

    def half_sine(t: float) -> float:
        return float(sheep.inlet.Q(t))

    fine = Settings(dt=0.1 * MS, element_length=0.02)
    value, expected = (
        run(sheep, times, half_sine, interpolation="hold", parameters=parameters, settings=settings)[:, 0]
        for settings in (Settings(), fine)
    )
    assert np.abs(np.diff(value - expected, 2)).max() / np.ptp(expected) <= zigzag


@pytest.mark.parametrize("step", [1 * MS, 0.1 * MS, 1e-3 * MS, 1e-5 * MS])
def test_jump_just_before_a_communication_point(sheep: Network, step: float) -> None:
    """From rest, a jump of 10 mL/s. Elastic walls: the pressure lies between 0 and Z_c ΔQ = 234 Pa, within 1 Pa.

    The mesh smooths the front of the wave, so just after the jump it is nearer to 0. A scheme that spreads the jump
    over the step would give ΔQ/step times an inertia: 3.6e7 Pa after 10 ns.
    """
    component, values = start(sheep, **elastic(sheep.segments))
    component.step(0.0, step, {**values, "inlet.Q": 10e-6})
    assert -1.0 <= component.outputs()[0] <= 234.0


def test_first_value_is_no_jump_in_time(sheep: Network) -> None:
    """Linear from the value at initialization: a constant inflow from the start is the held one, to the last bit."""
    times = grid(MS, 0.02)
    constant = [run(sheep, times, lambda t: 10e-6, interpolation=kind) for kind in ("linear", "hold")]
    assert np.array_equal(*constant)


# --- smooth inflow ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [MS, 1.4 * MS])
def test_smooth_is_linear_one_step_late(sheep: Network, parameters: dict[str, float], step: float) -> None:
    """What the arteries know under ``smooth`` is what ``linear`` shows, to 1e-12; what is shown is one step ahead."""
    times = grid(step, 0.1)
    component, values = start(sheep, inlet__interpolation="smooth", **parameters)
    expected = run(sheep, times, ramps, parameters=parameters)
    for i, t in enumerate(times[:-1].tolist()):
        component.step(t, step, {**values, "inlet.Q": ramps(t)})
        known = component.report(component.known.state)[0]
        assert known == pytest.approx(expected[i], rel=1e-12, abs=1e-12 * np.abs(expected).max())


def test_smooth_of_a_known_inflow(sheep: Network) -> None:
    """A master that sets Q(t): outputs at t + h against linear with Q(t + h), relative L2 over 0.21 s at 1 ms.

    Held, the same inflow costs 6 % at inlet.P and 0.5 % in the flow at MD.
    """
    component, values = start(sheep, inlet__interpolation="smooth")
    rows = [component.outputs()]
    for t in grid(MS)[:-1].tolist():
        component.step(t, MS, {**values, "inlet.Q": smooth(t)})
        rows.append(component.outputs())
    known = run(sheep, grid(MS), smooth)
    for name, bound in (("inlet.P", 2.2e-3), ("AA.P", 8e-4), ("MD.P", 5e-5), ("MD.Q", 5e-5)):
        i = list(sheep.output_units()).index(name)
        value, expected = np.array(rows)[:, i], known[:, i]
        assert np.linalg.norm(value - expected) <= bound * np.linalg.norm(expected - expected.mean()), name


def test_extrapolated_flow_that_is_not_physical(sheep: Network) -> None:
    """After a jump by -0.6 L/s in 5 ms the extrapolated flow would empty the artery: then the flow is held instead."""
    component, values = start(sheep, inlet__interpolation="smooth")
    component.step(0.0, 5 * MS, values)
    component.step(5 * MS, 5 * MS, {**values, "inlet.Q": -6e-4})
    assert component.shown.drive == -6e-4


# --- changes while running ----------------------------------------------------------------------------------------


def test_venous_pressure_is_an_input(sheep: Network) -> None:
    """P_venous set before every step against the scheme stepped with it: to 1e-12."""
    component, values = start(sheep)
    model = build(sheep)
    report, state = reporter(model), initial_state(model)
    for i in range(50):
        P_venous = 200.0 * np.sin(0.1 * i * np.arange(1, 6))
        inputs = dict(zip(component.venous, P_venous.tolist(), strict=True))
        component.step(i * MS, MS, {**values, "inlet.Q": 20e-6, **inputs})
        state = step(model, state, MS, np.full(4, 20e-6), P_venous)
        assert component.outputs()[: len(report.names)] == pytest.approx(report(state)[0], rel=1e-12)


def test_retuned_parameters(sheep: Network) -> None:
    """CA.E and an outlet changed at t = 10 ms against the scheme with other coefficients from there: to 1e-12."""
    component, values = start(sheep)
    model = build(sheep)
    state = initial_state(model)
    new = {"CA.E": 2e6, "FA.outlet.R_t": 0.8}
    for i in range(30):
        if i == 10:
            component.retune({**values, **new})
            model = model.with_parameters(new)
        component.step(i * MS, MS, {**values, "inlet.Q": 20e-6})
        state = step(model, state, MS, np.full(4, 20e-6))
    n = len(sheep.output_units())
    assert component.outputs()[1:n] == pytest.approx(reporter(model)(state)[0, 1:], rel=1e-12)


@pytest.mark.parametrize("at", [0, 10])
def test_retuned_volume(at: int) -> None:
    """Windkessels three times as compliant, before the first step or after ten: no volume comes or goes by it.

    The inflow alternates by 5 mL/s, so ``smooth`` has always extrapolated wrongly. It knows one step less: its volumes
    after the next step are those of ``linear`` with a last flow that is extrapolated, to 1e-15 of a litre.
    """
    human = load("human")
    changed = {name: 3.0 * C for name, C in human.parameters().items() if name.endswith(".outlet.C")}
    found = []
    for kind in ("linear", "smooth"):
        component, values = start(human, inlet__interpolation=kind)
        Q = [100e-6 * np.sin(0.1 * i) + 5e-6 * (i % 2) * (i > 0) for i in range(22)]
        for i in range(20 if kind == "linear" else 21):
            if i == at:
                component.retune({**values, **changed})
            component.step(i * MS, MS, {**values, "inlet.Q": Q[i if kind == "smooth" else i + 1]})
        found.append((component.known.V_in, component.known.volume()))
    assert found[1] == pytest.approx(found[0], abs=1e-18)


@pytest.mark.parametrize("h", [1e-5, 1e-8, 1e-12])
@pytest.mark.parametrize("interpolation", ["hold", "smooth"])
def test_a_very_short_step_among_others(interpolation: str, h: float) -> None:
    """Steps of 1 ms with one of h [s] between: as without it, to 1e-3 of the pulse."""
    human = load("human")
    n, found = len(human.output_units()), []
    for short in (False, True):
        component, values = start(human, inlet__interpolation=interpolation)
        t = 0.0
        for i in range(40):
            if short and i == 20:
                component.step(t, h, {**values, "inlet.Q": smooth(t)})
                t += h
            component.step(t, MS, {**values, "inlet.Q": smooth(t)})
            t += MS
        found.append(np.array(component.outputs()[:n]))
    pressures = [i for i, name in enumerate(human.output_units()) if name.endswith(".P")]
    assert np.abs(found[1] - found[0])[pressures].max() <= 1e-3 * np.ptp(found[0][pressures])


def test_refused_parameters_change_nothing(sheep: Network) -> None:
    """phiNL without phi0 is refused with the solver's sentence, and the run goes on with the old ones, bit for bit."""
    component, values = start(sheep)
    other, _ = start(sheep)
    with pytest.raises(ValueError, match=r"CA\.phiNL .*raise CA\.phi0"):
        component.retune({**values, "CA.phi0": 0.0, "CA.phiNL": 1e3})
    for c in (component, other):
        c.step(0.0, 5 * MS, {**values, "inlet.Q": 10e-6})
    assert component.outputs() == other.outputs()


# --- errors -------------------------------------------------------------------------------------------------------


def test_failed_step_can_be_repeated(sheep: Network) -> None:
    """After NonPhysicalState the component stands where it was: a smaller inflow from there, bit for bit."""
    component, values = start(sheep)
    other, _ = start(sheep)
    for c in (component, other):
        c.step(0.0, 1.5 * MS, {**values, "inlet.Q": 10e-6})
    with pytest.raises(NonPhysicalState, match=r"segment \w+ at x = .* cm, t = 0\.00\d+ s"):
        component.step(1.5 * MS, 3 * MS, {**values, "inlet.Q": 0.5})
    for c in (component, other):
        c.step(1.5 * MS, 3 * MS, {**values, "inlet.Q": 12e-6})
    assert component.outputs() == other.outputs()


@pytest.mark.parametrize(
    ("t", "h", "sentence"),
    [
        (0.0, 0.0, "communication step of 0 s: must be positive."),
        (0.0, -1e-3, "communication step of -0.001 s: must be positive."),
        (0.0, float("nan"), "communication step of nan s: must be positive."),
        (0.0, float("inf"), "communication step of inf s: must be positive."),
        (1.0, 1e-3, "step from t = 1 s, but the component stands at 0 s; step on from there or reset."),
        (float("nan"), 1e-3, "step from t = nan s, but the component stands at 0 s; step on from there or reset."),
    ],
)
def test_bad_times(sheep: Network, t: float, h: float, sentence: str) -> None:
    """A step that is not positive, or not from where the component stands, ends in one sentence."""
    component, values = start(sheep)
    with pytest.raises(ValueError) as error:
        component.step(t, h, values)
    assert str(error.value) == sentence


def test_unreachable_start_pressure(sheep: Network) -> None:
    """A start pressure that no wall can carry is refused when the component is initialized."""
    with pytest.raises(ValueError, match=r"network\.P_0: the wall of segment \w+ cannot carry the start pressure"):
        start(replace(sheep, elastic_law="regression"), network__P_0=1e6)
